"""The gate of every pixel: how much later it opens than that of the middle pixel, from a scan over a surveyed target.

The gate of an intensifier opens first at the rim of the tube ("irising"), and askew where it is fed from one side. With τ_i
the time of the echo that is fitted in pixel i alone and τ°_i its time by the survey, the gate opens by o_i = τ°_i − τ_i later
than declared, and

    o_i = c + k ρ_i² + s_x x_i + s_y y_i                     (ρ, x, y as of `optics.correlation.gate_maps`)

by least squares with weights 1/σ_i² over pixels with one echo; c is that of all pixels, the time zero. Covariance: (XᵀWX)⁻¹ times
χ² per degree of freedom where that is above 1, as where single pixels differ from the map. Times of whole frames that vary
move all pixels alike, and only c.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from ...optics.correlation.gate_maps import gate_offset_map
from .gated_noise import Found
from .gated_scan import DelayScan
from .gated_single import fit_one_echo
from .gated_widths import lit_pixels

__all__ = ["GateTiming", "declared_map_s", "gate_timing"]

Float = npt.NDArray[np.float64]

#: Fewest pixels of a map of four numbers, and least share of the image: a lit spot in its middle says nothing of the corners.
_LEAST, _SHARE = 12, 0.25
#: Pixels whose time is farther from the map than so many median residuals are left out, in so many rounds: another surface.
_OUTLIER, _ROUNDS = 6.0, 10
#: χ² of three numbers beyond which the map is none of 0: one even gate in ten thousand.
_TOLD = 21.11


@dataclass(frozen=True, eq=False)
class GateTiming:
    """A map of gates.

    Main arguments:
        iris, skew_x, skew_y: k, s_x and s_y, s. told: whether they differ from those of an even gate; never in a medium that
            scatters, whose light looks alike.
        offset_s: k ρ² + s_x x + s_y y of each pixel (pixel), s.
    Other arguments:
        scatter_s: rms distance of single pixels from the map, beyond their noise, s; 0 where noise explains it. chi2: per degree of
            freedom.
    """

    iris: Found
    skew_x: Found
    skew_y: Found
    told: bool
    offset_s: Float
    scatter_s: float
    chi2: float


def declared_map_s(scan: DelayScan) -> Float | None:
    """The declared offsets of the gates (pixel), s; None where the rig declares none."""
    if scan.rig.get("gate_offset_s") is None:
        return None
    iris = scan.rig.number("gate_offset_s.iris_s")
    skew = scan.rig.numbers("gate_offset_s.skew_s", length=2)
    return gate_offset_map(*scan.shape, iris, (float(skew[0]), float(skew[1]))).ravel()


def gate_timing(scan: DelayScan, known_s: Float) -> GateTiming | None:
    """The map of a scan; None where fewer than 12 pixels, or a quarter of the image, show one echo, or the image has
    one row or column.

    Main arguments:
        scan: of a target. known_s: times of its echoes by the survey (pixel), s.

    Raises:
        InputError: as `fit_one_echo`.
    """
    fit = fit_one_echo(scan)
    used = lit_pixels(fit) & fit.single & np.isfinite(fit.tau_sigma_s) & (fit.tau_sigma_s > 0)
    if int(used.sum()) < max(_LEAST, _SHARE * used.size) or min(scan.shape) < 2:
        return None
    design = _design(*scan.shape)
    off = np.where(used, known_s - fit.tau_s, 0.0)
    weight = np.where(used, 1.0 / np.where(used, fit.tau_sigma_s, 1.0) ** 2, 0.0)
    for _ in range(_ROUNDS):
        inverse = np.linalg.inv(design.T @ (weight[:, None] * design))
        value = inverse @ (design.T @ (weight * off))
        rest = off - design @ value
        counted = weight > 0
        median = 1.4826 * float(np.median(np.abs(rest[counted])))
        kept = np.where(np.abs(rest) <= _OUTLIER * np.maximum(median, fit.tau_sigma_s), weight, 0.0)
        if (kept > 0).sum() in (counted.sum(), *range(_LEAST)):
            break
        weight = kept
    chi2 = float((weight * rest**2).sum()) / (int(counted.sum()) - 4)
    covariance = inverse * max(chi2, 1.0)
    told = _clear(scan) and float(value[1:] @ np.linalg.solve(covariance[1:, 1:], value[1:])) > _TOLD
    beyond = float((weight * rest**2).sum() / weight.sum()) * max(1.0 - 1.0 / max(chi2, 1e-9), 0.0)
    iris, skew_x, skew_y = (Found(float(value[k]), math.sqrt(covariance[k, k])) for k in (1, 2, 3))
    return GateTiming(iris, skew_x, skew_y, told, design[:, 1:] @ value[1:], math.sqrt(beyond), chi2)


def _clear(scan: DelayScan) -> bool:
    """Whether the declared medium scatters nothing: what it scatters comes early, more of it at the rim, as from an iris."""
    return float(scan.rig.get("medium.scattering_per_m") or 0.0) == 0.0


def _design(rows: int, cols: int) -> Float:
    """Columns 1, ρ², x, y of every pixel (pixel, 4)."""
    units = ((1.0, (0.0, 0.0)), (0.0, (1.0, 0.0)), (0.0, (0.0, 1.0)))
    return np.stack([np.ones(rows * cols), *(gate_offset_map(rows, cols, *one).ravel() for one in units)], axis=1)
