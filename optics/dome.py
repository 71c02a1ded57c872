"""Rays through a spherical window (a dome) between a housing and the water: exact refraction, both ways.

Camera frame: x right, y down, z forward, the entrance pupil at the origin. Both surfaces are spheres about one centre C, which
stands off the pupil by the decentring. A ray is refracted where it meets each of them, by Snell's law for vectors: with the unit
direction d, the outward normal m, and μ = n₁/n₂,

    d' = μ d + (√(1 − μ²(1 − cos²θ)) − μ cosθ) m,    cosθ = m·d.

A pupil at C meets both spheres squarely: no ray is bent. On the way back the slope of the ray that reaches a point has no closed
form: Newton's method from the straight way.

Source: C. Kunz and H. Singh, OCEANS 2008 (hemispherical refraction); E. Hecht, Optics, 2017, sec. 4.4 (Snell's law).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

__all__ = ["DomePort", "slope_through_dome", "through_dome"]

Float = NDArray[np.float64]

#: Newton steps, step of their differences, and what is left of a slope that was found.
_MOST_STEPS, _STEP, _CLOSE = 60, 1e-6, 1e-11


@dataclass(frozen=True)
class DomePort:
    """A dome of two concentric spheres, with the pupil inside both.

    Main arguments:
        center_m: C, from the entrance pupil [m]. radius_m: of the outer surface. thickness_m: of the glass, >= 0.
        inside, glass, outside: refractive indices, >= 1.
    """

    center_m: tuple[float, float, float]
    radius_m: float
    thickness_m: float
    inside: float
    glass: float
    outside: float

    @property
    def surfaces(self) -> tuple[tuple[float, float, float], ...]:
        """(radius [m], index before, index behind) of the surfaces, in the order in which light from the pupil meets them."""
        inner = self.radius_m - self.thickness_m
        return (inner, self.inside, self.glass), (self.radius_m, self.glass, self.outside)

    @property
    def depth_m(self) -> float:
        """Distance of the outer surface from the entrance pupil along the axis, m; 0 where the axis misses it."""
        x, y, z = self.center_m
        return max(z + float(np.sqrt(max(self.radius_m**2 - x * x - y * y, 0.0))), 0.0)


def through_dome(x: ArrayLike, y: ArrayLike, port: DomePort) -> tuple[Float, Float]:
    """(origin on the outer surface [m], unit direction outside), each (3, …), of rays that leave the pupil along (x, y, 1).

    Rays that are reflected totally hold NaN.
    """
    x, y = np.broadcast_arrays(np.asarray(x, np.float64), np.asarray(y, np.float64))
    inverse = 1.0 / np.sqrt(x * x + y * y + 1.0)
    d = np.stack([x * inverse, y * inverse, inverse])
    center = np.asarray(port.center_m, np.float64).reshape((3,) + (1,) * x.ndim)
    at = np.zeros_like(d)
    for radius, before, behind in port.surfaces:
        from_center = at - center
        along = (from_center * d).sum(axis=0)
        with np.errstate(invalid="ignore"):
            # From inside, the far crossing is the one ahead.
            way = -along + np.sqrt(along * along + radius * radius - (from_center**2).sum(axis=0))
        at = at + d * way
        d = _bent(d, (at - center) / radius, before / behind)
    return at, d


def _bent(d: Float, outward: Float, ratio: float) -> Float:
    """Unit directions behind a surface whose `outward` normal they leave along, `ratio` the index before over that behind."""
    cosine = (d * outward).sum(axis=0)
    with np.errstate(invalid="ignore"):
        behind = np.sqrt(1.0 - ratio * ratio * (1.0 - cosine * cosine))
    return np.asarray(ratio * d + (behind - ratio * cosine) * outward)


def slope_through_dome(point: ArrayLike, port: DomePort) -> tuple[Float, Float]:
    """(x, y) with which the ray (x, y, 1) must leave the pupil to reach a `point` (3, …) [m] beyond the dome.

    NaN for points that are not beyond the dome and before the camera, or that no ray reaches.
    """
    at = np.asarray(point, np.float64)
    center = np.asarray(port.center_m, np.float64).reshape((3,) + (1,) * (at.ndim - 1))
    with np.errstate(invalid="ignore", divide="ignore"):
        beyond = (((at - center) ** 2).sum(axis=0) > port.radius_m**2) & (at[2] > 0)
        x, y = at[0] / np.where(beyond, at[2], np.nan), at[1] / np.where(beyond, at[2], np.nan)
        for _ in range(_MOST_STEPS):
            ex, ey = _miss(x, y, at, port)
            xx, xy = ((b - a) / (2.0 * _STEP) for a, b in _pairs(x, y, at, port, 0))
            yx, yy = ((b - a) / (2.0 * _STEP) for a, b in _pairs(x, y, at, port, 1))
            # xx: of the miss along x by the slope x; xy: along y by x; yx: along x by y.
            det = xx * yy - xy * yx
            move_x, move_y = (yy * ex - yx * ey) / det, (xx * ey - xy * ex) / det
            x, y = x - move_x, y - move_y
            if not np.nanmax(np.maximum(np.abs(move_x), np.abs(move_y)), initial=0.0) > 1e-15 * 4.0:
                break
        ex, ey = _miss(x, y, at, port)
        good = np.hypot(ex, ey) <= _CLOSE
    return np.where(good, x, np.nan), np.where(good, y, np.nan)


def _miss(x: Float, y: Float, point: Float, port: DomePort) -> tuple[Float, Float]:
    """By how much in slope the ray (x, y, 1) passes a point, seen from where it leaves the dome."""
    origin, d = through_dome(x, y, port)
    way = point - origin
    depth = np.where(way[2] > 0, way[2], np.nan)
    return d[0] / d[2] - way[0] / depth, d[1] / d[2] - way[1] / depth


def _pairs(x: Float, y: Float, point: Float, port: DomePort, axis: int) -> list[tuple[Float, Float]]:
    """The misses along x and along y on both sides of a slope."""
    step = (_STEP, 0.0) if axis == 0 else (0.0, _STEP)
    below, above = (_miss(x + sign * step[0], y + sign * step[1], point, port) for sign in (-1.0, 1.0))
    return [(below[0], above[0]), (below[1], above[1])]
