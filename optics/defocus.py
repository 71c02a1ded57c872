"""Defocus of a thin lens before a sensor that may be tilted (Scheimpflug), behind a port or without one.

A lens of focal length f and diameter A = f/N images a point at depth s at v = f s/(s − f). A sensor at v₀ cuts its cone of light in
a disc of diameter

    D = A |1 − v₀/v|,   of second moment D²/16 along each axis

(a pillbox; a Gaussian of equal moment has σ = D/4). The sensor is tilted by τ about the y axis: at x from its middle it lies at
v₀ + x tanτ, so that all points of the plane Z (v₀/f − 1) + X tanτ = v₀ are sharp.

Approximations: paraxial; the disc's widening by 1/cos of the field angle, and the keystone of a tilted sensor, are left out:
columns are those of a sensor square to the axis. Through a port, s is the paraxial apparent depth.

Source: M. Born and E. Wolf, Principles of Optics, 1999, sec. 4.4 and 5.3; T. Scheimpflug, British Patent 1196, 1904.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from .dome import DomePort
from .port import FlatPort

__all__ = ["apparent_depth", "disc_diameter", "scheimpflug_tangent"]

Float = NDArray[np.float64]


def apparent_depth(depth_m: ArrayLike, port: FlatPort | DomePort | None) -> Float:
    """Depth [m] at which a point near the axis at `depth_m` seems to stand from the entrance pupil, through the port.

    At each surface n'/s' = n/s + (n' − n)/R with s from the surface (Born and Wolf, sec. 4.4); a flat window has 1/R = 0.
    """
    z = np.asarray(depth_m, np.float64)
    if port is None:
        return z
    if isinstance(port, DomePort):
        steps = [(port.center_m[2] + radius, behind, before, 1.0 / radius) for radius, before, behind in port.surfaces]
    else:
        steps = [(port.stand_off_m, port.glass, port.inside, 0.0), (port.depth_m, port.outside, port.glass, 0.0)]
    at = z
    for place, outer, inner, curvature in reversed(steps):
        # Light comes from the far side toward the pupil; the sphere's centre lies on the pupil's side.
        at = place + inner / (outer / (at - place) + (outer - inner) * curvature)
    return np.asarray(at)


def disc_diameter(
    depth_m: ArrayLike, x_m: ArrayLike, *, focal_length_m: float, f_number: float, focus_m: float, tilt_tangent: float
) -> Float:
    """D [m] on the sensor of points at (apparent) depth s, seen at `x_m` from the sensor's middle.

    `focus_m`: depth on the axis that is sharp, above the focal length. `tilt_tangent`: tanτ.
    """
    s = np.asarray(depth_m, np.float64)
    sensor = focal_length_m * focus_m / (focus_m - focal_length_m) + np.asarray(x_m, np.float64) * tilt_tangent
    per_image = 1.0 / focal_length_m - 1.0 / s
    return np.asarray(focal_length_m / f_number * np.abs(1.0 - sensor * per_image))


def scheimpflug_tangent(normal: Float, through: Float, focal_length_m: float) -> tuple[float, float]:
    """(depth [m] at which a plane through a point cuts the axis, tanτ of the sensor that has all of the plane in focus).

    The plane contains the y direction, nearly: its part n_y is left out. tanτ = (n_x/n_z) f/(z − f).
    """
    depth = float(normal @ through) / float(normal[2])
    return depth, float(normal[0] / normal[2]) * focal_length_m / (depth - focal_length_m)
