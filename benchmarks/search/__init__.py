"""Searches for failure: sweeps, failure maps, breakdown levels, and `break`."""
