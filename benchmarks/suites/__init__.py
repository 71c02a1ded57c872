"""Suites: files that list what is scored, and the stresses that change their scenes."""
