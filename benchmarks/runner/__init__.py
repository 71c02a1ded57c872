"""Estimators in watched child processes: what passes to them, and what comes back."""
