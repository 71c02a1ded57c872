"""Bounds: the smallest error that the physics of a capture allows."""
