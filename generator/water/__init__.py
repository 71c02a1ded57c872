"""Scattered light by closed forms: halo, delay and backscatter of a medium."""
