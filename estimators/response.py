"""R(u) = ∫ p(t) g(t+u) dt from the *samples* of pulse and gate that the declared rig holds.

Both are linear between samples and zero outside. On a common even grid of step h they are sums of hat functions, whose
correlation is a sum of cubic B-splines: value and slope at the nodes are exact, and so is the cubic Hermite curve
through them. No closed form of pulse or gate is used: an estimator sees the instrument as a laboratory measures it.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from .rig import Samples, samples_of

__all__ = ["Response", "correlate_samples"]

Float = npt.NDArray[np.float64]

#: Most nodes of one resampled waveform: bounds the direct convolution to some 10⁷ products.
MAX_NODES = 4096
#: Fewest nodes across the shorter waveform, so that the halved end samples of a jump stay a small ramp.
MIN_NODES = 256


@dataclass(frozen=True)
class Response:
    """R(u) on an even grid with its slope, and its moments.

    value [transmission, 1] and slope [1/s] at u = start_s + step_s·i; area_s = ∫R du; centroid_s and variance_s2 are
    those of R as a density; peak_s is the middle of the top; lo_s, hi_s hold all but 1e-7 of the peak's height.
    """

    start_s: float
    step_s: float
    value: Float
    slope: Float
    area_s: float
    centroid_s: float
    variance_s2: float
    peak_s: float
    peak: float
    lo_s: float
    hi_s: float

    def __call__(self, u_s: Float) -> tuple[Float, Float, Float]:
        """R [1], dR/du [1/s], d²R/du² [1/s²] at u_s (any shape); zero outside the table. Cubic Hermite."""
        h = self.step_s
        x = (np.asarray(u_s, dtype=np.float64) - self.start_s) / h
        inside = (x >= 0) & (x < self.value.size - 1)
        i = np.where(inside, x, 0.0).astype(np.int64)
        f = np.where(inside, x - i, 0.0)
        v0, v1 = self.value[i], self.value[i + 1]
        m0, m1 = self.slope[i] * h, self.slope[i + 1] * h
        c2 = 3 * (v1 - v0) - 2 * m0 - m1
        c3 = 2 * (v0 - v1) + m0 + m1
        r = v0 + f * (m0 + f * (c2 + f * c3))
        d = (m0 + f * (2 * c2 + 3 * f * c3)) / h
        dd = (2 * c2 + 6 * f * c3) / h**2
        return np.where(inside, r, 0.0), np.where(inside, d, 0.0), np.where(inside, dd, 0.0)

    def half_width(self, drop: Float) -> Float:
        """Half the width [s] over which R ≥ (1 − drop)·max R, for drop in 0..1 (any shape)."""
        levels = np.linspace(0.0, 1.0, 129) ** 2
        counts = (self.value[None, :] >= (1 - levels[:, None]) * self.peak).sum(axis=1)
        return np.asarray(np.interp(np.clip(drop, 0, 1), levels, 0.5 * self.step_s * counts), dtype=np.float64)


def _resample(start: float, step: float, value: Float, h: float) -> Float:
    length = step * (value.size - 1)
    count = max(2, int(np.ceil(length / h - 1e-9)) + 1)
    grid = h * np.arange(count)
    out = np.interp(grid, step * np.arange(value.size), value, right=0.0)
    # A jump at an end: the half sample keeps the area that a whole hat would stretch by half a step.
    out[0] *= 0.5
    if abs(grid[-1] - length) < 1e-6 * h:
        out[-1] *= 0.5
    return np.asarray(out, dtype=np.float64)


def correlate_samples(
    pulse: Samples | Mapping[str, Any], gate: Samples | Mapping[str, Any], *, jitter_s: float = 0.0
) -> Response:
    """R(u) of a sampled pulse (1/s, scaled to unit area here) and a sampled gate (transmission).

    Main arguments: `Samples`, or {"start_s", "step_s", "value"}, each; seconds. Other arguments: jitter_s: standard
    deviation of a normal jitter per shot, which broadens the mean response. Raises InputError for unusable samples.
    """
    p_start, p_step, p_value = pulse if isinstance(pulse, Samples) else samples_of(pulse, "pulse")
    g_start, g_step, g_value = gate if isinstance(gate, Samples) else samples_of(gate, "gate")
    p_length, g_length = p_step * (p_value.size - 1), g_step * (g_value.size - 1)
    h = min(p_step, g_step, min(p_length, g_length) / MIN_NODES)
    # A whole fraction of the step of the pulse keeps its nodes on the grid.
    h = p_step / np.ceil(p_step / h - 1e-9) if h < p_step else h
    h = max(h, max(p_length, g_length) / MAX_NODES)
    p = _resample(p_start, p_step, p_value, h)
    g = _resample(g_start, g_step, g_value, h)
    p = p / (p.sum() * h)
    if jitter_s > 0:
        half = max(1, int(np.ceil(6 * jitter_s / h)))
        # Areas under the normal density, so that a jitter below one step still keeps the sum.
        edges = (np.arange(-half, half + 2) - 0.5) * h / jitter_s
        blur = np.diff(0.5 * (1 + np.array([math.erf(x / math.sqrt(2)) for x in edges])))
        p = np.convolve(p, blur / blur.sum())
        p_start -= half * h
    c = np.convolve(g, p[::-1]) * h
    c = np.concatenate(([0.0, 0.0], c, [0.0, 0.0]))
    value, slope = np.zeros(c.size), np.zeros(c.size)
    value[1:-1] = (c[:-2] + 4 * c[1:-1] + c[2:]) / 6
    slope[1:-1] = (c[2:] - c[:-2]) / (2 * h)
    start = g_start - p_start - (p.size - 1) * h - 2 * h
    u = start + h * np.arange(c.size)
    area = float(value.sum() * h)
    centroid = float((u * value).sum() * h / area)
    variance = float(((u - centroid) ** 2 * value).sum() * h / area)
    peak = float(value.max())
    # The middle of the top, from the centre of the parts above .995 of it: a flat top has no sharp maximum.
    top = u[value >= 0.995 * peak]
    held = u[value >= 1e-7 * peak]
    return Response(
        start_s=float(start),
        step_s=float(h),
        value=value,
        slope=slope,
        area_s=area,
        centroid_s=centroid,
        variance_s2=variance,
        peak_s=float(0.5 * (top[0] + top[-1])),
        peak=peak,
        lo_s=float(held[0] - h),
        hi_s=float(held[-1] + h),
    )
