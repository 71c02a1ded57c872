"""Bounds: the least error that the physics of a capture allows."""
