"""Pulses, gates and their correlation: the response of a gate to a pulse, in closed form and as tables."""
