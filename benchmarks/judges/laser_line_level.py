"""Truth and bound of points in the gravity frame: the true points, turned by the true attitude of each frame."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import numpy.typing as npt
import xarray as xr

from ...optics.gravity import attitude, level_matrix, level_slopes
from ...optics.rotation import turned_by
from ...scenes.rigs.laser_line import laser_line_rig
from ..bounds.instrument import true_scene
from ..scores.truth import Bound, Truth

__all__ = ["level_bound", "level_truth"]

Float = npt.NDArray[np.float64]


def level_truth(capture: xr.Dataset) -> Mapping[str, Truth]:
    """The truth of `level_point`, L X with L the level matrix of the frame's true pitch and roll; nothing without inclinometers
    or a true scene."""
    found = _attitude(capture)
    if found is None:
        return {}
    turn = level_matrix(*found[:2])
    return {"level_point": Truth.plain(np.einsum("fik,frnk->frni", turn, _points(capture)))}


def level_bound(capture: xr.Dataset, point: Bound) -> Mapping[str, Bound]:
    """The bound of `level_point` from that of `point`: √(Σ_k (L_ik σ_k)² + ((∂L/∂p X)_i σ_m)² + ((∂L/∂r X)_i σ_m)²), σ_m the
    noise of a reading. Kind "quasi": coordinates of a point err alike or oppositely, and all points of a frame share a reading."""
    found = _attitude(capture)
    if found is None:
        return {}
    pitch, roll, sigma_rad = found
    x = _points(capture)
    variance = np.einsum("fik,frnk->frni", level_matrix(pitch, roll) ** 2, point.sigma**2)
    for slope in level_slopes(pitch, roll):
        variance = variance + (np.einsum("fik,frnk->frni", slope, x) * sigma_rad) ** 2
    kind = "none" if point.kind == "none" else "quasi"
    return {"level_point": Bound(np.sqrt(variance), kind, point.scale, point.window)}


def _points(capture: xr.Dataset) -> Float:
    return np.asarray(capture["truth_point"].values, np.float64)


def _attitude(capture: xr.Dataset) -> tuple[Float, Float, float] | None:
    """(true pitch, true roll [rad] (frame), noise of a reading [rad])."""
    if not isinstance(capture.attrs.get("truth_scene"), str):
        return None
    meter = laser_line_rig(true_scene(capture)).inclinometers
    if meter is None:
        return None
    first = level_matrix(np.deg2rad(meter.pitch_deg), np.deg2rad(meter.roll_deg))
    turns = [turned_by(vector) for vector in np.asarray(capture["pose"].values, np.float64)[:, 3:]]
    pitch, roll = attitude(np.stack([turn.T @ first.T @ [0.0, 1.0, 0.0] for turn in turns]))
    return pitch, roll, float(np.deg2rad(meter.sigma_deg))
