"""Range-intensity correlation under triangular and trapezoidal profiles: conditions for a 2.5 times better precision.

Wang, Li and Zhou (Appl. Opt. 52:7399, 2013) report a proof experiment "with a range precision 2.5 times better than that
obtained under trapezoidal" profiles. With x the place in the depth of a pair of slices (0 … 1), A photoelectrons at the top
of a profile, and a relative fluctuation ε of each slice's energy:

    triangular (gate as long as the pulse): S_e = A(1 − x), S_l = A x, x = S_l/(S_e + S_l),
        σ² = x(1 − x)/A + 2ε² x²(1 − x)²
    trapezoidal (the early slice on its plateau): S_e = A, S_l = A x, x = S_l/S_e,
        σ² = x(1 + x)/A + 2ε² x²

so that the ratio of the rms errors over the whole depth is √5 = 2.24 for photon noise and √10 = 3.16 for fluctuations.
"""

from __future__ import annotations

import json
import math
from typing import Any

import numpy as np

from ...optics.constants import C_M_PER_S
from ..written.gated_stack import GaussianRig, stack_capture
from .rows import Row, judge_band

__all__ = ["ITEM", "PUBLISHED", "fluctuation_for", "measured_ratio", "precision_ratio", "triangular_rows"]

#: Not an item of Guo et al. 2017: the source is named, and listed with this document because it is about range gating.
ITEM = "Wang 2013, AO 52:7399"
#: The only number in the abstract, printed with two digits.
PUBLISHED = 2.5
_TOLERANCE = 0.05
_PULSE_S = 4e-9
_STEP_S = 1e-11
_LIGHT = 3000.0


def precision_ratio(electrons: float, fluctuation: float, low: float = 0.0, high: float = 1.0) -> float:
    """rms error under trapezoidal over that under triangular profiles, x uniform in low … high, by the formulas above."""

    def mean(power: int) -> float:
        return (high ** (power + 1) - low ** (power + 1)) / ((power + 1) * (high - low))

    x1, x2, x3, x4 = (mean(n) for n in (1, 2, 3, 4))
    multiplied = 2.0 * fluctuation**2 * electrons
    trapezoidal = x1 + x2 + multiplied * x2
    triangular = x1 - x2 + multiplied * (x2 - 2 * x3 + x4)
    return math.sqrt(trapezoidal / triangular)


def fluctuation_for(ratio: float, electrons: float) -> float:
    """The ε at which the ratio over the whole depth is `ratio`, √5 < ratio < √10: (5 − ρ²)/(ρ²/5 − 2) = 2ε²A."""
    square = ratio**2
    if not 5.0 < square < 10.0:
        raise ValueError(f"a ratio between √5 and √10, not {ratio!r}")
    return math.sqrt((square - 5.0) / (2.0 - square / 5.0) / (2.0 * electrons))


def _rms(gate_s: float, fluctuation: float, low: float, high: float, seed: int) -> float:
    """rms error [m] of `range-intensity-correlation` on 60 × 160 pairs of slices, 4 ns pulses, gates of `gate_s`."""
    from ...estimators import run_estimator

    shape = (60, 160)
    rig = GaussianRig(slices=2, start_s=30e-9)
    declared: dict[str, Any] = json.loads(json.dumps(rig.declared(*shape)))
    n, m = round(_PULSE_S / _STEP_S), round(gate_s / _STEP_S)
    pulse, gate = [0.0, *[1 / _PULSE_S] * n, 0.0], [0.0, *[1.0] * m, 0.0]
    declared["pulse"] = {"start_s": -_PULSE_S / 2 - _STEP_S / 2, "step_s": _STEP_S, "value": pulse}
    declared["gates"] = [{"start_s": -_STEP_S / 2, "step_s": _STEP_S, "value": gate}]
    rng = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(52, 7399)))
    delays = rig.start_s + np.array([0.0, _PULSE_S])
    tau = delays[1] - _PULSE_S / 2 + _PULSE_S * rng.uniform(low, high, shape)
    u = tau[None] - delays[:, None, None]
    passed = np.minimum(u + _PULSE_S / 2, gate_s) - np.maximum(u - _PULSE_S / 2, 0.0)
    light = _LIGHT * np.clip(passed, 0.0, None) / _PULSE_S
    # Each pixel is a separate measurement, so that 9,600 pairs of energies are drawn.
    light *= np.maximum(1.0 + fluctuation * rng.standard_normal(light.shape), 0.0)
    capture = stack_capture(rig, rng.poisson(light).astype(np.uint16), declared)
    capture = capture.assign_coords(delay=("slice", delays, {"units": "s", "long_name": "delay"}))
    found = run_estimator("range-intensity-correlation[background=none,min_snr=0]", capture)
    error = found["range"].values - tau * C_M_PER_S / 2.0
    return float(np.sqrt(np.nanmean(error**2)))


def measured_ratio(fluctuation: float, low: float = 0.1, high: float = 0.9, seed: int = 1) -> float:
    """The ratio of rms errors of the estimator itself, gates of one and of three pulse lengths, in the inner depth.

    At the ends of the depth a ratio leaves its curve and is refused, so only the inner part is compared with the formula.
    """
    trapezoidal = _rms(3 * _PULSE_S, fluctuation, low, high, seed)
    return trapezoidal / _rms(_PULSE_S, fluctuation, low, high, seed + 1)


def triangular_rows() -> list[Row]:
    """The row on the number in the abstract of the source."""
    law, limit = precision_ratio(1.0, 0.0), precision_ratio(1.0, 1e6)
    needed = fluctuation_for(PUBLISHED, _LIGHT)
    return [
        Row(ITEM, "precision of triangular over trapezoidal profiles, photon noise, whole depth", "1", PUBLISHED, law,
            _TOLERANCE, judge_band(PUBLISHED, law, limit, _TOLERANCE),
            "not of this document: Wang, Li and Zhou, Appl. Opt. 52:7399 (2013), of which only the abstract was available. √5 "
            f"for photon noise alone, √10 = {limit:.3g} for fluctuations of each slice's energy alone: 2.5 lies between, e.g. "
            f"at {_LIGHT:g} photoelectrons and fluctuations of {100 * needed:.2g} %. The abstract gives neither",
            "photoelectrons; fluctuation of energy"),
    ]  # fmt: skip
