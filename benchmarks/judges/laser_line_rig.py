"""What a calibration of a laser-line rig is judged by: the true camera, stand-off and plane, and points at a lattice of pixels.

Nodes of the lattice (`estimators.laser_line.described`) are scored where the true sheet lies at depths at which the capture
shows the line on its boards, a tenth more to either side: there the calibration is meant to be used. In air a port does not
tell its stand-off: it has no truth there.

No bound is known: that of the corners is one of the texture and its light. A quantity has failed beyond

    node: a column at the middle depth      focal length: 1 %      principal point: 5 px      stand-off: 5 mm
    plane angle: a pixel, 1/f               plane offset: 1 % of the baseline.
"""

from __future__ import annotations

import json
from collections.abc import Mapping

import numpy as np
import numpy.typing as npt
import xarray as xr

from ...estimators.laser_line.described import described, nodes
from ...estimators.laser_line.geometry import Geometry, declared_geometry
from ...estimators.rig import DeclaredRig
from ...optics.port import FlatPort
from ...scenes.declared import declared_rig
from ..bounds.instrument import true_scene
from ..scores.truth import Bound, Truth

__all__ = ["rig_bounds", "rig_truth"]

Float = npt.NDArray[np.float64]

#: Share of the boards' depths by which the scored nodes go beyond them.
_BEYOND = 0.1
#: Difference of the indices before and behind a port from which it tells its stand-off.
_BENDS = 0.01


def rig_truth(capture: xr.Dataset) -> Mapping[str, Truth]:
    """The truth of the stage `calibration`; nothing without a true scene."""
    found = _true(capture)
    if found is None:
        return {}
    geometry, pitch = found
    value = described(geometry, pitch)
    value["node"] = np.where(_scored(capture, value["node"])[:, None], value["node"], np.nan)
    port = geometry.camera.port
    if not isinstance(port, FlatPort) or abs(port.outside - port.inside) <= _BENDS:
        value["stand_off"] = np.full(1, np.nan)
    return {name: Truth.plain(held) for name, held in value.items()}


def rig_bounds(capture: xr.Dataset) -> Mapping[str, Bound]:
    """Bounds of kind "none" of the quantities of `rig_truth`, with the scales of failure."""
    found = _true(capture)
    if found is None:
        return {}
    geometry, pitch = found
    focal_px = geometry.camera.focal_px
    value = described(geometry, pitch)
    held = _scored(capture, value["node"])
    row, col = (part[held] for part in nodes(geometry.rows, geometry.cols))
    step = np.linalg.norm(geometry.points(row, col + 0.5) - geometry.points(row, col - 0.5), axis=0)
    column = float(np.nanmedian(step)) if np.isfinite(step).any() else 1.0
    failed = {
        "node": column, "focal_length": 0.01 * focal_px * pitch, "principal_point": 5.0, "stand_off": 5e-3,
        "plane_angle": 1.0 / focal_px, "plane_offset": 0.01 * abs(float(value["plane_offset"][0])),
    }  # fmt: skip
    # Without a bound an element has failed beyond half of the scale; what can be answered at all is a hundred times as much.
    return {
        name: Bound(np.full(value[name].shape, np.nan), "none", 2.0 * one, 100.0 * one) for name, one in failed.items()
    }


def _true(capture: xr.Dataset) -> tuple[Geometry, float] | None:
    """(true geometry, pixel pitch [m]) of a generated capture."""
    if not isinstance(capture.attrs.get("truth_scene"), str):
        return None
    scene = true_scene(capture).model_copy(update={"declared": {}})
    rig = declared_rig(scene)
    return declared_geometry(DeclaredRig(json.dumps(rig), rig)), float(rig["camera"]["pixel_pitch_m"])


def _scored(capture: xr.Dataset, node: Float) -> npt.NDArray[np.bool_]:
    """Nodes (n, xyz) at depths at which the capture shows the line."""
    depth = np.asarray(capture["truth_point"].values, np.float64)[..., 2]
    depth = depth[np.isfinite(depth)]
    if not depth.size:
        return np.zeros(len(node), bool)
    with np.errstate(invalid="ignore"):
        return np.asarray((node[:, 2] > (1 - _BEYOND) * depth.min()) & (node[:, 2] < (1 + _BEYOND) * depth.max()))
