"""Zonal reconstruction by least squares on any mask: Southwell's and Fried's geometries as sparse systems.

Southwell: phases at the lenslets' centres, and (φ_{i+1} − φ_i)/h = (s_i + s_{i+1})/2 between neighbours. Fried: phases at the
lenslets' corners, and the slopes are means of the differences along both edges; their sum and difference are the differences
along the two diagonals, so that both geometries are graphs:

    φ_b − φ_a = h (s_x + s_y),    φ_d − φ_c = h (s_x − s_y).

The null space has one constant per connected part: piston; in Fried's, whose diagonals link every second corner only, waffle
too. Both are set to zero, which is the solution of least norm.

Sources: W. H. Southwell, JOSA 70:998, 1980; D. L. Fried, JOSA 67:370, 1977.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.sparse import coo_array, csr_array
from scipy.sparse.csgraph import connected_components
from scipy.sparse.linalg import splu

__all__ = ["Zonal", "fried", "noise_propagation", "southwell"]

Float = NDArray[np.float64]
Index = NDArray[np.intp]


@dataclass(frozen=True, eq=False)
class Zonal:
    """A graph of phases and the slopes that its edges take.

    Main arguments:
        nodes (nodes, 2): row, column of each phase in its grid. difference (edges, nodes): A of A φ = h B s. take (edges,
        2·lenslets): B,
            slopes ordered (lenslet, axis), axis x then y. pitch_m: h. part (nodes): number of the connected part of each node.
    """

    nodes: Index
    difference: csr_array
    take: csr_array
    pitch_m: float
    part: Index
    _solve: Callable[[Float], Float] = field(repr=False)

    @property
    def parts(self) -> int:
        """Number of connected parts, each with a constant that slopes do not show."""
        return int(self.part.max()) + 1

    def solve(self, slopes: ArrayLike) -> Float:
        """φ (…, nodes) [unit of slope times metre] of slopes (…, lenslets, 2); each part of zero mean.

        Slopes in rad give metres of path, phase gradients in rad/m give radians. Lenslets in the order of the mask, row by row.
        Raises ValueError for another number of lenslets or a slope that is not finite: leave such a lenslet out of the mask.
        """
        s = np.asarray(slopes, np.float64)
        if s.shape[-2:] != (self.take.shape[1] // 2, 2):
            raise ValueError(f"slopes need the shape (…, {self.take.shape[1] // 2}, 2), not {s.shape}.")
        if not np.isfinite(s).all():
            raise ValueError("slopes must be finite: leave lenslets without a slope out of the mask.")
        flat = s.reshape(-1, self.take.shape[1]).T
        right = self.difference.T @ (self.take @ flat) * self.pitch_m
        phase = self._solve(np.asarray(right))
        for part in range(self.parts):
            inside = self.part == part
            phase[inside] -= phase[inside].mean(axis=0)
        return np.asarray(phase.T.reshape((*s.shape[:-2], len(self.nodes))))

    def on_grid(self, phase: ArrayLike) -> Float:
        """Phases (…, nodes) on their grid (…, rows, cols); NaN where there is no node."""
        values = np.asarray(phase, np.float64)
        rows, cols = self.nodes.max(axis=0) + 1
        grid = np.full((*values.shape[:-1], rows, cols), np.nan)
        grid[..., self.nodes[:, 0], self.nodes[:, 1]] = values
        return grid


def southwell(mask: ArrayLike, pitch_m: float) -> Zonal:
    """Southwell's geometry over the lenslets of `mask` (rows, cols) bool, `pitch_m` apart.

    Raises ValueError for a mask without lenslets or a pitch that is not positive.
    """
    valid = _mask(mask, pitch_m)
    number = _numbers(valid)
    edges, take = [], []
    for axis, (a, b) in enumerate(
        ((number[:, :-1], number[:, 1:]), (number[:-1, :], number[1:, :])),
    ):
        both = (a >= 0) & (b >= 0)
        edges.append(np.stack([a[both], b[both]], axis=1))
        take.append(np.stack([2 * a[both] + axis, 2 * b[both] + axis], axis=1))
    edge, taken = np.concatenate(edges), np.concatenate(take)
    return _zonal(
        np.argwhere(valid), edge, taken, np.full(taken.shape, 0.5), np.ones(len(edge)), 2 * valid.sum(), pitch_m
    )


def fried(mask: ArrayLike, pitch_m: float) -> Zonal:
    """Fried's geometry: phases at the corners of the lenslets of `mask` (rows, cols) bool. Raises as `southwell`."""
    valid = _mask(mask, pitch_m)
    row, col = np.nonzero(valid)
    used = np.zeros((valid.shape[0] + 1, valid.shape[1] + 1), bool)
    for dy, dx in ((0, 0), (0, 1), (1, 0), (1, 1)):
        used[row + dy, col + dx] = True
    number = _numbers(used)
    lenslet = np.arange(row.size)
    down = np.stack([number[row, col], number[row + 1, col + 1]], axis=1)
    up = np.stack([number[row + 1, col], number[row, col + 1]], axis=1)
    both = np.stack([2 * lenslet, 2 * lenslet + 1], axis=1)
    sign = np.concatenate([np.ones((row.size, 2)), np.tile([1.0, -1.0], (row.size, 1))])
    # A sum of two slopes has twice the variance of one.
    weight = np.full(2 * row.size, 1.0 / np.sqrt(2.0))
    return _zonal(
        np.argwhere(used), np.concatenate([down, up]), np.concatenate([both, both]), sign, weight, 2 * row.size, pitch_m
    )


