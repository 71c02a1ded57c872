"""The geometry of a laser-line rig: its camera and sheet as optics knows them, and as plain data that a laboratory would know."""

from __future__ import annotations

from typing import Any

import numpy as np

from ...optics.dome import DomePort
from ...optics.pinhole import Pinhole
from ...optics.port import FlatPort
from ...optics.rotation import rotation_matrix
from ...optics.sheet import Sheet, angle_inside
from .laser_line_effects import FocusedLens, focused_lens
from .laser_line_parts import DomeWindow, FlatWindow, NoWindow
from .laser_line_spec import LaserLineRig

__all__ = ["ambient_e_per_s", "camera_data", "line_camera", "line_lens", "line_sheet", "sheet_data"]


def ambient_e_per_s(rig: LaserLineRig, index: float) -> float:
    """Photoelectrons per pixel and second of ambient light, in a medium of phase index `index`.

    A spectrum gives the radiance in the medium, which falls by (inside index/index)² on its way through a port. A rate that
    is stated is what the pixel collects.
    """
    if rig.ambient is None or isinstance(rig.port, NoWindow):
        return rig.ambient_e_per_s
    return rig.ambient_e_per_s * (rig.port.inside_index / index) ** 2


def line_camera(rig: LaserLineRig, index: float) -> Pinhole:
    """The camera in a medium of phase index `index`."""
    camera, port = rig.camera, rig.port
    row, col = rig.principal_offset_px or (0.0, 0.0)
    bent = rig.distortion
    window: FlatPort | DomePort | None = None
    if isinstance(port, DomeWindow):
        window = DomePort(port.center_m, port.radius_m, port.thickness_m, port.inside_index, port.glass_index, index)
    if isinstance(port, FlatWindow):
        window = FlatPort(port.stand_off_m, port.thickness_m, port.inside_index, port.glass_index, index)
    return Pinhole(
        camera.focal_length_m / camera.pixel_pitch_m,
        0.5 * (camera.rows - 1) + row,
        0.5 * (camera.cols - 1) + col,
        (0.0, 0.0, 0.0, 0.0, 0.0) if bent is None else (bent.k1, bent.k2, bent.p1, bent.p2, bent.k3),
        window,
    )


def line_lens(rig: LaserLineRig, camera: Pinhole, sheet: Sheet, name: str) -> FocusedLens | None:
    """The lens's defocus; None where all is sharp. Raises InputError as `focused_lens`."""
    if rig.effects is None or rig.effects.focus is None:
        return None
    return focused_lens(rig.effects.focus, rig.camera, camera, sheet, name)


def line_sheet(rig: LaserLineRig, index: float) -> Sheet:
    """The sheet in a medium of phase index `index`; angles that are stated in air narrow by refraction."""
    laser = rig.laser
    # The whole divergence is halved first: Snell's law holds for the angle from the middle.
    full, half = laser.divergence_rad, laser.fan_half_angle_rad
    if laser.divergence_medium == "air":
        full, half = 2.0 * angle_inside(0.5 * full, index), angle_inside(half, index)
    return Sheet(
        np.asarray(laser.position_m, np.float64), rotation_matrix(laser.rotation_deg), laser.waist_m, laser.waist_at_m, full,
        half, laser.fan_profile,
    )  # fmt: skip


def camera_data(rig: LaserLineRig) -> dict[str, Any]:
    """The camera as declared: its spec, the principal point in pixels and the five numbers of the distortion."""
    made = line_camera(rig, 1.0)
    return rig.camera.model_dump(mode="json") | {
        "principal_row_px": made.row0, "principal_col_px": made.col0, "distortion": list(made.distortion),
    }  # fmt: skip


def sheet_data(rig: LaserLineRig, index: float) -> dict[str, Any]:
    """The laser as declared: a point of the sheet and its normal, its middle ray, and its widths in the medium."""
    sheet = line_sheet(rig, index)
    return {
        "wavelength_m": rig.laser.wavelength_m,
        "power_w": rig.laser.power_w,
        "position_m": sheet.source.tolist(),
        "normal": sheet.normal.tolist(),
        "axis": sheet.frame[:, 2].tolist(),
        "waist_m": sheet.waist_m,
        "waist_at_m": sheet.waist_at_m,
        "divergence_rad": sheet.divergence_rad,
        "fan_half_angle_rad": sheet.fan_half_angle_rad,
    }
