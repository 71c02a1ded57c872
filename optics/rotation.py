"""Rotations: from angles about the axes, and from rotation vectors."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

__all__ = ["rotation_matrix", "turned_by"]


def rotation_matrix(rotation_deg: tuple[float, float, float]) -> NDArray[np.float64]:
    """Right-handed rotation about x, then y, then z (fixed axes): R = Rz Ry Rx."""
    ax, ay, az = np.deg2rad(rotation_deg)
    cx, sx, cy, sy, cz, sz = np.cos(ax), np.sin(ax), np.cos(ay), np.sin(ay), np.cos(az), np.sin(az)
    rx = np.array([[1, 0, 0], [0, cx, -sx], [0, sx, cx]])
    ry = np.array([[cy, 0, sy], [0, 1, 0], [-sy, 0, cy]])
    rz = np.array([[cz, -sz, 0], [sz, cz, 0], [0, 0, 1]])
    return np.asarray(rz @ ry @ rx)


def turned_by(vector_rad: ArrayLike) -> NDArray[np.float64]:
    """Rotation by the angle |v| about v (3), R = I + sin|v| K + (1 − cos|v|) K², K the cross product with v/|v| (Rodrigues)."""
    v = np.asarray(vector_rad, np.float64)
    angle = float(np.sqrt(v @ v))
    if angle == 0.0:
        return np.eye(3)
    x, y, z = v / angle
    k = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    return np.asarray(np.eye(3) + np.sin(angle) * k + (1.0 - np.cos(angle)) * (k @ k))
