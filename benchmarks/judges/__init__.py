"""Judges: how each modality's estimates are compared with truth and bound."""
