"""A checkerboard in an image: its inner corners, ordered into rows and columns of squares.

From one corner the lattice grows: each neighbour is expected where the corners around it point to, and is taken where a corner lies
within a third of a square of it. Source: A. Geiger et al., Proc. ICRA 2012, p. 3936 (growing), with a step that is predicted from
two neighbours where there are two.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from scipy.ndimage import distance_transform_edt

from ...scenes.errors import InputError
from .saddles import fit_saddles, saddle_places

__all__ = ["Board", "SeenBoard", "find_board"]

Float = npt.NDArray[np.float64]

#: A corner lies within this share of a square's side of where it is expected.
_NEAR = 0.3
#: Corners from which growing is tried.
_SEEDS = 12
#: Half of the window of a fit: this share of the distance to the next corner, within limits [px].
_WINDOW, _LEAST_HALF, _MOST_HALF = 0.35, 3, 12


@dataclass(frozen=True)
class Board:
    """A checkerboard of `rows` × `cols` inner corners, `square_m` apart.

    `beyond_m`: how far its plane goes on evenly, beyond the outermost corners along a row and along a column; the laser's line is
    read there, outside of the squares.
    """

    rows: int
    cols: int
    square_m: float
    beyond_m: tuple[float, float] = (0.0, 0.0)

    def __post_init__(self) -> None:
        if min(self.rows, self.cols) < 3 or self.rows == self.cols or not self.square_m > 0:
            raise InputError(
                "The board cannot be used.", where="board", value=(self.rows, self.cols, self.square_m),
                allowed="3 or more inner corners each way, unlike numbers of rows and columns, squares above 0 m",
            )  # fmt: skip

    def points(self) -> Float:
        """Corners (rows·cols, 3) [m] on the board: x along a row, y down, from its first corner."""
        j, i = np.meshgrid(np.arange(self.rows), np.arange(self.cols), indexing="ij")
        zero = np.zeros(i.size)
        return np.stack([i.ravel() * self.square_m, j.ravel() * self.square_m, zero], axis=1)

    def blank(self, x: Float, y: Float) -> npt.NDArray[np.bool_]:
        """Whether places (…) [m] of the board's plane are even matter: within `beyond_m` of the corners, and a quarter of a
        square or more outside of the squares."""
        away = []
        for place, count, beyond in ((x, self.cols, self.beyond_m[0]), (y, self.rows, self.beyond_m[1])):
            outside = np.maximum(-place, place - (count - 1) * self.square_m)
            away.append((outside <= beyond, outside >= 1.25 * self.square_m))
        (in_x, off_x), (in_y, off_y) = away
        return np.asarray(in_x & in_y & (off_x | off_y))


@dataclass(frozen=True, eq=False)
class SeenBoard:
    """Corners of one image, in the order of `Board.points`: `place` and `sigma` (n, 2) row and column [px]."""

    place: Float
    sigma: Float


def find_board(image: Float, board: Board, *, blur_px: float = 2.0, radius_px: float = 6.0) -> SeenBoard:
    """The corners of a board in an image (rows, cols) of light.

    The board may be turned in any way: which end is first is open, as it is on the board itself. Rows and columns go round as on
    the board seen from its front.

    Other arguments: as of `saddle_places`.

    Raises InputError where the image holds no whole board, or more corners in line than the board has, and where a pixel near a
    corner is not finite.
    """
    at = saddle_places(_filled(image), blur_px=blur_px, radius_px=radius_px)
    best = 0
    for seed in range(min(_SEEDS, len(at))):
        lattice = _grown(at, seed)
        best = max(best, len(lattice))
        if (index := _block(lattice, board)) is not None:
            return _refined(image, at[index], board)
    raise InputError(
        "The image does not show the whole board.", where="find_board",
        value=f"{best} corners in a lattice, {len(at)} in all", allowed=f"{board.rows} x {board.cols} corners",
        next_step="show the board whole and sharp, or check its number of inner corners",
    )  # fmt: skip


def _filled(image: Float) -> Float:
    """The image with the value of the nearest finite pixel where it has none: to look for corners, not to fit them."""
    missing = ~np.isfinite(image)
    if not missing.any() or missing.all():
        return np.where(missing, 0.0, image)
    at = distance_transform_edt(missing, return_distances=False, return_indices=True)
    return np.asarray(image[tuple(at)])


def _refined(image: Float, place: Float, board: Board) -> SeenBoard:
    grid = place.reshape(board.rows, board.cols, 2)
    near = np.full(grid.shape[:2], np.inf)
    for axis in (0, 1):
        length = np.linalg.norm(np.diff(grid, axis=axis), axis=2)
        ahead, behind = ([(0, 0), (0, 0)] for _ in range(2))
        ahead[axis], behind[axis] = (0, 1), (1, 0)
        for pad in (ahead, behind):
            near = np.minimum(near, np.pad(length, pad, constant_values=np.inf))
    half = np.clip(np.floor(_WINDOW * near.ravel()), _LEAST_HALF, _MOST_HALF).astype(np.int64)
    found = fit_saddles(image, place, half)
    if not found.good.all():
        raise InputError(
            "Some corners of the board cannot be fitted.", where="find_board",
            value=np.round(place[~found.good]).astype(int).tolist(), allowed="corners of two straight edges within the image",
            next_step="leave this image out, or show the board whole, sharp and evenly lit",
        )  # fmt: skip
    return SeenBoard(found.place, found.sigma)


def _grown(at: Float, seed: int) -> dict[tuple[int, int], int]:
    """{(i, j): number of the corner}, grown from one corner."""
    steps = _first_steps(at, seed)
    if steps is None:
        return {}
    lattice, taken = {(0, 0): seed}, {seed}
    waiting = [(0, 0)]
    while waiting:
        here = waiting.pop(0)
        for move in ((1, 0), (-1, 0), (0, 1), (0, -1)):
            there = (here[0] + move[0], here[1] + move[1])
            if there in lattice:
                continue
            step = _step(at, lattice, here, move, steps)
            wanted = at[lattice[here]] + step
            distance = np.linalg.norm(at - wanted, axis=1)
            number = int(distance.argmin())
            if distance[number] < _NEAR * np.linalg.norm(step) and number not in taken:
                lattice[there] = number
                taken.add(number)
                waiting.append(there)
    return lattice


def _step(
    at: Float, lattice: dict[tuple[int, int], int], here: tuple[int, int], move: tuple[int, int], steps: Float
) -> Float:
    """Expected step from a corner: as the step before it, as that beside it, or as at the seed."""
    back = (here[0] - move[0], here[1] - move[1])
    if back in lattice:
        return np.asarray(at[lattice[here]] - at[lattice[back]])
    for side in ((move[1], move[0]), (-move[1], -move[0])):
        beside = (here[0] + side[0], here[1] + side[1])
        beyond = (beside[0] + move[0], beside[1] + move[1])
        if beside in lattice and beyond in lattice:
            return np.asarray(at[lattice[beyond]] - at[lattice[beside]])
    return np.asarray(steps[0] * move[0] + steps[1] * move[1])


def _first_steps(at: Float, seed: int) -> Float | None:
    """Steps (2, 2) along both edges from a corner: to the nearest corner, and to the nearest one well aside of that line. None
    where the corners opposite to them are missing."""
    away = at - at[seed]
    distance = np.linalg.norm(away, axis=1)
    order = np.argsort(distance)[1:]
    if order.size < 4:
        return None
    one = away[order[0]]
    cross = np.abs(one[0] * away[order, 1] - one[1] * away[order, 0]) / (np.linalg.norm(one) * distance[order])
    aside = order[cross > 0.6]
    if not aside.size or distance[aside[0]] > 2.5 * distance[order[0]]:
        return None
    two = away[aside[0]]
    if one[0] * two[1] - one[1] * two[0] < 0:  # down, then right: the board is seen from its front
        two = -two
    return np.stack([one, two])


def _block(lattice: dict[tuple[int, int], int], board: Board) -> npt.NDArray[np.int64] | None:
    """Numbers (rows·cols) of the corners of the one full block of the board's size, in its order; None where there is none, or
    more than one."""
    if len(lattice) < board.rows * board.cols:
        return None
    key = np.array(list(lattice))
    low = key.min(axis=0)
    table = np.full(tuple(key.max(axis=0) - low + 1), -1)
    for place, number in lattice.items():
        table[tuple(np.array(place) - low)] = number
    blocks = []
    # A turn by a quarter keeps the sense of rotation; a mere exchange of the axes would mirror the board.
    for turned in (table, np.rot90(table)):
        for i in range(turned.shape[0] - board.rows + 1):
            for j in range(turned.shape[1] - board.cols + 1):
                part = turned[i : i + board.rows, j : j + board.cols]
                if (part >= 0).all():
                    blocks.append(part)
    return blocks[0].ravel() if len(blocks) == 1 else None
