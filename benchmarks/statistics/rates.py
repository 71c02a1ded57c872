"""Intervals of proportions: elements that failed, were refused, or had their error within the stated interval."""

from __future__ import annotations

import math

import numpy as np
import numpy.typing as npt

__all__ = ["clustered_interval", "wilson_interval"]


def wilson_interval(successes: float, n: float, *, level: float = 0.95) -> tuple[float, float]:
    """Interval of a proportion of n independent elements: valid at 0 and 1, where the normal interval has no width.

    `n` need not be whole (an effective number). (NaN, NaN) for n <= 0.
    Source: E. B. Wilson, J. Am. Stat. Assoc. 22:209, 1927.
    """
    from scipy.special import ndtri

    return _wilson(successes, n, float(ndtri(0.5 + level / 2.0)))


def _wilson(successes: float, n: float, z: float) -> tuple[float, float]:
    if not n > 0:
        return math.nan, math.nan
    p, z2 = successes / n, z * z
    middle = (p + z2 / (2 * n)) / (1 + z2 / n)
    half = z / (1 + z2 / n) * math.sqrt(max(p * (1 - p), 0.0) / n + z2 / (4 * n * n))
    # At the ends the two terms are equal but for rounding.
    return 0.0 if p <= 0 else max(middle - half, 0.0), 1.0 if p >= 1 else min(middle + half, 1.0)


def clustered_interval(
    successes: npt.ArrayLike, n: npt.ArrayLike, *, level: float = 0.95
) -> tuple[float, float, float]:
    """(rate, low, high) of a proportion pooled over scenes, for elements of a scene that fail together.

    Main arguments:
        successes, n (scene): counts per scene; scenes without elements are ignored.
    Wilson's interval at the effective number n/d, with the design effect d = s²/(p(1−p)/n) of the ratio estimate over
    scenes, s² = S/(S−1) Σ (x_i − p n_i)²/n², held at d >= 1; z becomes Student's t with S − 1 degrees of freedom. At
    p = 0 and 1 the clustering cannot be estimated: then each scene counts as one element, the conservative limit. One
    scene: (rate, NaN, NaN).
    Source: J. N. K. Rao and A. J. Scott, Biometrics 48:577, 1992 (design effect).
    """
    from scipy.special import stdtrit

    x, count = np.asarray(successes, np.float64), np.asarray(n, np.float64)
    x, count = x[count > 0], count[count > 0]
    total = float(count.sum())
    if total == 0:
        return math.nan, math.nan, math.nan
    p, scenes = float(x.sum()) / total, x.size
    if scenes < 2:
        return p, math.nan, math.nan
    if 0.0 < p < 1.0:
        variance = scenes / (scenes - 1) * float(((x - p * count) ** 2).sum()) / total**2
        effective = total / max(variance / (p * (1 - p) / total), 1.0)
    else:
        effective = float(scenes)
    wide = float(stdtrit(scenes - 1, 0.5 + level / 2.0))
    low, high = _wilson(p * effective, effective, wide)
    return p, low, high
