"""The spec of a laser-line rig. No physical value has a default."""

from __future__ import annotations

from typing import Annotated, Any, Literal

from pydantic import Field, SerializerFunctionWrapHandler, model_serializer, model_validator

from ..ambient import AmbientSpectrum, ambient_rate, without_computed
from ..quantities import MomentTime, Rate, Velocity
from .kind import RigSpec
from .laser_line_attitude import Inclinometers
from .laser_line_calibration import LineCalibration
from .laser_line_effects import LineEffects
from .laser_line_exposure import AutoExposure
from .laser_line_parts import Distortion, Frames, SheetLaser, Window
from .parts import Camera, Detector, pixel_collected_m2_sr

__all__ = ["LaserLineRig"]

_Turn = Annotated[float, Field(ge=-1e3, le=1e3)]
_Place = Annotated[float, Field(ge=-1e3, le=1e3)]
#: x, y, z [m] and a rotation vector [rad], as the coordinate `pose`.
Station = tuple[_Place, _Place, _Place, _Turn, _Turn, _Turn]
#: Absent options are left out of the data.
_OPTIONAL = (
    "effects", "motion_m_per_s", "turn_rad_per_s", "distortion", "principal_offset_px", "even_light_e_per_s", "auto_exposure",
    "inclinometers", "stations", "calibration",
)  # fmt: skip


class LaserLineRig(RigSpec):
    """A laser line and its camera.

    `lens_sigma_px`: the lens's point spread, a Gaussian (1 σ). `principal_offset_px`: (row, col) of the principal point from the
    array's centre. `motion_m_per_s`, `turn_rad_per_s`: velocity and rate of turn of the whole rig, in the frame of time 0; each
    frame is taken at once, unless `effects` have poses within an exposure.
    Ambient light is given as `ambient_e_per_s` (photoelectrons per pixel and second), or by its spectrum, `ambient`: the rate is
    then that of a camera in the medium, and `laser_line_geometry.ambient_e_per_s` that behind the port.
    `even_light_e_per_s`: photoelectrons per second that a pixel on the axis collects from a white surface near the camera, under
    light that comes evenly from all sides and shows the target's albedo and texture.
    `auto_exposure`: exposure and gain that follow the light, frame by frame; absent, they are the detector's. `inclinometers`:
    the camera's attitude against gravity, read once per frame. `stations`: poses of the rig in the frame of the scene, at which it
    stands still: frame k of those with laser, and frame k of those without, is taken at station k modulo their number.
    `calibration`: what the calibration that these values are from leaves open; it changes no capture but what it declares.
    """

    kind: Literal["laser_line"] = "laser_line"
    camera: Camera
    lens_sigma_px: Annotated[float, Field(ge=0, le=50)]
    principal_offset_px: tuple[float, float] | None = None
    distortion: Distortion | None = None
    port: Window
    laser: SheetLaser
    detector: Detector
    frames: Frames
    effects: LineEffects | None = None
    ambient_e_per_s: Rate = 0.0
    ambient: AmbientSpectrum | None = None
    even_light_e_per_s: Rate | None = None
    t0_s: MomentTime
    motion_m_per_s: Velocity | None = None
    turn_rad_per_s: tuple[_Turn, _Turn, _Turn] | None = None
    auto_exposure: AutoExposure | None = None
    inclinometers: Inclinometers | None = None
    stations: Annotated[tuple[Station, ...], Field(min_length=1, max_length=65536)] | None = None
    calibration: LineCalibration | None = None

    @model_serializer(mode="wrap")
    def _without_absent_options(self, handler: SerializerFunctionWrapHandler) -> dict[str, Any]:
        return without_computed(handler(self), _OPTIONAL)

    @model_validator(mode="after")
    def _ambient_is_given_once(self) -> LaserLineRig:
        collected = pixel_collected_m2_sr(self.camera)
        self.__dict__["ambient_e_per_s"] = ambient_rate(self, collected, self.camera.quantum_efficiency)
        return self

    @property
    def wavelength_m(self) -> float:
        """Vacuum wavelength of the laser, m."""
        return self.laser.wavelength_m
