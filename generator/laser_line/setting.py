"""The setting of a capture: camera, sheet, tracer and the poses of its frames, and the rays that they share."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...optics import ladar
from ...optics.pinhole import Pinhole
from ...optics.reflection.angles import angles
from ...optics.rotation import turned_by
from ...optics.sheet import Sheet, meeting
from ...scenes.medium_index import phase_index
from ...scenes.rigs.laser_line import LaserLineRig, laser_line_rig
from ...scenes.rigs.laser_line_effects import FocusedLens
from ...scenes.rigs.laser_line_geometry import line_camera, line_lens, line_sheet
from ...scenes.scene import Scene
from ..rays.echo import reflected
from ..rays.trace import Hits, Tracer

__all__ = ["Pose", "Seen", "Setting", "exposure_poses", "poses_of", "setting_of"]

Float = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Pose:
    """Where the rig is: a point x of its camera's frame lies at turn·x + place of the scene."""

    place: Float
    turn: Float

    def of_point(self, point: Float) -> Float:
        """Points (3, n) of the camera's frame in the scene."""
        return self.turn @ point + self.place[:, None]


@dataclass(frozen=True, eq=False)
class Seen:
    """What n rays of the camera see, all in the camera's frame.

    `point`, `normal` (3, n) of the first hit; `hit` (n). `radiance` (n): photoelectrons per pixel of a row that lies along the
    ray, for an irradiance of the sheet of P p(φ)/r · 1 W/m² on its middle plane: all but g(u) of the irradiance; 0 in shadow.
    """

    point: Float
    normal: Float
    hit: NDArray[np.bool_]
    radiance: Float


@dataclass(frozen=True, eq=False)
class Setting:
    """Camera, sheet and tracer of one scene."""

    scene: Scene
    rig: LaserLineRig
    camera: Pinhole
    sheet: Sheet
    tracer: Tracer
    lens: FocusedLens | None = None

    def lens_px(self, col: Float, point: Float) -> Float | float:
        """1 σ [px] of the lens's point spread at columns (n) that see points (3, n), defocus added in quadrature."""
        if self.lens is None:
            return self.rig.lens_sigma_px
        return np.asarray(np.hypot(self.rig.lens_sigma_px, self.lens.sigma_px(col, point[2])), np.float64)

    def offsets(self, row: Float, col: Float, seen: Seen) -> Float:
        """u [m] of the surface's tangent planes on the rays (n) through other pixels near those of `seen`."""
        origin, direction = self.camera.rays(row, col)
        return self.sheet.offset(meeting(origin, direction, seen.normal, seen.point))

    def see(self, row: Float, col: Float, pose: Pose, *, lit: bool = True) -> Seen:
        """First hits of the rays through pixel coordinates (n). `lit`: whether to compute the light, which takes shadow rays."""
        origin, direction = self.camera.rays(row, col)
        leaves = np.isfinite(direction).all(axis=0)
        if not leaves.all():  # beyond the field, a wider image may have pixels whose rays port or lens do not let out
            origin, direction = np.where(leaves, origin, 0.0), np.where(leaves, direction, [[0.0], [0.0], [-1.0]])
        hits = self.tracer.trace(pose.of_point(origin), pose.turn @ direction)
        hit = (hits.target >= 0) & leaves
        distance = np.where(hit, hits.distance, 1.0)
        point = origin + direction * distance
        normal = pose.turn.T @ hits.normal
        light = self._light(row, col, pose, hits, hit, point, direction, distance) if lit else np.zeros(hit.shape)
        return Seen(point, normal, hit, light)

    def _light(
        self, row: Float, col: Float, pose: Pose, hits: Hits, hit: NDArray[np.bool_], point: Float, direction: Float,
        r2: Float,
    ) -> Float:  # fmt: skip
        """Photoelectrons with I = p(φ) r, so that E = P I/r² = P p(φ)/r."""
        sheet = self.sheet
        r1 = sheet.range(point)
        density = np.where(hit, sheet.fan_density(sheet.fan_angle(point)), 0.0)
        wanted = density > 0
        laser = np.asarray(pose.of_point(sheet.source[:, None])[:, 0])
        if wanted.any():
            to: tuple[float, float, float] = (float(laser[0]), float(laser[1]), float(laser[2]))
            wanted[wanted] = self.tracer.visible(pose.of_point(point[:, wanted]), to)
        beam = (point - sheet.source[:, None]) / r1
        a = angles((pose.turn.T @ hits.normal).T, -beam.T, -direction.T)
        light = self.electrons(row, col, density * r1, r1, r2, reflected(self.scene, hits, a, wanted))
        return np.where(wanted, light, 0.0)

    def electrons(self, row: Float, col: Float, intensity: Float, r1: Float, r2: Float, response: Float) -> Float:
        """Photoelectrons per pixel (n) by ladar's camera equation: `intensity` [1/sr] of the laser, r₁ from it and r₂ [m] back,
        `response` [1/sr]. Radiance that leaves a port for air falls by (n_inside/n_outside)²."""
        return self._collected(row, col, intensity, r1, r2, response, self.scene.medium.attenuation_per_m)

    def per_radiance(self, row: Float, col: Float) -> Float:
        """Photoelectrons per pixel (n) of radiance 1/(m² sr) per emitted power in the medium before the camera."""
        one = np.ones(np.shape(row))
        return self._collected(row, col, one, one, one, one, 0.0)

    def _collected(
        self, row: Float, col: Float, intensity: Float, r1: Float, r2: Float, response: Float, attenuation: float
    ) -> Float:
        camera, window = self.rig.camera, self.camera.port
        x, y = self.camera.slopes(row, col)
        electrons = ladar.pixel_photoelectrons(
            pulse_energy_j=self.rig.laser.power_w * self.rig.detector.exposure_s,
            intensity_per_sr=intensity,
            response_per_sr=response,
            lamp_range_m=r1,
            camera_range_m=r2,
            attenuation_per_m=attenuation,
            pixel_area_m2=camera.pixel_pitch_m**2,
            f_number=camera.f_number,
            cos_field=1.0 / np.sqrt(1.0 + x * x + y * y) if camera.vignetting == "cos4" else 1.0,
            transmission=camera.transmission,
            quantum_efficiency=camera.quantum_efficiency,
            wavelength_m=self.rig.wavelength_m,
        )
        return np.asarray(electrons * (1.0 if window is None else (window.inside / window.outside) ** 2))


