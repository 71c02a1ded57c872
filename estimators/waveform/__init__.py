"""Estimators of range from a recorded pulse."""
