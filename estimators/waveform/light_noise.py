"""The noise of the light in records of unknown gain, from what is left of the echoes after a fit."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import numpy.typing as npt

__all__ = ["light_noise"]

Float = npt.NDArray[np.float64]
Bool = npt.NDArray[np.bool_]

#: Most shots that are fitted, and candidate times per sample.
_SHOTS, _PER_STEP = 256, 16
#: A fit takes three values: time, height and background.
_FITTED = 3


def light_noise(
    z: Float, use: Bool, floor_var: float, start_s: Float, step_s: float, shape: Callable[[Float], Float]
) -> float:
    """F² of the variance F²μ + floor_var of a sample of mean μ above the background, 0 or more.

    z, use (shot, sample): samples, and which of them an echo and its surroundings fill. start_s (shot): about when the echo
    arrives. shape: times (n) -> template (n, sample). Every echo is fitted by least squares over time, height and background; with
    the residuals e and the leverages h of its samples, F² is the median over shots of Σ(e²/(1 − h) − floor_var)μ/Σμ². An echo that
    has another form than the response leaves more, so that F² is then too high rather than too low.
    """
    rows = np.flatnonzero(use.sum(axis=1) > _FITTED + 1)
    rows = rows[:: max(1, rows.size // _SHOTS)]
    found = []
    for row in rows:
        held, y = use[row], z[row, use[row]]
        tau = start_s[row] + step_s * np.arange(-2 * _PER_STEP, 2 * _PER_STEP + 1) / _PER_STEP
        r = shape(tau)[:, held]
        centred = r - r.mean(axis=1, keepdims=True)
        square = (centred**2).sum(axis=1)
        with np.errstate(divide="ignore", invalid="ignore"):
            height = np.where(square > 0, centred @ y / square, 0.0)
        rest = y - y.mean() - height[:, None] * centred
        best = int(np.argmin((rest**2).sum(axis=1)))
        mean = height[best] * r[best]
        if height[best] > 0 and (mean**2).sum() > 0:
            near = r[[max(best - 1, 0), min(best + 1, len(r) - 1)]]
            design = np.stack([np.ones(y.size), r[best], near[1] - near[0]], axis=1)
            leverage = (np.linalg.qr(design)[0] ** 2).sum(axis=1)
            noise = rest[best] ** 2 / np.maximum(1.0 - leverage, 0.1) - floor_var
            found.append(float((noise * mean).sum() / (mean**2).sum()))
    return max(float(np.median(found)), 0.0) if found else 0.0
