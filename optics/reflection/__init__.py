"""Reflection laws: the share of light that a surface sends from one direction into another."""
