"""Measurement of the choice between rungs: cost and error of every rung on a family of scenes."""
