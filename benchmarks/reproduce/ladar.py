"""Eq. 1-6 and 18-22: received power and the intensity of slices."""

from __future__ import annotations

import math

import numpy as np

from ...optics import ladar
from ...optics.constants import C_M_PER_S, FWHM_PER_SIGMA
from ...optics.correlation.response import correlation
from ...optics.correlation.waveforms import GaussianPulse, RectangularGate
from .rows import Row, judge_exact

__all__ = ["ladar_rows"]

#: Example values; the equations are compared as ratios, in which these cancel.
_SIGMA_S, _GATE_S, _STEP_S, _RANGE_M = 0.5e-9, 2.0e-9, 0.25e-9, 5.0
_BRDF = {"k_s": 0.05, "k_d": 0.2, "slope": 0.3, "diffusivity": 1.0}
_LENS = {"system_efficiency": 0.5, "path_transmission": 0.9, "aperture_diameter_m": 0.05}


def _difference(a: float, b: float) -> float:
    return a / b - 1.0


def ladar_rows() -> list[Row]:
    """Rows of Eq. 1-6 and 18-22."""
    return [*_power(), *_slices()]


def _power() -> list[Row]:
    area = float(ladar.ladar_eq2_beam_area(0.01, _RANGE_M))
    footprint = math.pi * (0.5 * 0.01 * _RANGE_M) ** 2
    one = float(
        ladar.ladar_eq1_received_power(
            1.0, **_LENS, reflectivity=0.3, target_area_m2=area, range_m=_RANGE_M, dispersion_sr=math.pi,
            divergence_rad=0.01,
        )
    )  # fmt: skip
    three = float(ladar.ladar_eq3_received_power(1.0, **_LENS, reflection_per_sr=0.3 / math.pi, range_m=_RANGE_M))
    t, dt = np.linspace(-12 * _SIGMA_S, 12 * _SIGMA_S, 2401, retstep=True)
    printed = float(np.sum(ladar.ladar_eq5_pulse_power(t, power_scale=1.0, sigma_s=_SIGMA_S)) * dt)
    right = float(np.sum(ladar.gaussian_pulse_power(t, energy_j=1.0, sigma_s=_SIGMA_S)) * dt)
    six = float(ladar.ladar_eq6_received_power(
        0.3e-9, energy_j=1.0, sigma_s=_SIGMA_S, **_LENS, range_m=_RANGE_M, incidence_rad=0.4, **_BRDF,
    ))  # fmt: skip
    parts = float(ladar.ladar_eq3_received_power(
        ladar.gaussian_pulse_power(0.3e-9, energy_j=1.0, sigma_s=_SIGMA_S), **_LENS, range_m=_RANGE_M,
        reflection_per_sr=ladar.ladar_eq4_brdf(0.4, **_BRDF),
    ))  # fmt: skip
    normal = float(ladar.ladar_eq4_brdf(0.0, **_BRDF))
    return [
        Row("Eq. 1", "Eq. 1 with the area of Eq. 2, over Eq. 3, less 1", "1", 0.0, _difference(one, three), 1e-12,
            judge_exact(0.0, _difference(one, three), 1e-12), "the step from Eq. 1 to Eq. 3 holds"),
        Row("Eq. 2", "area of Eq. 2 over that of a disc of diameter θ_t r, less 1", "1", 0.0,
            _difference(area, footprint), 1e-12, judge_exact(0.0, _difference(area, footprint), 1e-12),
            "θ_t is therefore the full angle of divergence, though the text calls it both diameter and divergence"),
        Row("Eq. 3", "share of a Lambert surface's light that a 50 mm aperture takes at 5 m, Eq. 3 over sin², less 1",
            "1", 0.0, _difference(0.25 * math.pi * 0.05**2 / _RANGE_M**2 / math.pi,
                                  math.sin(math.atan(0.025 / _RANGE_M)) ** 2), 1e-4,
            judge_exact(0.0, _difference(0.25 * 0.05**2 / _RANGE_M**2,
                                         math.sin(math.atan(0.025 / _RANGE_M)) ** 2), 1e-4),
            "a small aperture: exact for D ≪ r"),
        Row("Eq. 4", "Eq. 4 at θ = 0 over K_S + K_D, less 1", "1", 0.0, _difference(normal, 0.25), 1e-12,
            judge_exact(0.0, _difference(normal, 0.25), 1e-12),
            "at normal incidence the slope s, i.e. the roughness, cancels; the two terms have different conventions of "
            "foreshortening, so that the convention must be chosen by name"),
        Row("Eq. 5", "∫P_t dt over P_o, as printed with σ_p under the root", "1", 1.0, printed, 1e-9,
            judge_exact(1.0, printed, 1e-9),
            "σ_p under the root makes the area √σ_p, a number that depends on the unit of time (here s)"),
        Row("Eq. 5", "∫P_t dt over P_o, with σ_p outside the root as in Eq. 6", "1", 1.0, right, 1e-9,
            judge_exact(1.0, right, 1e-9), "P_o is then an energy, not the power that the text calls it"),
        Row("Eq. 6", "Eq. 6 over Eq. 3 with Eq. 4 and the right pulse, less 1", "1", 0.0, _difference(six, parts), 1e-12,
            judge_exact(0.0, _difference(six, parts), 1e-12), "follows from Eq. 3, Eq. 4 and the corrected Eq. 5"),
    ]  # fmt: skip


