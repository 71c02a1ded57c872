"""Bundle adjustment of a laser-line rig: camera, port and plane of the sheet, with the pose of the board in every view.

    Σ ((project(T_v X_k) − corner_vk)/σ_vk)² + Σ (u(ray ∩ board_v)/(∂u/∂col σ_vi))² -> min,

T_v the board's pose in view v, u the distance from the sheet's plane of the point where the ray of a line's centre meets the
board. Rays are refracted exactly. Covariance: (JᵀJ)⁻¹ at the minimum, residuals of each kind scaled to unit variance first.
Source: Z. Zhang, IEEE TPAMI 22:1330, 2000 (boards); A. Agrawal et al., CVPR 2012, p. 3346 (flat port).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
import numpy.typing as npt
from scipy.optimize import least_squares

from ...optics.dome import DomePort
from ...optics.pinhole import Pinhole
from ...optics.port import FlatPort
from ...optics.sheet import Sheet, meeting
from ...scenes.errors import InputError
from .board import Board, SeenBoard
from .board_pose import BoardPose, board_pose
from .deviations import STEPS, deviated
from .geometry import Geometry

__all__ = ["Adjusted", "View", "adjust", "flat_port"]

Float = npt.NDArray[np.float64]

#: Residuals beyond this many of their median size are left out of a line: specks, and rows whose albedo changes.
_OUTLIER = 5.0
#: Steps [rad, m] of derivatives by a pose.
_POSE_STEP = 1e-6
#: Column step [px] of ∂u/∂col.
_COL_STEP = 1e-3
#: Correlations nearer to ±1 than this leave a parameter undetermined.
_SINGULAR = 1e-14


@dataclass(frozen=True, eq=False)
class View:
    """What one image shows: corners, and points of the line on the board's plane.

    `port`: the window of this view; None where the camera stands in the medium itself. row, col, sigma (m) [px]: of the line;
    empty where it is not used.
    """

    corners: SeenBoard
    port: FlatPort | None
    row: Float
    col: Float
    sigma: Float


@dataclass(frozen=True, eq=False)
class Adjusted:
    """The minimum. `geometry`: with the port of the last view that has one. `names`, `covariance`: of the free parameters, as
    deviations from it (`deviations.deviated`). `pose_covariance` (6v, 6v): of what moves the poses (`BoardPose.moved`), by what the
    parameters leave open too. `corner_rms_px`, `line_rms_px`: of the residuals; 0 without any. `corner_scale`,
    `line_scale`: rms residual over the stated σ. `corners`, `points`: how many. `depths_m`: least and greatest z of the line's
    points; None without any."""

    geometry: Geometry
    names: tuple[str, ...]
    covariance: Float
    poses: tuple[BoardPose, ...]
    pose_covariance: Float
    corner_rms_px: float
    line_rms_px: float
    corner_scale: float
    line_scale: float
    corners: int
    points: int
    depths_m: tuple[float, float] | None

    def sigma(self, name: str) -> float:
        """Standard error of a free parameter, in the unit of its name."""
        k = self.names.index(name)
        return float(np.sqrt(self.covariance[k, k]))


def adjust(start: Geometry, board: Board, views: Sequence[View], free: Sequence[str]) -> Adjusted:
    """Adjust the `free` parameters (names of `declared.CALIBRATED`) and all poses.

    Raises InputError for unknown names, for a plane without points of a line, a stand-off without a port, and where the views
    leave a parameter undetermined.
    """
    names = _checked(views, tuple(free))
    points = board.points()
    poses = tuple(board_pose(_camera(start, view), points, view.corners) for view in views)
    problem = _Problem(start, points, tuple(views), names, poses, 1.0, 1.0)
    for last in (False, True):
        problem = problem.solved()
        if not last:
            problem = problem.cleaned()
        problem = problem.scaled()
    covariance, n = _covariance(problem.jacobian(np.zeros(problem.size)), names), len(names)
    corner, line = problem.kinds(np.zeros(problem.size))
    corner_px = np.concatenate([view.corners.sigma.ravel() for view in problem.views]) * problem.corner_scale
    line_px = np.concatenate([view.sigma for view in problem.views]) * problem.line_scale
    port = next((view.port for view in reversed(problem.views) if view.port is not None), None)
    geometry, held = problem.geometry, flat_port(problem.geometry.camera.port)
    if port is not None and held is not None:
        port = replace(port, stand_off_m=held.stand_off_m)
        geometry = replace(geometry, camera=replace(geometry.camera, port=port))
    return Adjusted(
        geometry, names, covariance[:n, :n], problem.poses, covariance[n:, n:],
        float(np.sqrt((corner**2).mean()) * np.sqrt((corner_px**2).mean())),
        float(np.sqrt((line**2).mean()) * np.median(line_px)) if line.size else 0.0, problem.corner_scale,
        problem.line_scale, corner.size // 2, line.size, problem.depths(),
    )  # fmt: skip


def flat_port(port: FlatPort | DomePort | None) -> FlatPort | None:
    """The flat window of a rig, None for a camera in the medium itself. Raises InputError for a dome."""
    if port is not None and not isinstance(port, FlatPort):
        raise InputError(
            "A camera behind a dome cannot be calibrated.", where="rig: port.kind", value="dome", allowed="flat, none",
            next_step="declare the dome's place and radii as measured, and calibrate the camera in air",
        )  # fmt: skip
    return port


def _checked(views: Sequence[View], names: tuple[str, ...]) -> tuple[str, ...]:
    unknown = [name for name in names if name not in STEPS]
    if unknown or len(set(names)) < len(names) or not views:
        raise InputError(
            "The calibration has no such parameters, or no views.",
            where="free",
            value=list(names),
            allowed=", ".join(STEPS),
        )
    plane = [name for name in names if name.startswith("turn_") or name == "shift_m"]
    if plane and sum(view.row.size for view in views) < 8:
        raise InputError(
            "The laser's plane cannot be calibrated: no view shows the line on the board's plane.", where="views",
            value=sum(view.row.size for view in views), allowed="8 points of the line or more",
            next_step="leave the plane out of the free parameters, or take frames with the laser on",
        )  # fmt: skip
    if "stand_off_m" in names and all(view.port is None for view in views):
        raise InputError(
            "The stand-off cannot be calibrated: no view looks through a port.", where="views", value="port.kind none",
            allowed="a view through a flat port", next_step="leave stand_off_m out of the free parameters",
        )  # fmt: skip
    return names


def _camera(geometry: Geometry, view: View) -> Pinhole:
    """The camera of a view: the window is that of the view, at the stand-off of the geometry."""
    held = flat_port(geometry.camera.port)
    port = view.port if view.port is None or held is None else replace(view.port, stand_off_m=held.stand_off_m)
    return replace(geometry.camera, port=port)


@dataclass(frozen=True, eq=False)
class _Group:
    """Views through one window, side by side: their numbers, the corners of all, the points of the line of all and the view
    (place in `number`) of each. The last rays of those points are kept: poses do not move them."""

    number: tuple[int, ...]
    view: View
    owner: npt.NDArray[np.int64]
    rays: dict[Pinhole, tuple[Float, Float]]

    @staticmethod
    def of(views: Sequence[View]) -> tuple[_Group, ...]:
        made = []
        for port in dict.fromkeys(view.port for view in views):
            number = tuple(k for k, view in enumerate(views) if view.port == port)
            own = [views[k] for k in number]
            seen = SeenBoard(*(np.concatenate([getattr(v.corners, name) for v in own]) for name in ("place", "sigma")))
            line = (np.concatenate([getattr(v, name) for v in own]) for name in ("row", "col", "sigma"))
            owner = np.repeat(np.arange(len(own)), [v.row.size for v in own])
            made.append(_Group(number, View(seen, port, *line), owner, {}))
        return tuple(made)

    def line_misses(self, camera: Pinhole, sheet: Sheet, poses: Sequence[BoardPose]) -> Float:
        """Columns by which the line lies beside where the sheet's plane meets the boards, over σ; a million where no ray does."""
        view = self.view
        if not view.row.size:
            return np.zeros(0)
        if camera not in self.rays:
            while len(self.rays) >= 2:
                self.rays.pop(next(iter(self.rays)))
            self.rays[camera] = camera.rays(np.stack([view.row] * 2), np.stack([view.col, view.col + _COL_STEP]))
        origin, direction = self.rays[camera]
        normal = np.stack([pose.turn[:, 2] for pose in poses], axis=1)[:, self.owner]
        place = np.stack([pose.place for pose in poses], axis=1)[:, self.owner]
        apart = sheet.offset(meeting(origin, direction, normal[:, None], place[:, None]))
        with np.errstate(invalid="ignore", divide="ignore"):
            miss = apart[0] * _COL_STEP / (apart[1] - apart[0]) / view.sigma
        return np.where(np.isfinite(miss), miss, 1e6)

    def corner_misses(self, camera: Pinhole, points: Float, poses: Sequence[BoardPose]) -> Float:
        """As `board_pose.corner_misses`, (view, 2n): all rows of a view, then all columns."""
        row, col = camera.project(np.concatenate([pose.of(points) for pose in poses], axis=1))
        seen = self.view.corners
        miss = np.stack([row, col], axis=1) - seen.place
        miss = (miss / seen.sigma).reshape(len(poses), -1, 2).transpose(0, 2, 1).reshape(len(poses), -1)
        return np.where(np.isfinite(miss), miss, 1e6)


