"""Readers of mesh files, each by its standard: bytes to triangles. What a reader does not know, it refuses with the reason."""
