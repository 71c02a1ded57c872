"""Bounds of slope and level of a power law from the profiles of a survey.

The powers of a profile of n heights at k/L, k = 1 … n/2, have independent exponential distributions of mean A f^−γ. P independent
profiles tell of γ and ln A with the information P Σ_k u uᵀ, u = (−ln(f_k/10), 1) (P. Whittle, Arkiv för Matematik 2:423, 1953).
Noise, trends, gaps and profiles that are alike take from it: no reading has a smaller error.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import numpy.typing as npt
import xarray as xr

from ..scores.truth import Bound

__all__ = ["roughness_bounds"]

Float = npt.NDArray[np.float64]

#: A slope has failed beyond .2, a level beyond 2 dB, half of these; what can be estimated, 1 < slope < 5, and 60 dB.
_SCALES = {"slope": 0.4, "level": 4.0}
_WINDOWS = {"slope": 4.0, "level": 60.0}
_DB = 10.0 / np.log(10.0)


def roughness_bounds(capture: xr.Dataset) -> Mapping[str, Bound]:
    """The bounds of `slope` [1] and `level` [dB] (survey); infinite without profiles, none where the surface has no power law."""
    if "truth_slope" not in capture:
        return {}
    sigma = dict.fromkeys(_SCALES, np.inf)
    information = _information(np.asarray(capture["truth_point"].values, np.float64)[:, :, 0])
    if np.linalg.matrix_rank(information) == 2:
        spread = np.sqrt(np.diag(np.linalg.inv(information)))
        sigma = {"slope": float(spread[0]), "level": _DB * float(spread[1])}
    shape = capture["truth_slope"].shape
    return {
        name: Bound(np.full(shape, sigma[name]), "quasi", _SCALES[name], _WINDOWS[name]) for name in ("slope", "level")
    }


def _information(point: Float) -> Float:
    """(2, 2) of the profiles (frame, row, xyz) [m] with three points or more, NaN where a row has none."""
    total = np.zeros((2, 2))
    for one in point:
        held = one[np.isfinite(one).all(axis=1)]
        length = float(np.linalg.norm(held[-1] - held[0])) if len(held) > 2 else 0.0
        if length > 0:
            u = -np.log(np.arange(1, len(held) // 2 + 1) / length / 10.0)
            total += np.array([[float(u @ u), float(u.sum())], [float(u.sum()), float(u.size)]])
    return total
