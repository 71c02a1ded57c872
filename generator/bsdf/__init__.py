"""Reflection laws for Mitsuba, and textures."""
