"""Scans of delays that are drawn by NumPy from closed forms, for tests of what reads them."""

from __future__ import annotations

import json
import math
from typing import Any

import numpy as np

from beambench.estimators.calibration.gated_scan import DelayScan
from beambench.estimators.rig import DeclaredRig
from beambench.scenes.declared import declared_rig
from beambench.scenes.load import load_scene

SHAPE = (8, 8)
C = 299792458.0


def scan_rig(**changes: Any) -> DeclaredRig:
    """Pulse of 0.8 ns, gate of 1.5 ns with edges, as declared samples."""
    gate = {"kind": "trapezoidal", "width_s": 1.5e-9, "rise_s": 0.3e-9, "fall_s": 0.4e-9, "transmission": 1.0}
    values = {
        "rig.camera.rows": SHAPE[0], "rig.camera.cols": SHAPE[1], "rig.laser.pulse.fwhm_s": 0.8e-9, "rig.gates": [gate],
        "rig.ambient_e_per_s": 0.0, "rig.detector.dark_current_e_per_s": 0.0,
    } | changes  # fmt: skip
    data = declared_rig(load_scene("flat-wall", values))
    return DeclaredRig(json.dumps(data), data)


def erf_response(
    u: np.ndarray[Any, Any], fwhm_s: float, width_s: float, rise_s: float, fall_s: float
) -> np.ndarray[Any, Any]:
    """R of a Gaussian pulse and a trapezoidal gate, by its closed form: the gate is a difference of two ramps, each the
    integral of a step over its edge, and a Gaussian blurs a step into Φ. Shares nothing with the samples that the fit
    reads."""
    from scipy.special import erf

    s = fwhm_s / math.sqrt(8 * math.log(2))

    def ramp(x: np.ndarray[Any, Any]) -> np.ndarray[Any, Any]:  # ∫ Φ((x − t)/s) dt
        return np.asarray(
            0.5 * x * (1 + erf(x / (s * math.sqrt(2)))) + s / math.sqrt(2 * math.pi) * np.exp(-0.5 * (x / s) ** 2)
        )

    rising = (ramp(u + rise_s / 2) - ramp(u - rise_s / 2)) / rise_s
    falling = (ramp(u - width_s + fall_s / 2) - ramp(u - width_s - fall_s / 2)) / fall_s
    return rising - falling


def delay_scan(
    seed: int, *, light: float = 60.0, gain: float = 1.03, read: float = 2.0, f2: float = 1.0,
    stretch: tuple[float, float] = (1, 1),
    shift_s: float = 0.0, repeats: int = 40, dark: int = 60, vary: float = 0.0, **changes: Any,
) -> tuple[DelayScan, np.ndarray[Any, Any]]:  # fmt: skip
    """A scan drawn by NumPy from the closed form: Poisson numbers of gamma pulses, read noise, rounding."""
    rng = np.random.default_rng(seed)
    range_m = np.linspace(4.95, 5.05, SHAPE[0] * SHAPE[1])
    rig = scan_rig(**changes)
    n_g = rig.number("medium.group_index")
    tau = 2 * range_m * n_g / C
    delay = tau.mean() - 2.4e-9 + 0.15e-9 * np.arange(28)
    u = tau + shift_s - delay[:, None]
    p, g = stretch
    mean = light * erf_response(u, 0.8e-9 * p, 1.5e-9 * g, 0.3e-9 * g, 0.4e-9 * g)
    energy = 1.0 + vary * rng.standard_normal((28, repeats, 1))
    n = rng.poisson(mean[:, None, :] * energy).astype(float)
    if f2 > 1:
        shape = n / (f2 - 1)
        n = np.where(n > 0, rng.standard_gamma(np.where(n > 0, shape, 1.0)) * (f2 - 1), 0.0)
    counts = np.floor(100.5 + gain * (n + read * rng.standard_normal(n.shape)))
    off = np.floor(100.5 + gain * read * rng.standard_normal((dark, mean.shape[1])))
    return DelayScan(counts, off, delay, SHAPE, rig), range_m.reshape(SHAPE)
