"""Whether the squares of a board are as large as stated: the board at rest, seen from stations of a rig whose places are known.

With the board's middle at m_v in the camera of station v, and the station's turn R_v and place p_v, s R_v m_v + p_v is the same
place for all stations, s the true size of the squares over the stated one:

    s = −Σ a_v·b_v/Σ |a_v|²,    a_v = R_v m_v and b_v = p_v, each less its mean over the stations.

A scale common to all of a board cannot be seen in its images alone: camera and angles come out right, all places too large or
too small.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

from ...optics.rotation import turned_by
from ...scenes.errors import InputError
from .board import Board
from .board_pose import BoardPose

__all__ = ["check_scale", "measured_scale"]

Float = npt.NDArray[np.float64]

#: A scale is wrong beyond this many of its standard errors and this share of it: what a print of a board is true to.
_SIGMAS, _LEAST = 5.0, 2e-3
#: A scale that is known no better is not looked at: the stations lie too near to each other.
_MOST_SIGMA = 0.02
#: Step of derivatives by a pose [rad, m].
_STEP = 1e-6


def measured_scale(
    board: Board, poses: Sequence[BoardPose], stations: Float, covariance: Float | None = None
) -> tuple[float, float]:
    """(s, its standard error) of a board at rest. (NaN, infinity) of fewer than three poses, or of stations at one place.

    Main arguments:
        poses (n): of the board in the cameras. stations (n, 6): x, y, z [m] and a rotation vector [rad] of the rig, as the
            coordinate `pose`. covariance (6n, 6n): of the poses (`Adjusted.pose_covariance`); None: they are exact.

    The error is √(rest² + g C gᵀ): what is left between the stations, and what the adjustment leaves open in all of them alike (a
    stand-off that is a centimetre off puts all boards as much too near).
    """
    scale, rest = _scale(board, poses, stations)
    if covariance is None or not np.isfinite(rest):
        return scale, rest
    slope = np.zeros(6 * len(poses))
    for k in range(slope.size):
        ends = []
        for sign in (1.0, -1.0):
            by = np.zeros(6)
            by[k % 6] = sign * _STEP
            moved = [pose.moved(by) if k // 6 == v else pose for v, pose in enumerate(poses)]
            ends.append(_scale(board, moved, stations)[0])
        slope[k] = (ends[0] - ends[1]) / (2.0 * _STEP)
    return scale, float(np.sqrt(rest**2 + max(float(slope @ covariance @ slope), 0.0)))


def _scale(board: Board, poses: Sequence[BoardPose], stations: Float) -> tuple[float, float]:
    """(s, its standard error by what is left between the stations)."""
    corner = board.points()
    middle = np.stack([pose.of(corner).mean(axis=1) for pose in poses])
    seen = np.stack([turned_by(station[3:]) @ one for station, one in zip(stations, middle, strict=True)])
    a, b = seen - seen.mean(axis=0), stations[:, :3] - stations[:, :3].mean(axis=0)
    size = float((a * a).sum())
    if len(poses) < 3 or not size > 0 or not (b * b).any():
        return np.nan, np.inf
    scale = -float((a * b).sum()) / size
    rest = scale * a + b
    return scale, float(np.sqrt((rest * rest).sum() / (3 * len(poses) - 4) / size))


def check_scale(board: Board, poses: Sequence[BoardPose], stations: Float, covariance: Float) -> None:
    """Refuse a board whose squares are not as large as stated, as far as the stations tell; arguments as of `measured_scale`.
    Raises InputError."""
    scale, sigma = measured_scale(board, poses, stations, covariance)
    if sigma <= _MOST_SIGMA and abs(scale - 1.0) > max(_SIGMAS * sigma, _LEAST):
        raise InputError(
            "The squares of the board are not as large as stated: the rig moved by other distances than the board's images say.",
            where="board: square_m", value=board.square_m,
            allowed=f"{board.square_m * scale:.6g} ± {board.square_m * sigma:.2g} m by the capture's poses",
            next_step="measure the board; or correct the poses, or the declared port",
        )  # fmt: skip
