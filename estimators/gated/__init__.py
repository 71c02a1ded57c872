"""Estimators of range from a gated stack: one algorithm a file."""
