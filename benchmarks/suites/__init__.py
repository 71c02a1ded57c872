"""Suites: what is scored, as data, and the stresses that change scenes."""
