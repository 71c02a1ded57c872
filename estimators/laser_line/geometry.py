"""The geometry that a laser-line rig declares: its camera, the plane of its sheet, and how wide the line should appear."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np
import numpy.typing as npt

from ...optics.dome import DomePort
from ...optics.pinhole import Pinhole
from ...optics.port import FlatPort
from ...optics.sheet import Sheet, meeting
from ...scenes.errors import InputError
from ..declared import check_keys
from ..rig import DeclaredRig
from .declared import LASER_LINE_KEYS

__all__ = ["Geometry", "declared_covariance", "declared_geometry"]

Float = npt.NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Geometry:
    """Camera and sheet as declared. `lens_px`: 1 σ of the lens's point spread; `rows`, `cols`: size of the image."""

    camera: Pinhole
    sheet: Sheet
    lens_px: float
    rows: int
    cols: int

    def points(self, row: Float, col: Float) -> Float:
        """Points (3, …) [m] where the rays through pixel coordinates (…) meet the sheet's middle plane; NaN where they meet it
        behind the camera's window or behind the laser."""
        origin, direction = self.camera.rays(row, col)
        point = meeting(origin, direction, self.sheet.normal, self.sheet.source)
        ahead = (direction * (point - origin)).sum(axis=0) > 0
        ahead &= np.tensordot(self.sheet.frame[:, 2], point, axes=1) > self.sheet.frame[:, 2] @ self.sheet.source
        return np.where(ahead, point, np.nan)

    def widths(self) -> Float:
        """σ [px] (col) of a line on matter square to the view, in the middle row; NaN where a column sees no sheet."""
        col = np.arange(self.cols, dtype=np.float64)
        row = np.full(self.cols, 0.5 * (self.rows - 1))
        point = self.points(row, col)
        direction = self.camera.rays(row, col)[1]
        aside_origin, aside = self.camera.rays(row, col + 0.01)
        beside = meeting(aside_origin, aside, direction, point)
        per_px = np.abs(self.sheet.offset(beside)) / 0.01
        return np.asarray(np.hypot(self.sheet.sigma(self.sheet.range(point)) / per_px, self.lens_px))


def declared_geometry(rig: DeclaredRig, *, port: str = "declared") -> Geometry:
    """The geometry of a declared rig.

    Other arguments:
        port: "declared"; "pinhole": its surfaces at the entrance pupil; "none": as if all were in air.

    Raises InputError where the rig lacks a value or holds one that cannot be used.
    """
    return _geometry(rig, port)


def declared_covariance(rig: DeclaredRig) -> tuple[tuple[str, ...], Float]:
    """(names, covariance) of the parameters that a calibration of the rig found.

    Raises InputError where there is none, or where the covariance is not a symmetric matrix of their number without negative
    eigenvalues.
    """
    names = tuple(str(name) for name in rig.need("calibration.parameters"))
    rows = [rig.numbers(f"calibration.covariance.{k}", length=len(names)) for k in range(len(names))]
    matrix = np.stack(rows)
    scale = np.sqrt(np.abs(np.diag(matrix)))
    unit = matrix / np.outer(np.where(scale > 0, scale, 1.0), np.where(scale > 0, scale, 1.0))
    if np.abs(unit - unit.T).max() > 1e-9 or np.linalg.eigvalsh(unit).min() < -1e-9 or len(set(names)) < len(names):
        raise InputError(
            "The declared covariance of the calibration cannot be one.", where="attribute rig: calibration.covariance",
            value=matrix.tolist(), allowed="symmetric, no negative eigenvalue, one row for each of the different parameters",
        )  # fmt: skip
    return names, matrix


@lru_cache(maxsize=32)
def _geometry(rig: DeclaredRig, port: str) -> Geometry:
    check_keys(rig, LASER_LINE_KEYS)
    pitch = rig.number("camera.pixel_pitch_m", above=0)
    k1, k2, p1, p2, k3 = rig.numbers("camera.distortion", length=5).tolist()
    camera = Pinhole(
        rig.number("camera.focal_length_m", above=0) / pitch,
        rig.number("camera.principal_row_px"),
        rig.number("camera.principal_col_px"),
        (k1, k2, p1, p2, k3),
        _window(rig) if port != "none" else None,
    )
    if port == "pinhole" and isinstance(camera.port, DomePort):
        raise InputError(
            "A dome is no port at the pinhole: this estimator takes flat ports only.", where="attribute rig: port.kind",
            value="dome", allowed="none, flat", next_step="use triangulate-refractive",
        )  # fmt: skip
    if port == "pinhole" and isinstance(camera.port, FlatPort):
        camera = replace(camera, port=replace(camera.port, stand_off_m=0.0, thickness_m=0.0))
    normal, axis = (rig.numbers(f"laser.{name}", length=3) for name in ("normal", "axis"))
    sheet = Sheet(
        rig.numbers("laser.position_m", length=3), np.stack([normal, np.cross(axis, normal), axis], axis=1),
        rig.number("laser.waist_m", above=0), rig.number("laser.waist_at_m", least=0),
        rig.number("laser.divergence_rad", least=0), rig.number("laser.fan_half_angle_rad", above=0), "flat-top",
    )  # fmt: skip
    lens = rig.number("lens_sigma_px", least=0)
    return Geometry(camera, sheet, lens, rig.whole("camera.rows"), rig.whole("camera.cols"))


def _window(rig: DeclaredRig) -> FlatPort | DomePort | None:
    kind = rig.word("port.kind", "none", "flat", "dome")
    if kind == "none":
        return None
    if kind == "dome":
        x, y, z = rig.numbers("port.center_m", length=3).tolist()
        return DomePort(
            (x, y, z), rig.number("port.radius_m", above=0), rig.number("port.thickness_m", least=0),
            rig.number("port.inside_index", least=1), rig.number("port.glass_index", least=1),
            rig.number("medium.phase_index", least=1),
        )  # fmt: skip
    return FlatPort(
        rig.number("port.stand_off_m", least=0), rig.number("port.thickness_m", least=0),
        rig.number("port.inside_index", least=1), rig.number("port.glass_index", least=1),
        rig.number("medium.phase_index", least=1),
    )  # fmt: skip
