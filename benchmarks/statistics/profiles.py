"""Performance profiles: the share of scenes on which an estimator is within a given factor of the best one."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

__all__ = ["Profile", "performance_profiles"]

Float = npt.NDArray[np.float64]


@dataclass(frozen=True)
class Profile:
    """ρ(τ) of one estimator: a step function, `share[i]` from `factor[i]` on; 0 below `factor[0]` = 1.

    `best`: ρ(1), the share of scenes on which none is better. `area`: mean of ρ over ln τ up to the common end (0..1).
    """

    name: str
    factor: Float
    share: Float
    best: float
    area: float

    def at(self, factor: npt.ArrayLike) -> Float:
        """ρ at the given factors."""
        where = np.searchsorted(self.factor, np.asarray(factor, np.float64), side="right") - 1
        return np.asarray(np.where(where >= 0, self.share[np.maximum(where, 0)], 0.0))


def performance_profiles(names: list[str], figures: npt.ArrayLike) -> list[Profile]:
    """ρ_a(τ) = share of scenes s with x_as <= τ·min_b x_bs, for every estimator a; smaller figures are better.

    Main arguments:
        figures (estimator, scene): positive; infinite where an estimator gave no result (within no factor).
    The area extends to the largest finite ratio of all estimators (2 where all are equal). ρ compares with the best of the
    estimators present: if one is removed, the profiles of the others change (Gould and Scott, ACM TOMS 43:15, 2016).
    Profiles are therefore descriptive, and `pairwise` decides. Raises ValueError for values that are not positive, and for
    a scene without any finite value.
    Source: E. D. Dolan and J. J. Moré, Math. Program. 91:201, 2002.
    """
    x = np.asarray(figures, np.float64)
    if x.ndim != 2 or x.shape[0] != len(names) or x.shape[1] == 0:
        raise ValueError(f"figures must be (estimator, scene) for {len(names)} estimators, not {x.shape}")
    if not np.all(x > 0):
        raise ValueError("figures must be positive")
    best = x.min(axis=0)
    if not np.all(np.isfinite(best)):
        raise ValueError("A scene has no finite figure of any estimator.")
    ratio = x / best
    finite = ratio[np.isfinite(ratio)]
    end = float(np.log(finite.max())) if finite.max() > 1.0 else float(np.log(2.0))
    profiles = []
    for name, row in zip(names, ratio, strict=True):
        factor, first = np.unique(row[np.isfinite(row)], return_counts=True)
        share = np.cumsum(first) / row.size
        if factor.size == 0 or factor[0] > 1.0:
            factor, share = np.concatenate([[1.0], factor]), np.concatenate([[0.0], share])
        area = float(np.maximum(end - np.log(row[np.isfinite(row)]), 0.0).sum()) / (row.size * end)
        profiles.append(Profile(name, factor, share, float(np.mean(row == 1.0)), area))
    return profiles
