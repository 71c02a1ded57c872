"""Captures written down from closed forms, without a renderer."""