def noise_propagation(zonal: Zonal) -> float:
    """G: mean variance of the phases over h²σ_s², for independent slopes of variance σ_s². Dense: up to about 40 × 40 lenslets."""
    count = zonal.take.shape[1]
    response = zonal.solve(np.eye(count).reshape(count, count // 2, 2)) / zonal.pitch_m
    return float((response**2).sum() / response.shape[1])


def _zonal(nodes: Index, edge: Index, taken: Index, share: Float, weight: Float, slopes: int, pitch_m: float) -> Zonal:
    """The system of a graph: `weight` (φ_b − φ_a) = `weight` h Σ share · slope."""
    count, row = len(nodes), np.arange(len(edge))
    difference = csr_array(
        coo_array(
            (np.concatenate([weight, -weight]), (np.concatenate([row, row]), np.concatenate([edge[:, 1], edge[:, 0]]))),
            shape=(len(edge), count),
        )
    )
    take = csr_array(
        coo_array(
            ((share * weight[:, None]).ravel(), (np.repeat(row, 2), taken.ravel())), shape=(len(edge), int(slopes))
        )
    )
    normal = csr_array(difference.T @ difference)
    part = connected_components(normal, directed=False)[1].astype(np.intp)
    # One node of each part is held: the rest is positive definite.
    free = np.ones(count, bool)
    free[np.unique(part, return_index=True)[1]] = False
    factor: Any = splu(normal[free][:, free].tocsc()) if free.any() else None

    def solve(right: Float) -> Float:
        phase = np.zeros_like(right)
        if factor is not None:
            phase[free] = factor.solve(np.ascontiguousarray(right[free]))
        return phase

    return Zonal(nodes, difference, take, float(pitch_m), part, solve)


def _numbers(valid: NDArray[np.bool_]) -> Index:
    number = np.full(valid.shape, -1, np.intp)
    number[valid] = np.arange(valid.sum())
    return number


def _mask(mask: ArrayLike, pitch_m: float) -> NDArray[np.bool_]:
    valid = np.asarray(mask, bool)
    if valid.ndim != 2 or not valid.any():
        raise ValueError(f"mask needs two dimensions and at least one lenslet, not shape {valid.shape}.")
    if not (pitch_m > 0 and np.isfinite(pitch_m)):
        raise ValueError(f"pitch_m must be positive and finite, not {pitch_m!r}.")
    return valid