def setting_of(scene: Scene, tracer: Tracer | None = None) -> Setting:
    """The setting of a scene. Raises InputError for an impossible scene."""
    rig = laser_line_rig(scene)
    index = phase_index(scene.medium, rig.wavelength_m)
    camera, sheet = line_camera(rig, index), line_sheet(rig, index)
    return Setting(scene, rig, camera, sheet, tracer or Tracer(scene), line_lens(rig, camera, sheet, scene.name))


def exposure_poses(rig: LaserLineRig, time_s: float) -> list[Pose]:
    """Poses within an exposure about a time [s], at the middles of equal parts; the one pose of the time where the rig has none."""
    count = None if rig.effects is None else rig.effects.exposure_poses
    if count is None:
        return [_pose_at(rig, time_s)]
    part = (np.arange(count) + 0.5) / count - 0.5
    return [_pose_at(rig, float(time_s + p * rig.detector.exposure_s)) for p in part]


def _pose_at(rig: LaserLineRig, time_s: float) -> Pose:
    moved = time_s * np.asarray(rig.motion_m_per_s or (0.0, 0.0, 0.0))
    return Pose(moved, turned_by(time_s * np.asarray(rig.turn_rad_per_s or (0.0, 0.0, 0.0))))


def poses_of(rig: LaserLineRig) -> tuple[list[Pose], dict[str, Any]]:
    """The poses of the frames, and the coordinates that say the same: `time` [s], `laser_on` and `pose` (frame, 6).

    The rig is at rest at time 0, or moves and turns evenly from there; or it stands at one of its stations.
    """
    count = rig.frames.lit + rig.frames.laser_off
    time = rig.frames.interval_s * np.arange(count)
    if rig.stations is None:
        moved = time[:, None] * np.asarray(rig.motion_m_per_s or (0.0, 0.0, 0.0))
        turned = time[:, None] * np.asarray(rig.turn_rad_per_s or (0.0, 0.0, 0.0))
    else:
        number = np.concatenate([np.arange(rig.frames.lit), np.arange(rig.frames.laser_off)]) % len(rig.stations)
        moved, turned = np.split(np.asarray(rig.stations, np.float64)[number], 2, axis=1)
    poses = [Pose(place, turned_by(vector)) for place, vector in zip(moved, turned, strict=True)]
    on = np.arange(count) < rig.frames.lit
    coords = {"time": time, "laser_on": on, "pose": np.concatenate([moved, turned], axis=1), "valid": True}
    return poses, coords
