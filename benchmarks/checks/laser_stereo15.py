"""Real images of fifteen laser lines: the lines found, their planes fitted to a board, and points on a coral.

    python -m beambench.benchmarks.checks.laser_stereo15 FOLDER [PICTURE.png]

FOLDER holds set3_image2.png, set3_image4.png, set3_image9.png and coral01.png of the repository SamJones329/laser_stereo_system
(GitHub, commit 325e39d, Apache-2.0): rectified images of 2208 × 1242 pixels, in air, of a wall with a board of 6 × 9 inner corners
29.09 mm apart, and of a coral. The camera is as its author states it. PICTURE: depth of the coral's points, .38 to .56 m.

The board's pose in each image gives the wall's plane, so that every point of a line has its place in space. A plane is fitted to
the points of one line in all images: its rms distance is one figure. Triangulated by planes from the other images, the points'
distance from the wall is the other, which holds the errors of the board too.
"""

from __future__ import annotations

import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
from scipy.ndimage import median_filter

from ...captures.build import make_capture
from ...captures.hide import hide_truth
from ...captures.imports.files import read_recording
from ...estimators.laser_line.board import Board, SeenBoard, find_board
from ...estimators.laser_line.board_pose import BoardPose, board_pose, corner_misses
from ...estimators.registry import run_estimator
from ...optics.pinhole import Pinhole
from ...optics.sheet import meeting
from ...scenes.declared import declared_rig
from ...scenes.errors import InputError
from ...scenes.load import load_scene

__all__ = [
    "LINES",
    "Plane",
    "Wall",
    "coral_points",
    "found_lines",
    "main",
    "planes_of",
    "read_image",
    "seen_lines",
    "wall_of",
]

Float = npt.NDArray[np.float64]

LINES = 15
WALLS = ("set3_image2.png", "set3_image4.png", "set3_image9.png")
CORAL = "coral01.png"
BOARD = Board(9, 6, 0.02909)
#: The author's camera: focal lengths along columns and rows [px], and the principal point.
_FX, _FY, _COL0, _ROW0 = 1407.86, 1407.12, 1083.25, 623.674
CAMERA = Pinhole(_FX, _ROW0, _COL0)
#: Depths [m] in which the coral lies. Neighbouring planes differ by more than this, but for a few pixels, which are left out.
DEPTHS_M = (0.38, 0.56)
_OFFSET_DN = 100.0
#: Columns of the wall's background and of the coral's: several widths of a line, less than two distances of lines.
_WALL_PX, _CORAL_PX = 25, 61
#: Pixels of an image in one of the picture.
_COARSE = 2
#: Least rows of a piece of a line on the coral.
_LEAST_ROWS = 10


@dataclass(frozen=True, eq=False)
class Wall:
    """An image of the wall: pose of the board, rms of its corners [px], and rows and columns of each of the lines."""

    pose: BoardPose
    corner_rms_px: float
    lines: tuple[tuple[Float, Float], ...]

    def points(self, number: int) -> Float:
        """Points (n, 3) [m] of a line on the wall."""
        row, col = self.lines[number]
        return on_plane(row, col, self.pose.turn[:, 2], self.pose.place)

    def away(self, points: Float) -> Float:
        """Distance [m] of points (n, 3) from the wall."""
        return np.asarray((points - self.pose.place) @ self.pose.turn[:, 2])


@dataclass(frozen=True, eq=False)
class Plane:
    """The plane of a line: a point of it and its normal, (3)."""

    place: Float
    normal: Float

    @staticmethod
    def through(points: Float) -> Plane:
        """Least squares of the distances of points (n, 3)."""
        middle = points.mean(axis=0)
        return Plane(middle, np.linalg.svd(points - middle, full_matrices=False)[2][-1])

    def away(self, points: Float) -> Float:
        """Distance [m] of points (n, 3)."""
        return np.asarray((points - self.place) @ self.normal)


def on_plane(row: Float, col: Float, normal: Float, place: Float) -> Float:
    """Points (n, 3) [m] where rays through pixels meet a plane. The camera's pixels are taken as square by stretching rows."""
    origin, direction = CAMERA.rays(_ROW0 + (row - _ROW0) * _FX / _FY, col)
    return np.asarray(meeting(origin, direction, normal, place).T)


def read_image(path: Path) -> Float:
    """Red, green and blue (row, col, 3), 0 to 255. Raises InputError for a file that is missing or is no colour picture."""
    image = read_recording(path).array("", str(path))
    if image.ndim != 3 or image.shape[2] < 3 or image.dtype != np.uint8:
        raise InputError("The picture cannot be read.", where=str(path), allowed="an RGB picture, 8 bit")
    return np.asarray(image, np.float64)[..., :3]


