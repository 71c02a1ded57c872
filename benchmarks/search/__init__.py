"""Searches for the conditions under which estimators fail: sweeps, failure maps, breakdown levels, and `break`."""
