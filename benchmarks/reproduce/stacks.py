"""A gated stack of two surfaces in closed form, read by a weighted average and by the range model of Guo et al. 2017.

Noise is neglected: the errors of Table 1 are ten times what 8.894 mm of noise would give, and averaged over many pixels.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ...optics.constants import C_M_PER_S

__all__ = [
    "Rig", "cubic_average", "delays", "depth", "fitted_offset", "plausible_rigs", "sigma_m", "slices", "weighted_average",
]  # fmt: skip

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Rig:
    """A range-gated rig and the position of the objects, as far as the depth error depends on them.

    Main fields:
        sigma_s, step_s: width of the (Gaussian) correlation R, and step of the delays.
        background_m: range of the background.
        near_sigmas, far_sigmas: extent of the delays beyond the front of Object 1, and beyond the background, in σ.
        wall: signal of the background over that of Object 1.
        weaker: signal of Object 2 over that of Object 1.
    """

    sigma_s: float
    step_s: float
    background_m: float
    near_sigmas: float
    far_sigmas: float
    wall: float
    weaker: float


def plausible_rigs(
    sigma_times_step_s2: float, deepest_m: float, far_sigmas: tuple[float, ...] = (3.0, 5.0)
) -> list[Rig]:
    """Rigs with the σ·t_step of the set-up that agree with the text (Object 2 is the less reflective one)."""
    rigs = []
    for sigma in (0.9e-9, 1.8e-9, 3.0e-9):
        for background in (3.0, 5.0, 10.0):
            for near in (3.0, 5.0):
                for far in far_sigmas:
                    for wall in (0.5, 1.0, 2.0):
                        for weaker in (0.3, 0.5, 0.7, 0.9):
                            if background - deepest_m - near * sigma * 0.5 * C_M_PER_S > 0.0:
                                rig = Rig(sigma, sigma_times_step_s2 / sigma, background, near, far, wall, weaker)
                                rigs.append(rig)
    return rigs


def sigma_m(rig: Rig) -> float:
    """σ of the response as a range, m."""
    return 0.5 * C_M_PER_S * rig.sigma_s


def delays(rig: Rig, deepest_m: float) -> Array:
    """Ranges of the slices, m."""
    step_m = 0.5 * C_M_PER_S * rig.step_s
    low = rig.background_m - deepest_m - rig.near_sigmas * sigma_m(rig)
    high = rig.background_m + rig.far_sigmas * sigma_m(rig)
    return np.arange(low, high + 0.5 * step_m, step_m)


def slices(rig: Rig, range_m: float, signal: float, deepest_m: float) -> tuple[Array, Array]:
    """(ranges of the slices in m, intensities): a Gaussian response about `range_m`, peak `signal`."""
    r = delays(rig, deepest_m)
    return r, signal * np.exp(-0.5 * ((r - range_m) / sigma_m(rig)) ** 2)


def _kept(intensity: Array, threshold: float) -> Array:
    return np.where(intensity >= threshold * intensity.max(), intensity, 0.0)


def weighted_average(r: Array, intensity: Array, threshold: float = 0.0) -> float:
    """Σ I r/Σ I over the slices of at least `threshold` times the brightest, m."""
    kept = _kept(intensity, threshold)
    return float(np.sum(kept * r) / np.sum(kept))


def cubic_average(r: Array, intensity: Array, threshold: float = 0.0) -> float:
    """Σ I r³/Σ I r², m: Eq. 24 without its cancelling factor and its cosine."""
    kept = _kept(intensity, threshold)
    return float(np.sum(kept * r**3) / np.sum(kept * r**2))


def depth(rig: Rig, depth_m: float, signal: float, offset: float, deepest_m: float, *, cubic: bool = False,
          threshold: float = 0.0) -> float:  # fmt: skip
    """Depth by a method for an object `depth_m` in front of the background, with `offset` in every slice, m."""
    average = cubic_average if cubic else weighted_average
    near, far = (
        average(*_with(slices(rig, at, level, deepest_m), offset), threshold)
        for at, level in ((rig.background_m - depth_m, signal), (rig.background_m, rig.wall))
    )
    return far - near


def _with(stack: tuple[Array, Array], offset: float) -> tuple[Array, Array]:
    return stack[0], stack[1] + offset


def fitted_offset(rig: Rig, depth_m: float, error: float, deepest_m: float) -> float:
    """Least offset, relative to the peak of Object 1, at which the relative depth error of the weighted average is ±`error`.

    NaN if there is none. Scanned over 1e-4 … 1 and refined by bisection: the error starts near 0 and grows with the offset.
    """

    def excess(offset: float) -> float:
        return abs(depth(rig, depth_m, 1.0, offset, deepest_m) / depth_m - 1.0) - error

    grid = np.geomspace(1e-4, 1.0, 25)
    above = [i for i, offset in enumerate(grid) if excess(float(offset)) > 0.0]
    if not above or above[0] == 0:
        return float("nan")
    low, high = float(grid[above[0] - 1]), float(grid[above[0]])
    for _ in range(40):
        middle = 0.5 * (low + high)
        low, high = (low, middle) if excess(middle) > 0.0 else (middle, high)
    return 0.5 * (low + high)
