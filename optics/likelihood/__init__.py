"""The exact likelihood of a detector's sample, and the Fisher information that follows from it."""
