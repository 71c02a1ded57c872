"""The forward model of laser lines: a sheet of light on the target, seen by a camera beside it."""
