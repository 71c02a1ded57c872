"""Checks of the benchmark itself: planted faults, coverage of intervals, bounds against simulation."""
