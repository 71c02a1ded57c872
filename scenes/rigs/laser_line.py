"""The laser-line rig: a sheet of light, and a camera beside it that sees where the sheet meets the target.

The scene is in the frame of the camera at time 0 (x right, y down, z forward, the entrance pupil at the origin), as for every
rig; the baseline is the laser's position. Lines cross the rows: the sheet stands roughly along y, and lies beside the camera
along x.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from ..base import Vec3
from ..errors import InputError
from ..medium_index import medium_data
from .declaring import as_declared
from .kind import RigKind, RigScene, RigView, rig_of
from .laser_line_calibration import calibration_data
from .laser_line_exposure import check_exposure
from .laser_line_geometry import ambient_e_per_s, camera_data, line_camera, line_lens, line_sheet, sheet_data
from .laser_line_spec import LaserLineRig
from .laser_line_view import check_port, check_view
from .parts import Illumination

__all__ = ["KIND", "LaserLineRig", "laser_line_rig"]

#: Least distance of the sheet's plane from the entrance pupil: nearer, every range falls into one column.
_LEAST_BASELINE_M = 1e-4


def laser_line_rig(scene: RigScene) -> LaserLineRig:
    """The scene's rig, which must be a laser-line rig. Raises InputError for a scene of another modality."""
    return rig_of(scene, LaserLineRig)


def _declare(scene: RigScene) -> dict[str, Any]:
    rig, medium = as_declared(scene, LaserLineRig)
    auto = {} if rig.auto_exposure is None else {"auto_exposure": rig.auto_exposure.model_dump(mode="json")}
    meter = {} if rig.inclinometers is None else {"inclinometers": {"sigma_deg": rig.inclinometers.sigma_deg}}
    water = medium_data(medium, rig.wavelength_m)
    return (
        {
            "schema": 1,
            "kind": rig.kind,
            "camera": camera_data(rig),
            "lens_sigma_px": rig.lens_sigma_px,
            "port": rig.port.model_dump(mode="json"),
            "laser": sheet_data(rig, float(water["phase_index"])),
            "medium": water,
            "detector": rig.detector.model_dump(mode="json", exclude={"fixed_pattern_seed"}),
            "ambient_e_per_s": ambient_e_per_s(rig, float(water["phase_index"])),
            "frames": rig.frames.model_dump(mode="json"),
            "t0_s": rig.t0_s,
        }
        | auto
        | meter
        | calibration_data(rig.calibration, rig.camera.pixel_pitch_m, rig.laser.rotation_deg)
    )


def _check(scene: RigScene) -> None:
    """Refuse a sheet that gives no parallax, a camera whose rays do not leave it, and what no rung models."""
    rig = laser_line_rig(scene)
    check_exposure(rig.auto_exposure, rig.detector, scene.name)
    _check_together(rig, scene.name)
    index = float(medium_data(scene.medium, rig.wavelength_m)["phase_index"])
    sheet, camera = line_sheet(rig, index), line_camera(rig, index)
    check_port(rig, camera, scene.name)
    apart = abs(float(sheet.normal @ sheet.source))
    if apart < _LEAST_BASELINE_M:
        raise InputError(
            "The laser's sheet passes through the camera's entrance pupil: the line stays in place at every range.",
            where=f"{scene.name}: rig.laser", value=f"{apart:.3g} m between pupil and sheet",
            allowed=f"{_LEAST_BASELINE_M:g} m or more", next_step="move rig.laser.position_m, or turn rig.laser.rotation_deg",
        )  # fmt: skip
    rows, cols = rig.camera.rows, rig.camera.cols
    corner = camera.rays(np.array([0, 0, rows - 1, rows - 1]), np.array([0, cols - 1, 0, cols - 1]))
    if not all(np.isfinite(part).all() for part in corner):
        raise InputError(
            "No ray leaves the camera through a corner of the image: the port reflects it totally, or the distortion has no "
            "inverse there.",
            where=f"{scene.name}: rig.port", value=rig.port.model_dump(mode="json"),
            allowed="an index outside and a lens that let the whole field through",
            next_step="narrow the field, or check inside_index, glass_index and the distortion",
        )  # fmt: skip
    check_view(rig, camera, sheet, scene.name)
    line_lens(rig, camera, sheet, scene.name)
    if rig.camera.focus_distance_m is not None:
        raise InputError(
            "The focus of a laser-line camera is stated with its other effects.",
            where=f"{scene.name}: rig.camera.focus_distance_m", value=rig.camera.focus_distance_m,
            next_step="give rig.effects.focus.distance_m, or leave it out: all is sharp then",
        )  # fmt: skip
    depth = camera.port.depth_m if camera.port is not None else 0.0
    if rig.laser.position_m[2] < 0 and depth > 0:
        raise InputError(
            "The laser lies behind the entrance pupil of a camera with a port: its light would cross the housing.",
            where=f"{scene.name}: rig.laser.position_m", value=list(rig.laser.position_m), allowed="z >= 0",
        )  # fmt: skip


