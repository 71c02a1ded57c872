"""Frames of the tank from its section alone, without a ray tracer: the column, light and width of every row's line.

The ray of a pixel meets the sheet at X(row, col). Along a row X runs away from the laser as the column falls, and the line is where
it first meets the section. Light and width follow from the sheet's profile on the surface's tangent plane.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from ...optics.pinhole import Pinhole
from ...optics.sheet import Sheet, meeting
from ...scenes.medium_index import phase_index
from ...scenes.rigs.laser_line import laser_line_rig
from ...scenes.rigs.laser_line_geometry import line_camera, line_sheet
from ...scenes.scene import Scene
from ..written.laser_line import written_capture
from .tank_sets import Section

__all__ = ["Plane", "SectionLine", "section_capture", "section_line"]

Float = NDArray[np.float64]

#: Columns that are tried first; halvings of the interval that holds the line.
_GRID, _HALVINGS = 385, 45
#: Brightest pixel of a frame after automatic exposure, DN of 255: "to avoid blooming" (sec. 3.4); the level is ours.
_EXPOSED_DN = 200.0
#: Half the step [px] of slopes.
_STEP = 1e-3


@dataclass(frozen=True)
class Plane:
    """The laser's plane: camera and sheet, and `view_rad`, the angle of the sheet's middle ray from the vertical."""

    camera: Pinhole
    sheet: Sheet
    view_rad: float

    @staticmethod
    def of(scene: Scene, view_deg: float) -> Plane:
        """The plane of a scene's rig."""
        rig = laser_line_rig(scene)
        index = phase_index(scene.medium, rig.wavelength_m)
        return Plane(line_camera(rig, index), line_sheet(rig, index), float(np.deg2rad(view_deg)))

    def gravity(self, point: Float) -> tuple[Float, Float]:
        """(down, out) [m] from the laser, of points (3, …) of the camera's frame: what inclinometers are for."""
        local = point - self.sheet.source.reshape(3, *[1] * (point.ndim - 1))
        y, z = (np.tensordot(self.sheet.frame[:, k], local, axes=1) for k in (1, 2))
        s, c = np.sin(self.view_rad), np.cos(self.view_rad)
        return np.asarray(c * z - s * y), np.asarray(s * z + c * y)

    def met(self, row: Float, col: Float) -> Float:
        """Points (3, …) where the rays through pixel coordinates meet the plane."""
        origin, direction = self.camera.rays(row, col)
        return meeting(origin, direction, self.sheet.normal, self.sheet.source)

    def beyond(self, row: Float, col: Float, section: Section) -> Float:
        """How far [m] those points lie behind the section's first surface, as the laser sees them."""
        down, out = self.gravity(self.met(row, col))
        return np.asarray(np.hypot(down, out) - section.distance(np.arctan2(out, down)))


@dataclass(frozen=True)
class SectionLine:
    """Of every row: column [px], light [relative], width [px, 1 σ] and range from the laser [m]; NaN without a line."""

    column: Float
    light: Float
    width: Float
    range_m: Float


def section_line(
    plane: Plane, section: Section, rows: int, cols: int, lens_px: float, attenuation_per_m: float
) -> SectionLine:
    """The line of every row (rows), by bisection between the first two grid columns that lie before and behind the section."""
    grid = np.linspace(cols - 0.5, -0.5, _GRID)
    row = np.arange(rows, dtype=np.float64)
    at_row, at_col = np.broadcast_arrays(row[:, None], grid)
    behind = plane.beyond(at_row, at_col, section) > 0
    cell = np.argmax(~behind[:, :-1] & behind[:, 1:], axis=1)
    there = (~behind[:, :-1] & behind[:, 1:]).any(axis=1)
    near, far = grid[cell], grid[cell + 1]
    for _ in range(_HALVINGS):
        middle = 0.5 * (near + far)
        past = plane.beyond(row, middle, section) > 0
        near, far = np.where(past, near, middle), np.where(past, middle, far)
    column = 0.5 * (near + far)
    light, width, range_m = _look(plane, section, row, column, lens_px, attenuation_per_m)
    return SectionLine(*(np.where(there, v, np.nan) for v in (column, light, width, range_m)))


def _look(
    plane: Plane, section: Section, row: Float, column: Float, lens_px: float, attenuation_per_m: float
) -> tuple[Float, Float, Float]:
    """(light, width, range): radiance of a matt surface ∝ cosθ e^{−c(r₁ + r₂)}/r₁ times columns per metre across the sheet."""
    point = plane.met(row, column)
    down, out = plane.gravity(point)
    range_m = np.hypot(down, out)
    _, flat = section.surfaces(np.arctan2(out, down))
    s, c = np.sin(plane.view_rad), np.cos(plane.view_rad)
    y, z = plane.sheet.frame[:, 1], plane.sheet.frame[:, 2]
    normal = np.multiply.outer(c * z - s * y, flat[0]) + np.multiply.outer(s * z + c * y, flat[1])
    offsets = {}
    for key, (r, k) in {
        "right": (0.0, _STEP),
        "left": (0.0, -_STEP),
        "low": (_STEP, 0.0),
        "high": (-_STEP, 0.0),
    }.items():
        origin, direction = plane.camera.rays(row + r, column + k)
        offsets[key] = plane.sheet.offset(meeting(origin, direction, normal, point))
    slope = np.abs(offsets["right"] - offsets["left"]) / (2.0 * _STEP)
    lean = (offsets["low"] - offsets["high"]) / (2.0 * _STEP) / slope
    origin, _ = plane.camera.rays(row, column)
    away = np.linalg.norm(point - origin, axis=0)
    cosine = -(flat[0] * down + flat[1] * out) / range_m
    light = np.maximum(cosine, 0.0) * np.exp(-attenuation_per_m * (range_m + away)) / range_m / slope
    width = np.sqrt((plane.sheet.sigma(range_m) / slope) ** 2 + lens_px**2 + lean**2 / 12.0)
    return light, width, range_m


def section_capture(scene: Scene, plane: Plane, sections: list[Section], seed: int) -> tuple[xr.Dataset, Float]:
    """(a capture of a frame per section, true range from the laser [m] (frame, row)).

    Exposure is automatic: the brightest pixel of a frame is at 200 of 255 DN, by exposure or iris.
    """
    rig = laser_line_rig(scene)
    rows, cols = rig.camera.rows, rig.camera.cols
    attenuation = scene.medium.attenuation_per_m
    lines = [section_line(plane, section, rows, cols, rig.lens_sigma_px, attenuation) for section in sections]
    column, light, width, range_m = (
        np.stack([getattr(line, name) for line in lines]) for name in ("column", "light", "width", "range_m")
    )
    brightest = np.nanmax(light / width, axis=1, keepdims=True) / np.sqrt(2.0 * np.pi)
    full = (_EXPOSED_DN - rig.detector.offset_dn) / rig.detector.gain_dn_per_e
    amplitude = np.nan_to_num(light / brightest * full)
    frames = scene.model_copy(
        update={"rig": rig.model_copy(update={"frames": rig.frames.model_copy(update={"lit": len(sections)})})}
    )
    capture = written_capture(
        frames, amplitude, np.where(np.isfinite(width), width, 1.0), rig.detector.dark_current_e_per_s * rig.detector.exposure_s,
        np.nan_to_num(column, nan=-100.0), seed=seed,
    )  # fmt: skip
    return capture, range_m
