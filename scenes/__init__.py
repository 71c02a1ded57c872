"""Scenes: target, medium and rig as typed specs, and the library of scenes."""
