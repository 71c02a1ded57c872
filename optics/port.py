"""Rays through a flat window between a housing and the water: exact refraction, both ways.

Camera frame: x right, y down, z forward, the entrance pupil at the origin. The window is square to z. With the slope ρ = tanθ of a
ray inside the housing, Snell's law keeps q = n_i sinθ_i through all layers, so that a ray meets depth z beyond the window at

    R = d tanθ_inside + t tanθ_glass + (z − d − t) tanθ_outside,    sinθ_i = q/n_i,

d the stand-off and t the thickness of the glass. R grows with q and is convex, so that the way back has one solution.

Source: J. S. Jaffe and C. Dunn, Proc. SPIE 980:48, 1988; A. Agrawal et al., CVPR 2012, p. 3346 (flat refraction). Kusters 1992,
Eq. 3.20-3.23, is the special case d = t = 0: a port at the pinhole.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

__all__ = ["FlatPort", "slope_toward", "through_port"]

Float = NDArray[np.float64]

#: Newton steps; each halves its bracket at the least, and mostly doubles the digits.
_MOST_STEPS = 100


@dataclass(frozen=True)
class FlatPort:
    """A flat window square to the axis.

    Main arguments:
        stand_off_m: from the entrance pupil to the inner surface, >= 0. thickness_m: of the glass, >= 0.
        inside, glass, outside: refractive indices, >= 1.
    """

    stand_off_m: float
    thickness_m: float
    inside: float
    glass: float
    outside: float

    @property
    def layers(self) -> tuple[tuple[float, float], ...]:
        """(thickness [m], index) of the layers between the pupil and the outer surface."""
        return (self.stand_off_m, self.inside), (self.thickness_m, self.glass)

    @property
    def depth_m(self) -> float:
        """Distance of the outer surface from the entrance pupil, m."""
        return self.stand_off_m + self.thickness_m


def through_port(x: ArrayLike, y: ArrayLike, port: FlatPort) -> tuple[Float, Float]:
    """(origin on the outer surface [m], unit direction outside), each (3, …), of rays that leave the pupil along (x, y, 1).

    Rays that are reflected totally (an index outside or of the glass below that inside) hold a NaN in origin or direction.
    """
    x, y = np.asarray(x, np.float64), np.asarray(y, np.float64)
    square = x * x + y * y
    sine = np.sqrt(square / (1.0 + square))
    q = port.inside * sine
    radius = sum(depth * _tangent(q, index) for depth, index in port.layers)
    with np.errstate(invalid="ignore", divide="ignore"):
        # On the axis the unit vector across is undefined, and multiplied by zero.
        across = np.where(sine > 0, 1.0 / np.sqrt(np.where(square > 0, square, 1.0)), 0.0)
        out = q / port.outside
        cosine = np.sqrt(1.0 - out * out)
    out = np.where(np.isfinite(cosine), out, np.nan)
    ux, uy = x * across, y * across
    origin = np.stack([ux * radius, uy * radius, np.full_like(sine, port.depth_m)])
    return origin, np.stack([ux * out, uy * out, cosine])


def slope_toward(point: ArrayLike, port: FlatPort) -> tuple[Float, Float]:
    """(x, y) with which the ray (x, y, 1) must leave the pupil to reach a `point` (3, …) [m] beyond the window.

    Newton on R(q) with a bracket, to the last digits. NaN for points that are not beyond the window, or that no ray reaches.
    """
    px, py, pz = np.asarray(point, np.float64)
    radius = np.hypot(px, py)
    beyond = pz - port.depth_m
    least = min(port.inside, port.glass, port.outside)
    low, high = np.zeros_like(radius), np.full_like(radius, least)
    straight = radius / np.where(pz > 0, pz, 1.0)
    q = np.minimum(port.inside * straight / np.sqrt(1.0 + straight * straight), 0.999999 * least)
    layers = (*port.layers, (beyond, port.outside))
    for _ in range(_MOST_STEPS):
        miss = sum(depth * _tangent(q, index) for depth, index in layers) - radius
        slope = sum(depth * _tangent_slope(q, index) for depth, index in layers)
        low, high = np.where(miss <= 0, q, low), np.where(miss > 0, q, high)
        with np.errstate(invalid="ignore", divide="ignore"):
            step = q - miss / slope
        inside = (step > low) & (step < high)
        new = np.where(inside, step, 0.5 * (low + high))
        done = np.abs(new - q) <= 4e-16 * np.abs(q)
        q = np.where(miss == 0, q, new)
        if np.all(done | (miss == 0) | ~(beyond > 0)):
            break
    reached = sum(depth * _tangent(q, index) for depth, index in layers)
    good = (beyond > 0) & (np.abs(reached - radius) <= 1e-9 * np.maximum(radius, 1e-3))
    rho = np.where(good, _tangent(q, port.inside), np.nan)
    with np.errstate(invalid="ignore", divide="ignore"):
        scale = np.where(radius > 0, rho / np.where(radius > 0, radius, 1.0), np.where(good, 0.0, np.nan))
    return px * scale, py * scale


def _tangent(q: Float, index: float) -> Float:
    """tanθ of sinθ = q/n."""
    with np.errstate(invalid="ignore", divide="ignore"):
        return np.asarray(q / np.sqrt((index - q) * (index + q)))


def _tangent_slope(q: Float, index: float) -> Float:
    """d tanθ/dq = n²/(n² − q²)^{3/2}."""
    with np.errstate(invalid="ignore", divide="ignore"):
        return np.asarray(index * index / ((index - q) * (index + q)) ** 1.5)