@dataclass(frozen=True, eq=False)
class _Problem:
    """The state of the adjustment. Its unknowns are deviations from it: those of `names`, then six per view."""

    geometry: Geometry
    points: Float
    views: tuple[View, ...]
    names: tuple[str, ...]
    poses: tuple[BoardPose, ...]
    corner_scale: float
    line_scale: float

    @cached_property
    def groups(self) -> tuple[_Group, ...]:
        return _Group.of(self.views)

    @property
    def size(self) -> int:
        return len(self.names) + 6 * len(self.views)

    def at(self, x: Float) -> tuple[Geometry, tuple[BoardPose, ...]]:
        """Geometry and poses of the unknowns x."""
        n = len(self.names)
        geometry = deviated(self.geometry, dict(zip(self.names, x[:n].tolist(), strict=True)))
        by = x[n:].reshape(-1, 6)
        return geometry, tuple(pose.moved(b) for pose, b in zip(self.poses, by, strict=True))

    def blocks(self, x: Float) -> list[Float]:
        """Scaled residuals of every view: corners, then the line."""
        geometry, poses = self.at(x)
        found: list[Float] = [np.zeros(0)] * len(self.views)
        for group in self.groups:
            camera, own = _camera(geometry, group.view), [poses[k] for k in group.number]
            corner = group.corner_misses(camera, self.points, own) / self.corner_scale
            line = group.line_misses(camera, geometry.sheet, own) / self.line_scale
            for place, k in enumerate(group.number):
                found[k] = np.concatenate([corner[place], line[group.owner == place]])
        return found

    def residuals(self, x: Float) -> Float:
        return np.concatenate(self.blocks(x))

    def kinds(self, x: Float) -> tuple[Float, Float]:
        """Residuals of all corners, and of all points of the line."""
        n = 2 * len(self.points)
        blocks = self.blocks(x)
        return np.concatenate([b[:n] for b in blocks]), np.concatenate([b[n:] for b in blocks])

    def jacobian(self, x: Float) -> Float:
        """Central differences: by each free parameter, and by each of the six of all poses at once."""
        n, count = len(self.names), [2 * len(self.points) + view.row.size for view in self.views]
        first = np.concatenate([[0], np.cumsum(count)])
        made = np.zeros((int(first[-1]), self.size))

        def difference(step: Float) -> list[Float]:
            ahead, behind = self.blocks(x + step), self.blocks(x - step)
            return [a - b for a, b in zip(ahead, behind, strict=True)]

        for k, name in enumerate(self.names):
            step = np.zeros(self.size)
            step[k] = STEPS[name]
            made[:, k] = np.concatenate(difference(step)) / (2.0 * STEPS[name])
        for part in range(6):
            step = np.zeros(self.size)
            step[n + part :: 6] = _POSE_STEP
            for v, block in enumerate(difference(step)):
                made[first[v] : first[v + 1], n + 6 * v + part] = block / (2.0 * _POSE_STEP)
        return made

    def depths(self) -> tuple[float, float] | None:
        """Least and greatest depth [m] of the line's points on the boards; None without any."""
        found = [np.zeros(0)]
        for view, pose in zip(self.views, self.poses, strict=True):
            origin, direction = _camera(self.geometry, view).rays(view.row, view.col)
            found.append(meeting(origin, direction, pose.turn[:, 2], pose.place)[2])
        depth = np.concatenate(found)
        return (float(depth.min()), float(depth.max())) if depth.size else None

    def solved(self) -> _Problem:
        fit = least_squares(
            self.residuals, np.zeros(self.size), jac=self.jacobian, method="lm", x_scale="jac", max_nfev=200
        )
        if not np.isfinite(fit.cost) or np.abs(fit.fun).max() >= 1e6 / max(self.corner_scale, self.line_scale):
            raise InputError(
                "The calibration does not converge: some corners or line points leave the view.", where="adjust",
                value=float(fit.cost), next_step="start from better values of the declared rig, or free fewer parameters",
            )  # fmt: skip
        geometry, poses = self.at(fit.x)
        return replace(self, geometry=geometry, poses=poses)

    def cleaned(self) -> _Problem:
        """Without the points of lines that lie far beside the others."""
        _, line = self.kinds(np.zeros(self.size))
        if not line.size:
            return self
        limit = _OUTLIER * 1.4826 * float(np.median(np.abs(line)))
        keep = np.split(np.abs(line) <= max(limit, 1e-9), np.cumsum([view.row.size for view in self.views])[:-1])
        views = tuple(
            replace(view, row=view.row[k], col=view.col[k], sigma=view.sigma[k])
            for view, k in zip(self.views, keep, strict=True)
        )
        return replace(self, views=views)

    def scaled(self) -> _Problem:
        """With the residuals of each kind at unit variance, its degrees of freedom shared out by number."""
        corner, line = self.kinds(np.zeros(self.size))
        free = max(1.0 - self.size / (corner.size + line.size), 1e-3)

        def scale(part: Float) -> float:
            return max(float(np.sqrt((part**2).mean() / free)), 1e-6) if part.size else 1.0

        return replace(self, corner_scale=self.corner_scale * scale(corner), line_scale=self.line_scale * scale(line))


def _covariance(jacobian: Float, names: tuple[str, ...]) -> Float:
    """(JᵀJ)⁻¹ of the parameters of the rig and all poses. Raises InputError where columns depend on each other."""
    size = np.linalg.norm(jacobian, axis=0)
    dead = [name for name, length in zip(names, size, strict=False) if not length > 0]
    scaled = jacobian / np.where(size > 0, size, 1.0)
    _, values, right = np.linalg.svd(scaled, full_matrices=False)
    if dead or values[-1] ** 2 < _SINGULAR * values[0] ** 2:
        weight = np.abs(right[-1][: len(names)])
        mixed = dead or [name for name, w in zip(names, weight, strict=True) if w > 0.1 * weight.max()]
        raise InputError(
            "The views leave parameters undetermined.", where="adjust", value=", ".join(mixed),
            allowed="views that tell them apart",
            next_step="tilt the board to different sides, show it near and far, in air and through the port, or hold one of them",
        )  # fmt: skip
    return np.asarray((right.T / values**2) @ right / np.outer(size, size))
