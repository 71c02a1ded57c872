"""Parts of the laser-line rig: the laser and its sheet, lens distortion, the port, the frames. No physical value has a default."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field

from ..base import Index, Spec
from ..quantities import OptionalLength, Place, Power, SmallLength

__all__ = ["Distortion", "DomeWindow", "FlatWindow", "Frames", "NoWindow", "SheetLaser", "Window"]

_Degrees = Annotated[float, Field(gt=-180, le=180)]
_Small = Annotated[float, Field(ge=-10, le=10)]


class SheetLaser(Spec):
    """A laser whose light is spread into a sheet.

    The sheet leaves `position_m` (camera frame) as a fan in the y-z plane about the z axis, turned by `rotation_deg` about x,
    then y, then z. Across, its full width at 1/e² is W² = waist² + (divergence·(r − waist_at))², r from the source.

    `divergence_rad` (full angle) and `fan_half_angle_rad` are stated in air, before a window square to the beam, or in the
    medium around the rig ("water"): `divergence_medium`. `fan_profile`: "flat-top" ends at the half angle, "gaussian" falls
    there to 1/e² of its middle.
    """

    wavelength_m: Annotated[float, Field(gt=1e-7, lt=2e-5)]
    power_w: Power
    position_m: Place
    rotation_deg: tuple[_Degrees, _Degrees, _Degrees]
    waist_m: SmallLength
    waist_at_m: OptionalLength
    divergence_rad: Annotated[float, Field(ge=0, le=0.5)]
    divergence_medium: Literal["air", "water"]
    fan_profile: Literal["flat-top", "gaussian"]
    fan_half_angle_rad: Annotated[float, Field(ge=1e-6, le=1.5)]


class Distortion(Spec):
    """Brown's distortion of slopes: radial k1, k2, k3 and decentring p1, p2."""

    k1: _Small
    k2: _Small
    p1: _Small
    p2: _Small
    k3: _Small


class NoWindow(Spec):
    """The camera stands in the medium itself: focal length and f-number are those of the equivalent camera there."""

    kind: Literal["none"] = "none"


class FlatWindow(Spec):
    """A flat window square to the camera's axis. `stand_off_m`: from the entrance pupil to its inner surface.

    What it reflects is part of the camera's `transmission`.
    """

    kind: Literal["flat"] = "flat"
    stand_off_m: Annotated[float, Field(ge=0, le=10)]
    thickness_m: Annotated[float, Field(ge=0, le=1)]
    glass_index: Index
    inside_index: Index


class DomeWindow(Spec):
    """A dome of two concentric spheres. `center_m`: their centre from the entrance pupil, the decentring; `radius_m`: of the
    outer one.

    What it reflects is part of the camera's `transmission`.
    """

    kind: Literal["dome"] = "dome"
    center_m: Place
    radius_m: Annotated[float, Field(gt=0, le=10)]
    thickness_m: Annotated[float, Field(ge=0, le=1)]
    glass_index: Index
    inside_index: Index


Window = Annotated[NoWindow | FlatWindow | DomeWindow, Field(discriminator="kind")]


class Frames(Spec):
    """`lit` frames with the laser on, then `laser_off` frames without, one every `interval_s` from time 0."""

    lit: Annotated[int, Field(ge=1, le=65536)]
    laser_off: Annotated[int, Field(ge=0, le=65536)]
    interval_s: Annotated[float, Field(ge=1e-9, le=1e6)]
