"""Eq. 1, 5, 19 and 22: where the printed equations of received power agree with each other, and where they do not."""

from __future__ import annotations

import math

import numpy as np

from ...optics import ladar
from ...optics.constants import C_M_PER_S, FWHM_PER_SIGMA
from ...optics.correlation.waveforms import GaussianPulse, RectangularGate
from .rows import Row, judge_exact, judge_settings

__all__ = ["ladar_rows", "summed_over_eq19"]

#: Example values; in the ratios of Eq. 1, 19 and 22 they cancel.
_SIGMA_S, _GATE_S, _RANGE_M = 0.5e-9, 2.0e-9, 5.0
_BRDF = {"k_s": 0.05, "k_d": 0.2, "slope": 0.3, "diffusivity": 1.0}
_LENS = {"system_efficiency": 0.5, "path_transmission": 0.9, "aperture_diameter_m": 0.05}
#: Steps over the gate's width, and places of the first delay within a step, for Eq. 19.
_STEPS, _PLACES = (0.125, 0.5, 1.0, 1.7), (0.0, 0.25, 0.5, 0.75)


def summed_over_eq19(step_s: float, place: float) -> float:
    """Sum of the slices of Eq. 18 over Eq. 19: delays `step_s` apart that cover all of R, the first moved by `place` steps."""
    pulse, gate = GaussianPulse(FWHM_PER_SIGMA * _SIGMA_S), RectangularGate(_GATE_S, 1.0)
    half = math.ceil((_GATE_S + 12.0 * _SIGMA_S) / step_s)
    delay = 2.0 * _RANGE_M / C_M_PER_S + (np.arange(-half, half + 1) + place) * step_s
    slices = ladar.gated_intensity_eq18(1.0, pulse, gate, range_m=_RANGE_M, delay_s=delay, group_index=1.0)
    return float(np.sum(slices) / ladar.gated_intensity_eq19(1.0, _GATE_S, step_s))


def ladar_rows() -> list[Row]:
    """Rows of Eq. 1, 5, 19 and 22."""
    area = float(ladar.ladar_eq2_beam_area(0.01, _RANGE_M))
    one = float(
        ladar.ladar_eq1_received_power(
            1.0, **_LENS, reflectivity=0.3, target_area_m2=area, range_m=_RANGE_M, dispersion_sr=math.pi,
            divergence_rad=0.01,
        )
    )  # fmt: skip
    three = float(ladar.ladar_eq3_received_power(1.0, **_LENS, reflection_per_sr=0.3 / math.pi, range_m=_RANGE_M))
    six = float(ladar.ladar_eq6_received_power(
        0.3e-9, energy_j=1.0, sigma_s=_SIGMA_S, **_LENS, range_m=_RANGE_M, incidence_rad=0.4, **_BRDF,
    ))  # fmt: skip
    five = float(ladar.ladar_eq3_received_power(
        ladar.ladar_eq5_pulse_power(0.3e-9, power_scale=1.0, sigma_s=_SIGMA_S), **_LENS, range_m=_RANGE_M,
        reflection_per_sr=ladar.ladar_eq4_brdf(0.4, **_BRDF),
    ))  # fmt: skip
    sums = {step: [summed_over_eq19(step * _GATE_S, place) for place in _PLACES] for step in _STEPS}
    worst = {step: max(abs(value - 1.0) for value in found) for step, found in sums.items()}
    target = {**_LENS, "incidence_rad": 0.4, **_BRDF}
    near, far = (float(ladar.intensity_variation_eq22(**target, range_m=r)) for r in (_RANGE_M, 10.0 * _RANGE_M))
    exponent = 0.5 * math.log10(far / near)
    return [
        Row("Eq. 1", "Eq. 1 with the area of Eq. 2, over Eq. 3", "1", math.nan, one / three, 1e-12,
            judge_exact(1.0, one / three, 1e-12),
            "the step from Eq. 1 to Eq. 3 holds; θ_t is the full angle of divergence, though the text calls it both diameter "
            "and divergence"),
        Row("Eq. 5", "Eq. 6 over Eq. 3 with Eq. 4 and Eq. 5, all as printed", "1", math.nan, six / five, 1e-12,
            judge_exact(1.0, six / five, 1e-12),
            "Eq. 5 has σ_p under the root and Eq. 6 outside it: they differ by √σ_p, a number that depends on the unit of time "
            "(here s, σ_p = .5 ns). Eq. 20 and 21 need the form of Eq. 6; P_o is then an energy, which the text calls a power"),
        Row("Eq. 19", "sum of the slices of Eq. 18 over Eq. 19, with a step of 1.7 gate widths", "1", math.nan,
            sums[_STEPS[-1]][0], 1e-6, judge_settings(value <= 1e-6 for value in worst.values()),
            "largest deviation over the place of the echo: " + "; ".join(
                f"{value:.1g} for a step of {step:g} × the gate" for step, value in worst.items())
            + ". The text gives neither the step nor a condition on it; the delays must also cover all of R",
            "step; place of the echo"),
        Row("Eq. 22", "exponent of the signal-to-noise ratio against range, Eq. 15 with Eq. 22", "1", -1.0, exponent, 1e-12,
            judge_exact(-1.0, exponent, 1e-12),
            "the text: SNR drops approximately as r⁻¹. Photon noise alone, a target larger than the beam, no attenuation; "
            "where electronic noise dominates (Figure 3) the exponent is −2"),
    ]  # fmt: skip
