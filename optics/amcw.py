"""Amplitude-modulated ranging: phase, whole and fractional cycles (Kusters 1992, Eq. 2.4 and 2.5), correlation samples.

The emitted power is P(1 + m cos ωt), ω = 2πf; it returns τ = 2 n_g r/c later. A detector of transmission
½(1 + d cos(ωt − φ)) collects, over whole periods,

    S(φ) = A (1 + C cos(ωτ − φ)) + B,        C = m d/2,

with A half of the photoelectrons that an unmodulated detector would collect. The modulation wavelength is λ_m = c/(n_g f).
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from .constants import C_M_PER_S
from .correlation.parts import Array

__all__ = [
    "correlation_sample", "distance_eq24", "modulation_wavelength", "part_wave_eq25", "phase_of_range",
    "phase_variance", "unambiguous_range", "whole_cycles",
]  # fmt: skip

_TWO_PI = 2.0 * np.pi


def modulation_wavelength(frequency_hz: ArrayLike, group_index: float) -> Array:
    """λ_m = c/(n_g f), m."""
    return np.asarray(C_M_PER_S / (group_index * np.asarray(frequency_hz, np.float64)))


def phase_of_range(range_m: ArrayLike, frequency_hz: ArrayLike, group_index: float) -> Array:
    """ωτ = 4π r/λ_m, rad, not wrapped."""
    return np.asarray(
        2.0 * _TWO_PI * np.asarray(range_m, np.float64) / modulation_wavelength(frequency_hz, group_index)
    )


def distance_eq24(cycles: ArrayLike, part_wave_m: ArrayLike, wavelength_m: ArrayLike) -> Array:
    """Eq. 2.4: 2D = n λ_m + Δλ_m; returns D, m.

    Main arguments:
        cycles: n, whole cycles over the two-way path. part_wave_m: Δλ_m of Eq. 2.5. wavelength_m: λ_m.
    """
    whole = np.asarray(cycles, np.float64) * np.asarray(wavelength_m, np.float64)
    return np.asarray(0.5 * (whole + np.asarray(part_wave_m, np.float64)))


def part_wave_eq25(phase_rad: ArrayLike, reference_rad: ArrayLike, wavelength_m: ArrayLike) -> Array:
    """Eq. 2.5: Δλ_m = (Φ₂ − Φ₁)/360° · λ_m, m, 0 ≤ Δλ_m < λ_m. Phases in rad here; printed in degrees.

    Main arguments:
        phase_rad: Φ₂, of the received light. reference_rad: Φ₁, of the emitted light.
    """
    lag = np.asarray(phase_rad, np.float64) - np.asarray(reference_rad, np.float64)
    turns = lag / _TWO_PI
    part = turns - np.floor(turns)
    return np.asarray(np.where(part >= 1.0, 0.0, part) * np.asarray(wavelength_m, np.float64))


def whole_cycles(coarse_m: ArrayLike, part_wave_m: ArrayLike, wavelength_m: ArrayLike) -> Array:
    """n of Eq. 2.4 from a coarse distance D': the integer nearest to (2D' − Δλ_m)/λ_m.

    Correct while |D' − D| < λ_m/4.
    """
    gap = 2.0 * np.asarray(coarse_m, np.float64) - np.asarray(part_wave_m, np.float64)
    return np.asarray(np.rint(gap / np.asarray(wavelength_m, np.float64)))


def unambiguous_range(frequencies_hz: ArrayLike, group_index: float) -> float:
    """Range after which all phases repeat: c/(2 n_g g), g the greatest common divisor of the frequencies.

    Frequencies are rounded to whole millihertz; where they share no larger divisor the range is practically unlimited.
    """
    milli = np.rint(1e3 * np.asarray(frequencies_hz, np.float64)).astype(np.int64)
    return float(C_M_PER_S / (2.0 * group_index * (float(np.gcd.reduce(np.atleast_1d(milli))) * 1e-3)))


def correlation_sample(
    amplitude_e: ArrayLike, contrast: ArrayLike, delay_s: ArrayLike, frequency_hz: ArrayLike, phase_rad: ArrayLike
) -> Array:
    """A (1 + C cos(2πfτ − φ)), electrons; arguments broadcast."""
    turn = _TWO_PI * np.asarray(frequency_hz, np.float64) * np.asarray(delay_s, np.float64)
    wave = 1.0 + np.asarray(contrast, np.float64) * np.cos(turn - np.asarray(phase_rad, np.float64))
    return np.asarray(np.asarray(amplitude_e, np.float64) * wave)


def phase_variance(modulated_e: ArrayLike, sample_variance_e2: ArrayLike, phase_steps: int) -> Array:
    """2σ²/(n (AC)²), rad²: variance of the phase from n even samples of equal variance σ² and modulated part AC.

    For four shot-noise limited samples, σ² = A + B: var φ = (A + B)/(2 A² C²) (Lange and Seitz, IEEE JQE 37:390, 2001).
    """
    return np.asarray(
        2.0 * np.asarray(sample_variance_e2, np.float64) / (phase_steps * np.asarray(modulated_e, np.float64) ** 2)
    )
