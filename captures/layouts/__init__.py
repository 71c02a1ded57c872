"""Layouts: for each modality the variables of a capture, with dimensions, types and units."""