def found_lines(
    light: Float, width_px: int, returns: int, overrides: dict[str, Any] | None = None, finder: str = "line-erf"
) -> tuple[Float, Float]:
    """(rows, columns) of all lines that `finder` finds in an image of light, above the median of `width_px` columns."""
    scene = load_scene("laser-stereo15", dict(overrides or {}))
    counts = np.maximum(light - median_filter(light, (1, width_px)) + _OFFSET_DN, 1.0).astype(np.float32)
    capture = make_capture(
        scene.modality, {"counts": counts[None]},
        {"time": [0.0], "laser_on": True, "valid": True, "pose": np.zeros((1, 6))}, {},
        {"rig": declared_rig(scene), "truth_kind": "none", "averaged": True},
    )  # fmt: skip
    found = run_estimator(f"{finder}[returns={returns}]", hide_truth(capture))
    valid = found["valid"].values[0]
    row = np.broadcast_to(np.arange(valid.shape[0], dtype=np.float64)[:, None], valid.shape)
    return row[valid], found["column"].values[0][valid]


def seen_lines(row: Float, col: Float, *, most_px: float = 5.0, least: int = 100) -> tuple[tuple[Float, Float], ...]:
    """Points of nearly parallel lines across the rows, by line from the left.

    The common slope is the one that piles the columns col − k row up highest; lines are the fifteen fullest piles, each freed of
    what lies beside its parabola by more than three standard deviations. Raises InputError where a pile holds fewer than
    `least` points.
    """
    slopes = np.linspace(-0.25, 0.05, 301)
    middle, edges = float(np.median(row)), np.arange(col.min() - 200.0, col.max() + 200.0, 2.0)
    piles = [np.histogram(col - k * (row - middle), edges)[0] for k in slopes]
    best = int(np.argmax([(pile.astype(float) ** 2).sum() for pile in piles]))
    upright = col - slopes[best] * (row - middle)
    pile = np.convolve(piles[best], np.ones(3), "same")  # a line may lie on the edge of two bins
    made: list[tuple[Float, Float]] = []
    while len(made) < LINES:
        top = int(pile.argmax())
        near = np.abs(upright - 0.5 * (edges[top] + edges[top + 1])) < most_px
        if pile[top] < least:
            raise InputError(
                "The image shows too few lines.", where="seen_lines", value=len(made), allowed=f"{LINES} lines"
            )
        pile[max(top - 4, 0) : top + 5] = 0
        rest = col[near] - np.polyval(np.polyfit(row[near], col[near], 2), row[near])
        kept = np.abs(rest) < 3.0 * 1.4826 * np.median(np.abs(rest))
        made.append((row[near][kept], col[near][kept]))
    return tuple(sorted(made, key=lambda line: float(line[1].mean() - slopes[best] * line[0].mean())))


def wall_of(image: Float, finder: str = "line-erf") -> Wall:
    """Board and lines of an image of the wall. The board lies on it; corners are read in red, lines in twice green less red."""
    seen = find_board(image[..., 0], BOARD)
    place = np.stack([_ROW0 + (seen.place[:, 0] - _ROW0) * _FX / _FY, seen.place[:, 1]], axis=1)
    seen = SeenBoard(place, seen.sigma)
    pose = board_pose(CAMERA, BOARD.points(), seen)
    miss = corner_misses(CAMERA, pose, BOARD.points(), seen) * seen.sigma.T.ravel()
    row, col = found_lines(2.0 * image[..., 1] - image[..., 0], _WALL_PX, 40, finder=finder)
    inside = col > seen.place[:, 1].max() + 50.0  # right of the board
    return Wall(pose, float(np.sqrt((miss**2).mean())), seen_lines(row[inside], col[inside]))


def planes_of(walls: Sequence[Wall]) -> tuple[Plane, ...]:
    """The plane of each line through its points in all images."""
    return tuple(Plane.through(np.concatenate([wall.points(k) for wall in walls])) for k in range(LINES))


def coral_points(image: Float, planes: Sequence[Plane]) -> tuple[Float, Float, Float, npt.NDArray[np.int64]]:
    """(rows, columns, points (n, 3) [m], number of the line) on the coral.

    Read in the sum of the channels: green is saturated in the middle of a line, red is not. Each point has the one plane that puts
    it into `DEPTHS_M`. Kept are pieces of `_LEAST_ROWS` rows or more that run to the left downward: the mirror image of the coral
    in the table runs the other way.
    """
    wider = {"rig.lens_sigma_px": 2.5, "rig.detector.full_well_e": 8e4, "rig.detector.adc_bits": 12}
    row, col = found_lines(image.sum(axis=2), _CORAL_PX, 20, wider)
    points = np.stack([on_plane(row, col, plane.normal, plane.place) for plane in planes])
    within = (points[..., 2] > DEPTHS_M[0]) & (points[..., 2] < DEPTHS_M[1])
    number = np.where(within.sum(axis=0) == 1, within.argmax(axis=0), -1)
    kept = np.zeros(row.size, bool)
    for k in range(len(planes)):
        own = np.flatnonzero(number == k)
        for piece in _pieces(row[own], col[own]):
            slope = np.polyfit(row[own[piece]], col[own[piece]], 1)[0] if piece.size >= _LEAST_ROWS else 1.0
            kept[own[piece]] = slope < 0
    chosen = np.flatnonzero(kept)
    return row[chosen], col[chosen], points[number[chosen], chosen], number[chosen]


