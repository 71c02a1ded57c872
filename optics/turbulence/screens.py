"""Phase screens of Kolmogorov and von Karman turbulence, right at all lags."""

from __future__ import annotations

from functools import lru_cache

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.special import gamma, kv

from .embedding import ScreenPlan, covariance_plan, structure_plan
from .strength import FRIED, kolmogorov_structure, positive

__all__ = [
    "kolmogorov_plan", "kolmogorov_screen", "von_karman_covariance", "von_karman_plan", "von_karman_screen",
    "von_karman_structure",
]  # fmt: skip

Float = NDArray[np.float64]

#: Correlation of von Karman phase falls as e^{−2πr/L₀}; cut at 2.5 L₀ it is below 1e-6.
_SUPPORT = 2.5

#: Outer scale, in diagonals of the grid, from which intrinsic embedding has no negative power (it is measured: 2.0 has none).
_INTRINSIC = 2.1


def kolmogorov_plan(r0_m: float, shape: tuple[int, int], spacing_m: float) -> ScreenPlan:
    """Plan of screens with D(ρ) = 6.88388 (ρ/r₀)^{5/3} at every lag. Draw many from one plan.

    Main arguments:
        r0_m: Fried's length. shape: rows, columns. spacing_m: distance of the points.

    Raises ValueError for lengths that are not positive or a shape that is not.
    """
    rows, cols = (int(n) for n in shape)
    positive(spacing_m, "spacing_m")
    unit = _unit_plan(rows, cols)
    factor = (spacing_m / positive(r0_m, "r0_m")) ** (5.0 / 6.0)
    return ScreenPlan(
        unit.root * factor, unit.period, unit.shape, spacing_m, unit.tilt_rad_per_m * factor / spacing_m, unit.clipped
    )


def kolmogorov_screen(r0_m: float, shape: tuple[int, int], spacing_m: float, rng: np.random.Generator) -> Float:
    """One Kolmogorov phase screen (rows, cols) [rad] without piston. Arguments as for `kolmogorov_plan`; `rng` is advanced.

    The plans of the last few shapes are kept; a screen then costs two real FFTs of about 3.9 times its size in each direction.
    """
    return kolmogorov_plan(r0_m, shape, spacing_m).draw(rng)


def von_karman_covariance(separation_m: ArrayLike, r0_m: float, outer_scale_m: float) -> Float:
    """B(r) = (L₀/r₀)^{5/3} c (2πr/L₀)^{5/6} K_{5/6}(2πr/L₀) rad², c = Γ(11/6) [24/5 Γ(6/5)]^{5/6}/(2^{5/6} π^{8/3}).

    `outer_scale_m` L₀. Source: R. Conan, PhD thesis, Nice, 2000; A. Tokovinin, PASP 114:1156, 2002.
    """
    x = 2.0 * np.pi * np.abs(np.asarray(separation_m, np.float64)) / positive(outer_scale_m, "outer_scale_m")
    return np.asarray(_scale(r0_m, outer_scale_m) * (_AT_ZERO - _fall(x)))


def von_karman_structure(separation_m: ArrayLike, r0_m: float, outer_scale_m: float) -> Float:
    """D(r) = 2(B(0) − B(r)) [rad²], without loss of digits at r ≪ L₀, where it tends to Kolmogorov's."""
    x = 2.0 * np.pi * np.abs(np.asarray(separation_m, np.float64)) / positive(outer_scale_m, "outer_scale_m")
    return np.asarray(2.0 * _scale(r0_m, outer_scale_m) * _fall(x))


def von_karman_plan(r0_m: float, outer_scale_m: float, shape: tuple[int, int], spacing_m: float) -> ScreenPlan:
    """Plan of von Karman screens: intrinsic embedding for outer scales over 2.1 diagonals of the grid, else of the covariance.

    Raises ValueError for lengths that are not positive or a shape that is not.
    """
    reach = spacing_m * float(np.hypot(shape[0] - 1, shape[1] - 1))
    if positive(outer_scale_m, "outer_scale_m") < _INTRINSIC * reach:
        support = max(_SUPPORT * outer_scale_m, reach)
        return covariance_plan(lambda r: von_karman_covariance(r, r0_m, outer_scale_m), shape, spacing_m, support)
    return structure_plan(lambda r: von_karman_structure(r, r0_m, outer_scale_m), shape, spacing_m)


def von_karman_screen(
    r0_m: float, outer_scale_m: float, shape: tuple[int, int], spacing_m: float, rng: np.random.Generator
) -> Float:
    """One von Karman phase screen (rows, cols) [rad] without piston; `rng` is advanced."""
    return von_karman_plan(r0_m, outer_scale_m, shape, spacing_m).draw(rng)


@lru_cache(maxsize=4)
def _unit_plan(rows: int, cols: int) -> ScreenPlan:
    """The plan for r₀ = 1 m and points 1 m apart; others differ by a factor."""
    reach = float(np.hypot(rows - 1, cols - 1)) or 1.0
    slopes = (5.0 / 3.0 * FRIED * reach ** (2.0 / 3.0), 10.0 / 9.0 * FRIED * reach ** (-1.0 / 3.0))
    plan = structure_plan(lambda r: kolmogorov_structure(r, 1.0), (rows, cols), 1.0, slopes=slopes)
    plan.root.flags.writeable = False
    return plan


_FACTOR = float(gamma(11.0 / 6.0) * (FRIED / 2.0) / (2.0 ** (5.0 / 6.0) * np.pi ** (8.0 / 3.0)))
_AT_ZERO = float(2.0 ** (-1.0 / 6.0) * gamma(5.0 / 6.0))  # x^{5/6} K_{5/6}(x) at 0


def _scale(r0_m: float, outer_scale_m: float) -> float:
    return float(_FACTOR * (outer_scale_m / positive(r0_m, "r0_m")) ** (5.0 / 3.0))


def _fall(x: Float) -> Float:
    """2^{−1/6} Γ(5/6) − x^{5/6} K_{5/6}(x): by series below 0.5, where the difference loses digits."""
    safe = np.maximum(x, 0.25)
    far = _AT_ZERO - safe ** (5.0 / 6.0) * kv(5.0 / 6.0, safe)
    # K_ν = π/2 (I_{−ν} − I_ν)/sin νπ, both as power series in x²/4.
    t = 0.25 * np.minimum(x, 0.5) ** 2
    minus = np.zeros_like(t)
    plus = np.zeros_like(t)
    term_minus, term_plus = np.ones_like(t) / gamma(1.0 / 6.0), np.ones_like(t) / gamma(11.0 / 6.0)
    for k in range(1, 12):
        plus = plus + term_plus
        term_minus = term_minus * t / (k * (k - 5.0 / 6.0))
        term_plus = term_plus * t / (k * (k + 5.0 / 6.0))
        minus = minus + term_minus  # without the constant, which is _AT_ZERO
    half = 0.5 * np.pi / np.sin(5.0 * np.pi / 6.0)
    near = half * (2.0 ** (-5.0 / 6.0) * np.minimum(x, 0.5) ** (5.0 / 3.0) * plus - 2.0 ** (5.0 / 6.0) * minus)
    return np.where(x < 0.5, near, far)
