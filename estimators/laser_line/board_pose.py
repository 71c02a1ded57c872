"""Where a board is: a first pose from a homography of the rays, then least squares through the exact refraction."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from scipy.optimize import least_squares

from ...optics.pinhole import Pinhole
from ...optics.rotation import turned_by
from ...scenes.errors import InputError
from .board import SeenBoard

__all__ = ["BoardPose", "board_pose", "corner_misses"]

Float = npt.NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class BoardPose:
    """A point x of the board lies at turn·x + place [m] in the camera's frame."""

    turn: Float
    place: Float

    def moved(self, by: Float) -> BoardPose:
        """Turned by the rotation vector by[:3] [rad] in place, then moved by by[3:] [m]."""
        return BoardPose(turned_by(by[:3]) @ self.turn, self.place + by[3:])

    def of(self, points: Float) -> Float:
        """Points (n, 3) of the board in the camera's frame, (3, n)."""
        return np.asarray(self.turn @ points.T + self.place[:, None])


def corner_misses(camera: Pinhole, pose: BoardPose, points: Float, seen: SeenBoard) -> Float:
    """(Where the camera sees the board's points − where they were seen)/σ, (2n): all rows, then all columns; a million where a
    point is not in view."""
    row, col = camera.project(pose.of(points))
    miss = np.concatenate([row - seen.place[:, 0], col - seen.place[:, 1]]) / seen.sigma.T.ravel()
    return np.where(np.isfinite(miss), miss, 1e6)


def board_pose(camera: Pinhole, points: Float, seen: SeenBoard) -> BoardPose:
    """The pose of a board whose `points` (n, 3) [m], z = 0, are seen at `seen`.

    The first pose takes all rays in the medium as if they left the entrance pupil: beyond a port that is centimetres off, which
    least squares then removes. Raises InputError where rays do not leave the camera, or where no pose fits.
    """
    _, direction = camera.rays(seen.place[:, 0], seen.place[:, 1])
    if not np.isfinite(direction).all():
        raise InputError(
            "Corners lie where no ray leaves the declared camera.", where="board_pose",
            value=int((~np.isfinite(direction).all(axis=0)).sum()), allowed="corners within the field of lens and port",
            next_step="check the declared focal length, distortion and indices",
        )  # fmt: skip
    start = _first_pose(points, direction[:2] / direction[2])
    # The sheet of the board may lie in front of a window that the first pose puts it in: begin beyond it.
    depth = 0.0 if camera.port is None else camera.port.depth_m
    nearest = float(start.of(points)[2].min())
    if nearest <= 1.05 * depth:
        start = BoardPose(start.turn, start.place + np.array([0.0, 0.0, 1.1 * depth - nearest]))

    def misses(by: Float) -> Float:
        return corner_misses(camera, start.moved(by), points, seen)

    fit = least_squares(misses, np.zeros(6), x_scale="jac", method="lm")
    pose = start.moved(fit.x)
    if not np.isfinite(fit.cost) or np.abs(fit.fun).max() >= 1e6:
        raise InputError(
            "No pose of the board fits its corners.", where="board_pose", value=float(np.abs(fit.fun).max()),
            allowed="corners of a flat board before the camera", next_step="check the declared camera and port",
        )  # fmt: skip
    return pose


def _first_pose(points: Float, slope: Float) -> BoardPose:
    """From a homography of the board's plane to slopes (2, n): Z. Zhang, IEEE TPAMI 22:1330, 2000, sec. 3.1."""
    scale = float(np.abs(points[:, :2]).max())
    x, y = points[:, 0] / scale, points[:, 1] / scale
    u, v = slope
    zero, one = np.zeros_like(x), np.ones_like(x)
    system = np.concatenate(
        [
            np.stack([x, y, one, zero, zero, zero, -u * x, -u * y, -u], axis=1),
            np.stack([zero, zero, zero, x, y, one, -v * x, -v * y, -v], axis=1),
        ]
    )
    # Of the left vectors, one per corner and coordinate, none is needed: the right ones are complete from nine rows on.
    h = np.linalg.svd(system, full_matrices=len(system) < system.shape[1])[2][-1].reshape(3, 3)
    h = h * np.sign(h[2, 2])
    r1, r2, t = h[:, 0] / scale, h[:, 1] / scale, h[:, 2]
    norm = 0.5 * (np.linalg.norm(r1) + np.linalg.norm(r2))
    r1, r2, t = r1 / norm, r2 / norm, t / norm
    left, _, right = np.linalg.svd(np.stack([r1, r2, np.cross(r1, r2)], axis=1))
    turn = left @ np.diag([1.0, 1.0, np.linalg.det(left @ right)]) @ right
    return BoardPose(turn, t)
