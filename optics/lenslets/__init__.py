"""Lenslets: the field and light of their spots, gradients averaged over them, and the equations of a sensor of wave slopes."""
