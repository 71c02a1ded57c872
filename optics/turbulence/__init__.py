"""Optical turbulence: strength, structure functions, phase screens that are right at all lags, layers and propagation."""
