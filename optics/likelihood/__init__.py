"""The exact likelihood of a detector sample, and its Fisher information."""
