"""Effects that a laser-line rig may have: focus, speckle, motion within an exposure, blooming. Absent, each is left out."""

from __future__ import annotations

from typing import Annotated, Literal

import numpy as np
from pydantic import Field

from ...optics.defocus import apparent_depth, disc_diameter, scheimpflug_tangent
from ...optics.pinhole import Pinhole
from ...optics.sheet import Sheet
from ..base import Spec
from ..errors import InputError
from ..quantities import Distance
from .parts import Camera

__all__ = ["Blooming", "Focus", "FocusedLens", "LineEffects", "focused_lens"]


class Focus(Spec):
    """A thin lens of diameter f/N. `distance_m`: depth on the axis that is sharp, in the medium; absent with a `sensor_tilt_deg` of
    "scheimpflug", which puts the laser's plane in focus. The tilt is about the y axis."""

    distance_m: Distance | None = None
    sensor_tilt_deg: Annotated[float, Field(gt=-80, lt=80)] | Literal["scheimpflug"] = 0.0


class Blooming(Spec):
    """Charge beyond the full well spills evenly to both neighbours along `axis`, a share `lost` of it into the drain each time."""

    axis: Literal["columns", "rows"]
    lost: Annotated[float, Field(ge=0.0, le=1.0)]


class LineEffects(Spec):
    """`speckle_looks`: M independent speckle patterns in the light of a pixel; contrast 1/√M. `exposure_poses`: poses of the rig
    within an exposure whose lines are averaged."""

    focus: Focus | None = None
    speckle_looks: Annotated[float, Field(ge=1.0, le=1e9)] | None = None
    exposure_poses: Annotated[int, Field(ge=2, le=1024)] | None = None
    blooming: Blooming | None = None


class FocusedLens:
    """The blur of a lens [px, 1 σ] by depth and column."""

    def __init__(self, camera: Camera, pinhole: Pinhole, focus_m: float, tilt_tangent: float) -> None:
        self.camera, self.pinhole, self.focus_m, self.tilt_tangent = camera, pinhole, focus_m, tilt_tangent

    def sigma_px(self, col: np.ndarray, depth_m: np.ndarray) -> np.ndarray:
        """σ = D/4 over the pixel pitch, of points at depth z seen at columns of one shape."""
        camera = self.camera
        disc = disc_diameter(
            apparent_depth(depth_m, self.pinhole.port), (col - self.pinhole.col0) * camera.pixel_pitch_m,
            focal_length_m=camera.focal_length_m, f_number=camera.f_number, focus_m=self.focus_m,
            tilt_tangent=self.tilt_tangent,
        )  # fmt: skip
        return np.asarray(0.25 * disc / camera.pixel_pitch_m)


def focused_lens(focus: Focus, camera: Camera, pinhole: Pinhole, sheet: Sheet, name: str) -> FocusedLens:
    """The lens of a rig with a focus.

    Raises InputError for a focus within the focal length, a distance beside "scheimpflug" or neither, and a laser's plane along the
    axis.
    """
    where = f"{name}: rig.effects.focus"
    if (focus.distance_m is None) != (focus.sensor_tilt_deg == "scheimpflug"):
        raise InputError(
            "The focus is stated by its distance, or follows from the laser's plane: one of both.", where=where,
            value=focus.model_dump(mode="json"), allowed='distance_m, or sensor_tilt_deg = "scheimpflug"',
        )  # fmt: skip
    if focus.distance_m is not None:
        assert not isinstance(focus.sensor_tilt_deg, str)
        sharp = float(apparent_depth(focus.distance_m, pinhole.port))
        tangent = float(np.tan(np.deg2rad(focus.sensor_tilt_deg)))
    else:
        normal = sheet.normal
        if abs(float(normal[2])) < 1e-6:
            raise InputError(
                "The laser's plane never crosses the camera's axis: no tilt of the sensor puts it in focus.", where=where,
                value=list(map(float, normal)), next_step="give distance_m, or turn the laser toward the axis",
            )  # fmt: skip
        depth, _ = scheimpflug_tangent(normal, sheet.source, camera.focal_length_m)
        sharp = float(apparent_depth(depth, pinhole.port)) if depth > 0 else depth
        # The plane as it seems through the port: as wide, and as deep as points of the axis seem.
        scale = sharp / depth
        seeming = np.array([normal[0], 0.0, normal[2] / scale])
        _, tangent = scheimpflug_tangent(seeming, np.array([0.0, 0.0, sharp]), camera.focal_length_m)
    if not sharp > 1.01 * camera.focal_length_m:
        raise InputError(
            "The lens is focused within its focal length, or behind the camera.", where=where, value=f"{sharp:.4g} m",
            allowed=f"more than {1.01 * camera.focal_length_m:.4g} m (apparent depth, behind a port)",
        )  # fmt: skip
    return FocusedLens(camera, pinhole, sharp, tangent)
