"""Recomputation of published results, with a verdict on each."""
