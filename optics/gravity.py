"""A camera's attitude against gravity: pitch and roll, and the level frame that they give.

The level frame has y down along gravity, and z along the camera's heading: level = Rx(pitch) Rz(roll) camera.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

__all__ = ["attitude", "level_matrix", "level_slopes"]

Float = NDArray[np.float64]


def level_matrix(pitch_rad: ArrayLike, roll_rad: ArrayLike) -> Float:
    """Rx(pitch) Rz(roll) (…, 3, 3): from the camera's frame to the level one."""
    p, r = (np.asarray(v, np.float64) for v in np.broadcast_arrays(pitch_rad, roll_rad))
    cp, sp, cr, sr, zero = np.cos(p), np.sin(p), np.cos(r), np.sin(r), np.zeros(p.shape)
    rows = [[cr, -sr, zero], [cp * sr, cp * cr, -sp], [sp * sr, sp * cr, cp]]
    return np.stack([np.stack(row, axis=-1) for row in rows], axis=-2)


def attitude(gravity: ArrayLike) -> tuple[Float, Float]:
    """(pitch, roll) [rad] from the direction of gravity in the camera's frame (…, 3): roll = atan2(g_x, g_y), pitch = −asin g_z."""
    g = np.asarray(gravity, np.float64)
    g = g / np.linalg.norm(g, axis=-1, keepdims=True)
    return np.asarray(-np.arcsin(np.clip(g[..., 2], -1.0, 1.0))), np.arctan2(g[..., 0], g[..., 1])


def level_slopes(pitch_rad: ArrayLike, roll_rad: ArrayLike) -> tuple[Float, Float]:
    """(∂/∂pitch, ∂/∂roll) (…, 3, 3) of `level_matrix`."""
    p, r = (np.asarray(v, np.float64) for v in np.broadcast_arrays(pitch_rad, roll_rad))
    cp, sp, cr, sr, zero = np.cos(p), np.sin(p), np.cos(r), np.sin(r), np.zeros(p.shape)
    by_pitch = [[zero, zero, zero], [-sp * sr, -sp * cr, -cp], [cp * sr, cp * cr, -sp]]
    by_roll = [[-sr, -cr, zero], [cp * cr, -cp * sr, zero], [sp * cr, -sp * sr, zero]]
    made = [np.stack([np.stack(row, axis=-1) for row in rows], axis=-2) for rows in (by_pitch, by_roll)]
    return made[0], made[1]
