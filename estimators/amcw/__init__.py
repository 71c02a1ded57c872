"""Estimators of range from amplitude-modulated samples."""
