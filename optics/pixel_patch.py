"""Triangulation and its predicted error as printed: Kusters 1992, Eq. 3.20 to 3.36, a port without thickness at the pinhole.

The printed camera frame (Fig. 3.1) has x_c along the optical axis, y_c across and z_c along the line; here (d₁, d₂, d₃) =
(−d_y, d_z, d_x). The camera is turned by α toward the laser, which lies at distance b; Eq. 3.31-3.32 are read with that turn
applied (Eq. 3.24-3.25), and d_y − w/2 of Eq. 3.33-3.34 as the far corner, which the text asks for: the pixel coordinate on
the sensor, opposite to the ray's. The scan garbles most symbols; they are read with the derivation around them. `optics.port`
holds the same for a port with stand-off and thickness.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

__all__ = [
    "direction_eq3_22", "incidence_eq3_20", "patch_corner_eq3_33", "point_eq3_32", "predicted_error_m", "refracted_eq3_21",
]  # fmt: skip

Float = NDArray[np.float64]


def incidence_eq3_20(d1_m: ArrayLike, d2_m: ArrayLike, focal_length_m: float) -> Float:
    """β = arctan(√(d₁² + d₂²)/f) [rad]: angle of incidence on the port of the ray through the image point (d₁, d₂) [m]."""
    return np.asarray(np.arctan(np.hypot(d1_m, d2_m) / focal_length_m))


def refracted_eq3_21(incidence_rad: ArrayLike, index: float) -> Float:
    """γ = arcsin(sinβ/n) [rad], n the relative index of refraction."""
    return np.asarray(np.arcsin(np.sin(incidence_rad) / index))


def direction_eq3_22(d1_m: ArrayLike, d2_m: ArrayLike, focal_length_m: float, index: float) -> Float:
    """d = d₁ i + d₂ j + d₃ k (3, …) [m], d₃ = √(d₁² + d₂²)/tanγ (Eq. 3.23), which tends to n f on the axis."""
    d1, d2 = np.broadcast_arrays(np.asarray(d1_m, np.float64), np.asarray(d2_m, np.float64))
    radius = np.hypot(d1, d2)
    tangent = np.tan(refracted_eq3_21(incidence_eq3_20(d1, d2, focal_length_m), index))
    with np.errstate(divide="ignore", invalid="ignore"):
        along = np.where(radius > 0, radius / np.where(radius > 0, tangent, 1.0), index * focal_length_m)
    return np.stack([d1, d2, along])


def point_eq3_32(direction: Float, baseline_m: float, angle_rad: float) -> Float:
    """Point (3, …) [m] of the laser's plane, in the laser's frame: x across the plane, y along the line, z the range.

    Eq. 3.24 and 3.25 turn by α and shift by b; Eq. 3.26 to 3.31 meet the plane x = 0 at t = −b/(N·d).
    """
    c, s = np.cos(angle_rad), np.sin(angle_rad)
    across = c * direction[0] + s * direction[2]
    ahead = -s * direction[0] + c * direction[2]
    # The camera stands at x = −b; Eq. 3.30: the parameter at which the ray has come across by b.
    with np.errstate(divide="ignore", invalid="ignore"):
        t = baseline_m / across
    return np.stack([np.zeros_like(t), t * direction[1], t * ahead])


def patch_corner_eq3_33(
    d1_m: ArrayLike,
    d2_m: ArrayLike,
    pixel_m: float,
    focal_length_m: float,
    index: float,
    baseline_m: float,
    angle_rad: float,
) -> Float:
    """Farthest corner (3, …) [m] of the pixel's patch on the laser's plane: half a pixel w/2 farther along the range axis, and
    half a pixel outward along the line (Eq. 3.33, with Eq. 3.34 to 3.36 for the ray of that corner)."""
    d2 = np.asarray(d2_m, np.float64)
    outward = np.where(d2 >= 0, 0.5, -0.5) * pixel_m
    corner = direction_eq3_22(np.asarray(d1_m) - 0.5 * pixel_m, d2 + outward, focal_length_m, index)
    return point_eq3_32(corner, baseline_m, angle_rad)


def predicted_error_m(
    range_m: ArrayLike, *, pixel_m: float, focal_length_m: float, index: float, baseline_m: float, angle_rad: float,
    aberration_m: float = 0.0,
) -> Float:  # fmt: skip
    """Distance [m] of that corner from the laser less that of the pixel's centre, for points straight ahead at `range_m`.

    w is the pixel's width with the greatest lateral aberration of the lens added (sec. 3.3.1 and 3.3.4), `aberration_m` [m] on
    the sensor. About R² w/(2 n f b): the error grows with the square of the range.
    """
    r = np.asarray(range_m, np.float64)
    # The image of (0, 0, R) of the laser's frame: back through Eq. 3.24 and 3.25, then through the port.
    c, s = np.cos(angle_rad), np.sin(angle_rad)
    x, z = c * baseline_m - s * r, s * baseline_m + c * r
    sine = index * np.sin(np.arctan(x / z))
    d1 = focal_length_m * np.tan(np.arcsin(sine))
    far = patch_corner_eq3_33(d1, 0.0, pixel_m + aberration_m, focal_length_m, index, baseline_m, angle_rad)
    return np.asarray(np.sqrt((far**2).sum(axis=0)) - r)