def _pieces(row: Float, col: Float) -> list[npt.NDArray[np.int64]]:
    """Chains of points, each within a row or two and two columns of the one before it."""
    open_: list[list[int]] = []
    done: list[list[int]] = []
    for k in np.lexsort((col, row)):
        near = [chain for chain in open_ if 0 < row[k] - row[chain[-1]] <= 2 and abs(col[k] - col[chain[-1]]) <= 2]
        if near:
            near[0].append(int(k))
        else:
            open_.append([int(k)])
        done += [chain for chain in open_ if row[k] - row[chain[-1]] > 2]
        open_ = [chain for chain in open_ if row[k] - row[chain[-1]] <= 2]
    return [np.array(chain) for chain in done + open_]


def _rms_mm(value: Float) -> float:
    return float(np.sqrt((value**2).mean()) * 1e3)


def main(folder: Path, picture: Path | None = None) -> None:
    """Print the figures, and write the picture."""
    walls = [wall_of(read_image(folder / name)) for name in WALLS]
    planes = planes_of(walls)
    for name, wall in zip(WALLS, walls, strict=True):
        rows = [line[0].size for line in wall.lines]
        print(
            f"{name}: {len(wall.lines)} lines of {min(rows)} to {max(rows)} rows; corners {wall.corner_rms_px:.2f} px rms"
        )
    print("line  plane, mm rms  wall by planes of all, mm rms  wall by planes of the other images, mm rms")
    for k, plane in enumerate(planes):
        own, others = [], []
        for wall in walls:
            row, col = wall.lines[k]
            own.append(wall.away(on_plane(row, col, plane.normal, plane.place)))
            rest = planes_of([other for other in walls if other is not wall])[k]
            others.append(wall.away(on_plane(row, col, rest.normal, rest.place)))
        flat = plane.away(np.concatenate([wall.points(k) for wall in walls]))
        print(
            f"{k:4d}  {_rms_mm(flat):13.3f}  {_rms_mm(np.concatenate(own)):29.2f}  {_rms_mm(np.concatenate(others)):42.2f}"
        )
    for name, wall in zip(WALLS, walls, strict=True):
        made = [on_plane(*wall.lines[k], p.normal, p.place) for k, p in enumerate(planes)]
        cloud = np.concatenate(made)
        print(f"{name}: flatness of the triangulated wall {_rms_mm(Plane.through(cloud).away(cloud)):.2f} mm rms")
    normal = np.stack([plane.normal for plane in planes])
    level = np.array([plane.normal @ plane.place for plane in planes])
    common = np.linalg.lstsq(normal, level, rcond=None)[0]
    print(f"planes pass one common line within {_rms_mm(normal @ common - level):.3f} mm rms")
    row, col, points, number = coral_points(read_image(folder / CORAL), planes)
    low, high = np.percentile(points[:, 2], [1, 99])
    print(f"{CORAL}: {row.size} points of {np.unique(number).size} lines, depth {low:.3f} to {high:.3f} m (1 and 99 %)")
    if picture is not None:
        picture.write_bytes(depth_picture(row, col, points[:, 2]))
        print(picture)


def depth_picture(row: Float, col: Float, depth: Float) -> bytes:
    """A PNG of the points' depths; nothing elsewhere."""
    from ..report.pictures import SEQUENTIAL, png

    low, high = (np.percentile([row, col], share, axis=1).astype(int) for share in (0.5, 99.5))
    image = np.full(tuple((high - low) // _COARSE + 3), np.nan)
    at = (np.stack([row, col], axis=1).astype(int) - low) // _COARSE + 1
    inside = ((at >= 0) & (at < image.shape)).all(axis=1)
    image[tuple(at[inside].T)] = depth[inside]
    return png(image, *DEPTHS_M, SEQUENTIAL)


if __name__ == "__main__":
    if len(sys.argv) not in (2, 3):
        sys.exit(__doc__)
    main(Path(sys.argv[1]), Path(sys.argv[2]) if len(sys.argv) == 3 else None)
