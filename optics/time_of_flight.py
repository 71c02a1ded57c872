"""Distance from the travel time of a pulse, and the counter that measures it (Kusters 1992, Eq. 2.3 and Figure 2.2)."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from .correlation.parts import Array

__all__ = ["count_cycles", "counter_range_step", "pulse_distance_eq23"]


def pulse_distance_eq23(time_s: ArrayLike, speed_m_per_s: ArrayLike) -> Array:
    """Eq. 2.3: D = v t/2, m: v is the pulse's speed in the medium, which is c over the *group* index."""
    return np.asarray(0.5 * np.asarray(speed_m_per_s, np.float64) * np.asarray(time_s, np.float64))


def count_cycles(time_s: ArrayLike, oscillator_hz: float, start_phase: ArrayLike = 0.0) -> Array:
    """Cycles counted while the counter's gate is open: floor(f t + φ); NaN where t is NaN.

    Main arguments:
        time_s: how long the gate is open. oscillator_hz: f. start_phase: φ in cycles, 0 … 1; 0 is an oscillator that
        starts with the gate.

    With φ = 0 the error of (n + ½)/f is uniform over ±1/2f (rms 1/(f√12)); with a free-running oscillator (φ uniform
    over 0 … 1) that of n/f is triangular over ±1/f, with the variance F(1 − F)/f², F the fractional part of f t.
    """
    cycles = oscillator_hz * np.asarray(time_s, np.float64) + np.asarray(start_phase, np.float64)
    return np.asarray(np.floor(cycles), np.float64)


def counter_range_step(oscillator_hz: float, speed_m_per_s: float) -> float:
    """Range of one cycle, v/(2f), m."""
    return speed_m_per_s / (2.0 * oscillator_hz)
