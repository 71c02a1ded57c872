"""The compiled sum of `gated_bound`: one pass over slices per pixel, without arrays of the size of the stack."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from ...optics.correlation.hermite import hermite_slope, hermite_value
from ...optics.jit import kernel

__all__ = ["range_sigma"]


@kernel
def range_sigma(
    truth: Any, amplitude: Any, halo: Any, background: Any, largest: float, time: Any, time_slope: Any, offset: Any, delay: Any,
    gate: Any, lit: Any, usable: Any, start: Any, inv_step: Any, value: Any, slope: Any, log_mu0: float,
    log_inv_step: float, log_information: Any,
) -> Any:  # fmt: skip
    """σ of the range, m, (row, col): infinite without information, NaN where `truth` is.

    `halo` (row, col): target light that is part of `background` and moves with the target; `time`: n_g ℓ/c [s];
    `time_slope`: its derivative by the range [s/m]; `background` (slice, row, col) [electron], with `largest` its maximum;
    `value`, `slope` (gate, node): tables of R; `log_information`: ln J on a uniform grid of ln μ.
    """
    rows, cols = truth.shape
    slices = delay.size
    nodes = log_information.size
    result = np.full((rows, cols), np.nan)
    for i in range(rows):
        for j in range(cols):
            if not math.isfinite(truth[i, j]):
                continue
            alpha = amplitude[i, j]
            f00, f01, f02, f11, f12, f22 = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
            for k in range(slices):
                if not usable[k]:
                    continue
                mu = background[k, i, j]
                still = mu
                r, dr = 0.0, 0.0
                if lit[k]:
                    g = gate[k]
                    u = time[i, j] - delay[k] - offset[i, j]
                    r = max(hermite_value(start[g], inv_step[g], value[g], slope[g], u), 0.0)
                    still = max(mu - halo[i, j] * r, 0.0)
                    dr = (
                        (alpha + halo[i, j])
                        * time_slope[i, j]
                        * hermite_slope(start[g], inv_step[g], value[g], slope[g], u)
                    )
                    mu += alpha * r
                # A background of exactly 0 is at the end of what can be: nothing is lost by not knowing it.
                # Beside a halo what stands still cannot be told from the halo's late tail: it is taken as known.
                shape = still / largest if largest > 0.0 and halo[i, j] == 0.0 else 0.0
                if mu <= 0.0 and r <= 0.0:
                    continue
                x = (math.log(max(mu, 1e-300)) - log_mu0) * log_inv_step
                x = min(max(x, 0.0), nodes - 1.0)
                n = min(int(x), nodes - 2)
                f = x - n
                info = math.exp(log_information[n] * (1.0 - f) + log_information[n + 1] * f)
                f00 += info * dr * dr
                f01 += info * dr * r
                f02 += info * dr * shape
                f11 += info * r * r
                f12 += info * r * shape
                f22 += info * shape * shape
            # Schur complement of (amplitude, background); without background only the amplitude is profiled.
            left = f00
            if f22 > 0.0:
                left -= f02 * f02 / f22
                cross = f01 - f02 * f12 / f22
                own = f11 - f12 * f12 / f22
            else:
                cross, own = f01, f11
            # One or two slices cannot separate range, amplitude and background; without this test rounding errors would seem to.
            if own > 1e-12 * f11:
                left -= cross * cross / own
            elif cross * cross > 0.0:
                left = 0.0
            result[i, j] = 1.0 / math.sqrt(left) if left > 1e-12 * f00 and left > 0.0 else np.inf
    return result
