"""Lamps: where light leaves from and how much goes in each direction, once for NumPy and once for drjit.

Light transport uses `position_m` and `intensity(direction)` of a lamp only, so that a lamp may have any shape; what follows a
beam scattered by water also needs that it is the same all around its axis: a `RoundBeam`.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from ...optics import illumination
from ...scenes.base import Vec3
from ...scenes.rigs.parts import Illumination
from .backend import mitsuba, opaque

__all__ = ["DeviceLamp", "DeviceRoundBeam", "Lamp", "RoundBeam"]

Float = NDArray[np.float64]


class DeviceLamp(Protocol):
    """A lamp in drjit arrays."""

    @property
    def position(self) -> Any:
        """Where the light leaves from [m]."""
        ...

    @property
    def axis(self) -> Any:
        """Unit direction that the lamp faces: a lamp of finite size is a disc across it."""
        ...

    def intensity(self, direction: Any) -> Any:
        """Radiant intensity per unit energy [1/sr] along unit directions away from the lamp."""
        ...


class Lamp(Protocol):
    """A lamp in NumPy arrays."""

    @property
    def position_m(self) -> Vec3:
        """Where the light leaves from, camera frame [m]."""
        ...

    @property
    def source_radius_m(self) -> float:
        """Radius of the evenly bright disc that the light leaves from [m]; 0 for a point."""
        ...

    def intensity(self, direction: Float) -> Float:
        """Radiant intensity per unit energy [1/sr] along unit directions (3, n) away from the lamp."""
        ...

    def on_device(self) -> DeviceLamp:
        """The same lamp in drjit arrays."""
        ...


@dataclass(frozen=True)
class RoundBeam:
    """A lamp whose intensity I(θ) depends on the angle θ from its axis alone."""

    illumination: Illumination
    position_m: Vec3 = (0.0, 0.0, 0.0)
    source_radius_m: float = 0.0

    @property
    def half_angle_rad(self) -> float:
        """The profile's half angle."""
        return self.illumination.half_angle_rad

    @property
    def axis(self) -> Float:
        """Unit vector (3,) along the middle of the beam."""
        return illumination.beam_axis(self.illumination.offset_rad)

    @property
    def edge_rad(self) -> float:
        """Angle [rad] beyond which the beam has no light (a Gaussian: below 2e-8 of its peak)."""
        wide = self.half_angle_rad
        return min(3.0 * wide if self.illumination.profile == "gaussian" else wide, 0.5 * np.pi)

    def angle(self, direction: Float) -> Float:
        """Angle [rad] of unit directions (3, n) from the axis."""
        if not any(self.illumination.offset_rad):
            return np.asarray(np.arctan2(np.hypot(direction[0], direction[1]), direction[2]))
        axis = self.axis
        # atan2 of cross and dot keeps full accuracy near the axis, where arccos loses half the digits.
        cross = np.cross(axis, direction, axisa=0, axisb=0, axisc=0)
        return np.asarray(np.arctan2(np.sqrt(np.einsum("in,in->n", cross, cross)), axis @ direction))

    def profile(self, theta_rad: Float) -> Float:
        """I(θ) [1/sr], of the shape of θ."""
        spec = self.illumination
        return illumination.beam_intensity(spec.profile, theta_rad, spec.half_angle_rad, spec.radial_value)

    def intensity(self, direction: Float) -> Float:
        """I [1/sr] along unit directions (3, n)."""
        return self.profile(self.angle(direction))

    def on_device(self) -> DeviceRoundBeam:
        """The same beam in drjit arrays."""
        return DeviceRoundBeam.of(self)


@dataclass(frozen=True)
class DeviceRoundBeam:
    """A `RoundBeam` in drjit arrays; `values` of a measured profile on `cells` even cells of the half angle."""

    position: Any
    axis: Any
    profile: str
    half_angle: Any
    scale: Any
    values: Any
    cells: int

    @staticmethod
    def of(beam: RoundBeam) -> DeviceRoundBeam:
        """The beam, its numbers as data, so that other numbers do not compile anew."""
        mi = mitsuba()
        spec = beam.illumination
        w = spec.half_angle_rad
        values, cells, scale = [0.0, 0.0], 1, 0.0
        if spec.profile == "gaussian":
            scale = float(illumination.gaussian_intensity(0.0, w))
        elif spec.profile == "flat-top":
            scale = float(illumination.flat_top_intensity(0.0, w))
        else:
            assert spec.radial_value is not None
            cells = len(spec.radial_value) - 1
            grid = np.linspace(0.0, w, cells + 1)
            values = [float(v) for v in illumination.measured_intensity(grid, w, np.asarray(spec.radial_value))]
        return DeviceRoundBeam(
            mi.Point3f(*(opaque(float(p)) for p in beam.position_m)),
            mi.Vector3f(*(opaque(float(a)) for a in beam.axis)),
            spec.profile,
            opaque(w),
            opaque(scale),
            mi.Float(values),
            cells,
        )

    def intensity(self, direction: Any) -> Any:
        """I(θ) along unit directions away from the lamp."""
        import drjit as dr

        theta = dr.atan2(dr.norm(dr.cross(self.axis, direction)), dr.dot(self.axis, direction))
        if self.profile == "gaussian":
            value = self.scale * dr.exp(-2.0 * dr.square(theta / self.half_angle))
            return dr.select(theta <= 0.5 * dr.pi, value, 0.0)
        if self.profile == "flat-top":
            return dr.select(theta <= self.half_angle, self.scale, 0.0)
        mi = mitsuba()
        inside = theta <= self.half_angle
        x = dr.minimum(theta / self.half_angle * self.cells, float(self.cells))
        left = dr.minimum(mi.UInt32(x), self.cells - 1)
        a = dr.gather(mi.Float, self.values, left, inside)
        b = dr.gather(mi.Float, self.values, left + 1, inside)
        return dr.select(inside, a + (x - mi.Float(left)) * (b - a), 0.0)
