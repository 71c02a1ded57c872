"""What a fit of direct light finds where there is other light too: the parameters to which maximum likelihood converges.

The model A R(θ + x − t_k) + b with A > 0 and b ≥ 0 is fitted to the true means μ_k of a stack by Fisher's scoring,

    Σ_k J(m_k) (μ_k − m_k) ∂m_k = 0,        m_k = A R(θ + x − t_k) + b,

J the information of a sample about its mean: the point of least Kullback-Leibler divergence of the model from the truth, to which
maximum likelihood tends (H. White, Econometrica 50:1, 1982). x is the bias, as a time.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from ...optics.correlation import response as correlation
from ...optics.likelihood.fisher_table import InformationTable

__all__ = ["Fitted", "pseudo_true"]

Float = npt.NDArray[np.float64]

#: Rounds of scoring, and the longest step of the shift in widths of R.
_ROUNDS, _LONGEST = 60, 0.25


@dataclass(frozen=True, eq=False)
class Fitted:
    """x [s], A [photoelectrons at an open gate] and b [photoelectrons of a slice] of elements (i); `settled`: it is found."""

    shift_s: Float
    light: Float
    level: Float
    settled: npt.NDArray[np.bool_]


def pseudo_true(
    mean: Float, time_s: Float, delay_s: Float, table: correlation.Table, width_s: float, information: InformationTable
) -> Fitted:
    """The fit of elements with the true means (i, k) at delays (k).

    Main arguments:
        mean: photoelectrons. time_s (i): of the true echo. table, width_s: R, and its standard deviation.
    """
    peak = float(table.value.max())
    level = np.maximum(mean.min(axis=1), 1e-3)
    light = np.maximum(mean.max(axis=1) - level, 1e-3) / peak
    shift = np.zeros(time_s.size)
    change = np.zeros(time_s.size)
    step = 0.02 * width_s
    for _ in range(_ROUNDS):
        u = (time_s + shift)[:, None] - delay_s
        r = np.maximum(correlation.lookup(table, u), 0.0)
        rise = (correlation.lookup(table, u + step) - correlation.lookup(table, u - step)) / (2.0 * step) * width_s
        model = np.maximum(light[:, None] * r + level[:, None], 1e-3)
        j = np.asarray(information(model))
        a = np.stack([light[:, None] * rise, r, np.ones_like(r)], axis=1)
        f = np.einsum("ik,ipk,iqk->ipq", j, a, a)
        g = np.einsum("ik,ipk->ip", j * (mean - model), a)
        scale = np.sqrt(np.maximum(np.einsum("ipp->ip", f), 1e-300))
        f = f / (scale[:, :, None] * scale[:, None, :]) + 1e-9 * np.eye(3)
        found = np.linalg.solve(f, (g / scale)[:, :, None])[:, :, 0] / scale
        change = np.clip(found[:, 0], -_LONGEST, _LONGEST) * width_s
        shift = shift + change
        light = np.maximum(light + found[:, 1], 0.2 * light)
        level = np.maximum(level + found[:, 2], 1e-3)
    return Fitted(shift, light, level, np.abs(change) < 1e-3 * width_s)
