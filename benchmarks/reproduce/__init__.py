"""The published results, computed again, with a verdict on each."""
