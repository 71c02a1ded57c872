"""Suites: files that list scenes, stresses, seeds and estimators, and the stresses that change the scenes."""
