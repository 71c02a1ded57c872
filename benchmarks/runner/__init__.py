"""Estimators in supervised child processes: their input, their limits and their results."""
