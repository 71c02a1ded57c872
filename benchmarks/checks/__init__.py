"""Checks of the benchmark itself: deliberately faulty estimators, coverage of intervals, bounds against simulation."""