def _sizes(rig: LaserLineRig) -> tuple[int, int, int]:
    return rig.camera.cols, rig.frames.lit + rig.frames.laser_off, rig.camera.rows


def _places(rig: LaserLineRig) -> dict[str, Vec3]:
    return {"camera": (0.0, 0.0, 0.0), "laser": rig.laser.position_m}


def _view(rig: LaserLineRig) -> RigView:
    """For pictures the sheet is a cone as wide as its fan, about its middle ray."""
    axis = line_sheet(rig, 1.0).frame[:, 2]
    turned = (float(np.arctan2(axis[0], axis[2])), float(np.arctan2(axis[1], axis[2])))
    half = rig.laser.fan_half_angle_rad
    cone = Illumination(profile="flat-top", half_angle_rad=min(half, 1.4), offset_rad=turned)
    return RigView(rig.camera, cone)


def _resize(side: int) -> dict[str, Any]:
    return {"rig.frames.lit": 1, "rig.frames.laser_off": 0, "rig.camera.rows": side * side}


KIND = RigKind(
    "laser_line",
    LaserLineRig,
    declare=_declare,
    check=_check,
    sizes=_sizes,
    places=_places,
    view=_view,
    resize=_resize,
    roles={
        "ambient": "rig.ambient_e_per_s",
        "baseline": "rig.laser.position_m",
        "full-well": "rig.detector.full_well_e",
        "gain": "rig.detector.gain_dn_per_e",
        "light": "rig.laser.power_w",
        "motion": "rig.motion_m_per_s",
        "read-noise": "rig.detector.read_noise_e",
        "stand-off": "rig.port.stand_off_m",
    },
    whole=("rig.distortion", "rig.calibration"),
)


def _check_together(rig: LaserLineRig, name: str) -> None:
    """Refuse options that are modelled one by one and not together."""
    effects, tube = rig.effects, rig.detector.intensifier
    pairs = (
        ("effects.exposure_poses", "auto_exposure", effects is not None and effects.exposure_poses is not None
         and rig.auto_exposure is not None, "the poses are those of the detector's own exposure"),
        ("effects.blooming", "detector.intensifier", effects is not None and effects.blooming is not None and tube is not None,
         "the charge that spills is that behind the tube"),
        ("stations", "motion_m_per_s", rig.stations is not None and rig.motion_m_per_s is not None,
         "a rig at stations stands still"),
        ("stations", "turn_rad_per_s", rig.stations is not None and rig.turn_rad_per_s is not None,
         "a rig at stations stands still"),
        ("stations", "effects.exposure_poses", rig.stations is not None and effects is not None
         and effects.exposure_poses is not None, "a rig at stations stands still"),
        ("auto_exposure", "detector.intensifier", rig.auto_exposure is not None and tube is not None,
         "the control's full well is that of a camera without a tube"),
    )  # fmt: skip
    for one, other, both, why in pairs:
        if both:
            raise InputError(
                f"Two options of the rig are not modelled together: {why}.", where=f"{name}: rig", value=f"{one}, {other}",
                allowed="one of them", next_step=f"leave out rig.{one} or rig.{other}",
            )  # fmt: skip
