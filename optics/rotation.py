"""Rotations: from angles about the axes, and from rotation vectors."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

__all__ = ["rotation_angles_deg", "rotation_matrix", "turned_by"]


def rotation_matrix(rotation_deg: tuple[float, float, float]) -> NDArray[np.float64]:
    """Right-handed rotation about x, then y, then z (fixed axes): R = Rz Ry Rx."""
    ax, ay, az = np.deg2rad(rotation_deg)
    cx, sx, cy, sy, cz, sz = np.cos(ax), np.sin(ax), np.cos(ay), np.sin(ay), np.cos(az), np.sin(az)
    rx = np.array([[1, 0, 0], [0, cx, -sx], [0, sx, cx]])
    ry = np.array([[cy, 0, sy], [0, 1, 0], [-sy, 0, cy]])
    rz = np.array([[cz, -sz, 0], [sz, cz, 0], [0, 0, 1]])
    return np.asarray(rz @ ry @ rx)


def rotation_angles_deg(matrix: ArrayLike) -> tuple[float, float, float]:
    """Angles [degree] about x, y and z, −180 < a ≤ 180, whose `rotation_matrix` is a given one (3, 3), with |a_y| <= 90.

    R_20 = −sin a_y, tan a_x = R_21/R_22, tan a_z = R_10/R_00. Where a_y = ±90 only one combination of the others is told: a_z = 0.
    """
    r = np.asarray(matrix, np.float64)
    about_y = np.arctan2(-r[2, 0], np.hypot(r[0, 0], r[1, 0]))
    if np.hypot(r[0, 0], r[1, 0]) > 1e-12:
        about_x, about_z = np.arctan2(r[2, 1], r[2, 2]), np.arctan2(r[1, 0], r[0, 0])
    else:
        about_x, about_z = np.arctan2(-r[1, 2], r[1, 1]), 0.0
    x, y, z = (180.0 if angle <= -180.0 else float(angle) for angle in np.rad2deg([about_x, about_y, about_z]))
    return x, y, z


def turned_by(vector_rad: ArrayLike) -> NDArray[np.float64]:
    """Rotation by the angle |v| about v (3), R = I + sin|v| K + (1 − cos|v|) K², K the cross product with v/|v| (Rodrigues)."""
    v = np.asarray(vector_rad, np.float64)
    angle = float(np.sqrt(v @ v))
    if angle == 0.0:
        return np.eye(3)
    x, y, z = v / angle
    k = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    return np.asarray(np.eye(3) + np.sin(angle) * k + (1.0 - np.cos(angle)) * (k @ k))
