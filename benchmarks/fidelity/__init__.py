"""The choice between rungs, measured: cost and error of every rung on a family of scenes."""
