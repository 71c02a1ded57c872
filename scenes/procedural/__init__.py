"""Procedural shapes: geometry that a recipe, its parameters and a seed decide, in pieces that are told apart."""
