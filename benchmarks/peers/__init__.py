"""Comparisons with other programs: speed at equal error, and agreement."""