def _slices() -> list[Row]:
    pulse, gate = GaussianPulse(FWHM_PER_SIGMA * _SIGMA_S), RectangularGate(_GATE_S, 1.0)
    echo = 2.0 * _RANGE_M / C_M_PER_S
    delay = echo + np.arange(-40, 41) * _STEP_S
    slices = ladar.gated_intensity_eq18(1.0, pulse, gate, range_m=_RANGE_M, delay_s=delay, group_index=1.0)
    # Eq. 18 by brute force: a fine sum over t of the received pulse times the gate.
    t, dt = np.linspace(echo - 12 * _SIGMA_S, echo + 12 * _SIGMA_S, 40001, retstep=True)
    power = ladar.gaussian_pulse_power(t - echo, energy_j=1.0, sigma_s=_SIGMA_S)
    open_ = ((t - delay[37] >= 0.0) & (t - delay[37] <= _GATE_S)).astype(float)
    brute = float(np.sum(power * open_) * dt)
    nineteen = float(ladar.gated_intensity_eq19(1.0, _GATE_S, _STEP_S))
    target = {**_LENS, "range_m": _RANGE_M, "incidence_rad": 0.4, **_BRDF}
    twenty = float(ladar.gated_intensity_eq20(energy_j=1.0, sigma_s=_SIGMA_S, gate_s=_GATE_S, step_s=_STEP_S, **target))
    twenty_one = float(ladar.gated_intensity_eq21(energy_j=1.0, gate_s=_GATE_S, step_s=_STEP_S, **target))
    variation = float(ladar.intensity_variation_eq22(**target))
    far = float(ladar.intensity_variation_eq22(**{**target, "range_m": 10 * _RANGE_M}))
    coarse = echo + 0.3e-9 + np.arange(-20, 21) * 1.7 * _GATE_S
    sparse = float(np.sum(correlation(pulse, gate, echo - coarse)))
    d18, d19 = _difference(float(slices[37]), brute), _difference(float(slices.sum()), nineteen)
    d21, d22 = _difference(twenty_one, twenty), _difference(variation * _GATE_S / _STEP_S, twenty_one)
    ratio = math.sqrt(far / variation)
    return [
        Row("Eq. 18", "closed form of a slice over a sum of 40,000 parts, less 1", "1", 0.0, d18, 2e-4,
            judge_exact(0.0, d18, 2e-4), "I_i = energy × R(2r/c − t_i); tolerance: one part at each of the gate's edges"),
        Row("Eq. 19", "sum of all slices over ∫P dt · ∫G dτ/t_step, less 1", "1", 0.0, d19, 1e-6,
            judge_exact(0.0, d19, 1e-6), "holds where the delays cover all of R with a small step (here σ_p/2)"),
        Row("Eq. 19", "the same with a step of 1.7 gate widths, less 1", "1", math.nan,
            _difference(sparse, 1.0 / 1.7), math.nan, "undetermined",
            "the text states no condition on the step; with a coarse step the sum depends on the place of the echo",
            "step; place of the echo"),
        Row("Eq. 20", "Eq. 20 over Eq. 21, less 1", "1", 0.0, -d21, 1e-9, judge_exact(0.0, d21, 1e-9),
            "the pulse of Eq. 6 integrates to P_o"),
        Row("Eq. 21", "Eq. 21 over Eq. 22 · P_o · t_gate/t_step, less 1", "1", 0.0, d22, 1e-12,
            judge_exact(0.0, d22, 1e-12), "definition"),
        Row("Eq. 22", "SNR at ten times the range over SNR (Eq. 15 with Eq. 22)", "1", 0.1, ratio, 1e-12,
            judge_exact(0.1, ratio, 1e-12),
            "the text: SNR drops approximately as 1/r; photon noise alone, a resolved target, no attenuation"),
    ]  # fmt: skip
