"""Zonal reconstruction: phases at the lenslets by least squares of their differences, in Southwell's and Fried's geometry.

Between the lenslets the phase is a plane of each lenslet's own slope through its phase, and such planes of the four lenslets around
a sample are mixed bilinearly. Zernike coefficients are the projection of that surface.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np
import numpy.typing as npt
import xarray as xr
from scipy.sparse import csr_array

from ...optics.reconstruction.zonal import Zonal, fried, southwell
from ...optics.zernike import zernike
from ..registry import estimator
from ..result import stage_result
from ..rig import DeclaredRig
from .geometry import Geometry, declared_geometry
from .modal import check_square, last_mode, pupil_grid, read_slopes

__all__ = ["zonal_fried", "zonal_southwell"]

Float = npt.NDArray[np.float64]
Bool = npt.NDArray[np.bool_]

#: Least rms over the samples that are seen of any sum of modes of unit rms, from which samples tell modes apart: below, what the
#: surface errs by enters the coefficients more than ten times.
_LEAST_SEEN = 0.1


@dataclass(frozen=True, eq=False)
class _Solver:
    """The linear maps of one set of valid lenslets.

    response (lenslet, 2·lenslet): phases [rad] at the centres per slope [rad]. mix, along, down (inside, lenslet): weights of a
    sample's planes, and these times the sample's distance [m] along each axis times k. modes (mode, 2·lenslet): NaN where the
    samples do not tell the modes apart.
    """

    used: npt.NDArray[np.int64]
    response: Float
    mix: csr_array
    along: csr_array
    down: csr_array
    modes: Float
    mask: Bool


@lru_cache(maxsize=8)
def _solver(rig: DeclaredRig, geometry_name: str, last: int, valid: bytes) -> _Solver | None:
    """The solver of valid lenslets (as bytes of flags); None where fewer than two of them join."""
    geometry = declared_geometry(rig)
    flags = np.frombuffer(valid, bool)
    used = np.flatnonzero(flags)
    site = geometry.site[used]
    shape = geometry.site.max(axis=0) + 1
    grid = np.zeros(shape, bool)
    grid[site[:, 0], site[:, 1]] = True
    made = (southwell if geometry_name == "southwell" else fried)(grid, geometry.pitch_m)
    order = np.argsort(site[:, 0] * shape[1] + site[:, 1], kind="stable")
    used, site = used[order], site[order]  # row by row, as the mask's
    centre, part = _at_centres(made, site, geometry_name)
    whole = part == np.bincount(part).argmax()
    if int(whole.sum()) < 2:
        return None
    count = len(used)
    # Slopes become phases by k.
    unit = np.eye(2 * count).reshape(2 * count, count, 2)
    response = (centre @ made.solve(unit).T) * geometry.wavenumber
    mix, along, down, mask = _planes(geometry, used, whole)
    project = _projector(geometry, last, mask)
    modes = (project @ mix) @ response
    modes[:, 0::2] += project @ along
    modes[:, 1::2] += project @ down
    return _Solver(used, response, mix, along, down, modes, mask)


def _at_centres(made: Zonal, site: npt.NDArray[np.int64], name: str) -> tuple[Any, npt.NDArray[np.intp]]:
    """(weights (lenslet, node) of the phase at a lenslet's centre, number of the part that it belongs to)."""
    number = np.full(made.nodes.max(axis=0) + 1, -1, np.int64)
    number[made.nodes[:, 0], made.nodes[:, 1]] = np.arange(len(made.nodes))
    row, col = site.T
    corners = ((0, 0),) if name == "southwell" else ((0, 0), (0, 1), (1, 0), (1, 1))
    node = np.stack([number[row + dy, col + dx] for dy, dx in corners], axis=1)
    value = np.full(node.shape, 1.0 / len(corners))
    at = np.repeat(np.arange(len(site)), len(corners))
    weights = csr_array((value.ravel(), (at, node.ravel())), shape=(len(site), len(made.nodes)))
    return weights, made.part[node[:, 0]]


def _planes(
    geometry: Geometry, used: npt.NDArray[np.int64], whole: Bool
) -> tuple[csr_array, csr_array, csr_array, Bool]:
    """`mix`, `along`, `down` of `_Solver`, and the samples (side, side) within a pitch of a lenslet of the largest part."""
    x, y, inside = pupil_grid(geometry)
    row, col = geometry.site[used].T
    shape = (int(row.max()) + 3, int(col.max()) + 3)
    number = np.full(shape, -1, np.int64)
    number[row[whole] + 1, col[whole] + 1] = np.flatnonzero(whole)
    first = geometry.centre_m[used[0]] - geometry.pitch_m * np.array([col[0], row[0]])
    px, py = x[inside], y[inside]
    u, v = (px - first[0]) / geometry.pitch_m + 1.0, (py - first[1]) / geometry.pitch_m + 1.0
    left, top = np.floor(u).astype(np.int64), np.floor(v).astype(np.int64)
    indices, values, samples = [], [], []
    for dy, dx in ((0, 0), (0, 1), (1, 0), (1, 1)):
        weight = np.abs(1 - dx - (u - left)) * np.abs(1 - dy - (v - top))
        at_row, at_col = top + dy, left + dx
        there = (at_row >= 0) & (at_row < shape[0]) & (at_col >= 0) & (at_col < shape[1])
        index = np.where(there, number[np.clip(at_row, 0, shape[0] - 1), np.clip(at_col, 0, shape[1] - 1)], -1)
        kept = (index >= 0) & (weight > 1e-9)
        indices.append(index[kept])
        values.append(weight[kept])
        samples.append(np.flatnonzero(kept))
    index, value, sample = (np.concatenate(part) for part in (indices, values, samples))
    total = np.bincount(sample, weights=value, minlength=px.size)
    value = value / total[sample]
    size = (px.size, len(used))
    centre = geometry.centre_m[used[index]]
    k = geometry.wavenumber
    mix = csr_array((value, (sample, index)), shape=size)
    along = csr_array((k * value * (px[sample] - centre[:, 0]), (sample, index)), shape=size)
    down = csr_array((k * value * (py[sample] - centre[:, 1]), (sample, index)), shape=size)
    mask = np.zeros(inside.shape, bool)
    mask[inside] = total > 0
    kept = total > 0
    return mix[kept], along[kept], down[kept], mask


def _projector(geometry: Geometry, last: int, mask: Bool) -> Float:
    """Least squares of modes 1 … last over the samples: (mode from 2, sample); NaN where these do not tell the modes apart."""
    x, y, _ = pupil_grid(geometry)
    radius = 0.5 * geometry.diameter_m
    values = zernike(range(1, last + 1), x[mask] / radius, y[mask] / radius)
    gram = values @ values.T
    if not np.linalg.eigvalsh(gram)[0] >= _LEAST_SEEN**2 * values.shape[1]:
        return np.full((last - 1, values.shape[1]), np.nan)
    return np.asarray(np.linalg.solve(gram, values))[1:]


def _reconstructed(slopes: xr.Dataset, rig: DeclaredRig, name: str, modes: int) -> xr.Dataset:
    geometry = declared_geometry(rig)
    check_square(geometry, f"zonal-{name}", "its differences join the neighbours of a square grid")
    last = last_mode(rig, modes)
    own, variance, valid = read_slopes(slopes, geometry)
    frames, side = len(own), geometry.samples
    coefficient, sigma = np.full((frames, last - 1), np.nan), np.full((frames, last - 1), np.nan)
    phase, spread = np.full((frames, side, side), np.nan), np.full((frames, side, side), np.nan)
    for frame in range(frames):
        if int(valid[frame].sum()) < 2:
            continue
        solver = _solver(rig, name, last, valid[frame].tobytes())
        if solver is None:
            continue
        s, v = own[frame][solver.used], variance[frame][solver.used]
        nodes = solver.response @ s.ravel()
        surface = solver.mix @ nodes + solver.along @ s[:, 0] + solver.down @ s[:, 1]
        phase[frame][solver.mask] = surface - surface.mean()
        noise = solver.mix @ ((solver.response**2) @ v.ravel())
        noise = noise + solver.along.power(2) @ v[:, 0] + solver.down.power(2) @ v[:, 1]
        spread[frame][solver.mask] = np.sqrt(noise)
        if 2 * int(valid[frame].sum()) >= last - 1:
            coefficient[frame] = solver.modes @ s.ravel()
            sigma[frame] = np.sqrt((solver.modes**2) @ v.ravel())
    return stage_result(
        "reconstruction", zernike=coefficient, sigma=sigma, valid=np.isfinite(coefficient), phase=phase, sigma_phase=spread,
        valid_phase=np.isfinite(phase),
    )  # fmt: skip


@estimator("reconstruction", cites="W. H. Southwell, JOSA 70:998, 1980 (phases and slopes at the lenslets' centres)")
def zonal_southwell(slopes: xr.Dataset, rig: DeclaredRig, *, modes: int = 0) -> xr.Dataset:
    """Phases at the lenslets' centres: (φ_b − φ_a)/h is the mean of both slopes, by least squares over all neighbours.

    Other arguments:
        modes: greatest Noll index of the coefficients that are projected; 0: that of the rig.

    Returns zernike, sigma [rad rms] (frame, mode) and phase [rad] on the pupil's grid, without piston; standard errors are the
    noise's. Samples farther than a pitch from every valid lenslet of the largest connected part are invalid, and so are
    coefficients that the other samples do not tell apart. Raises InputError for hexagonal lenslets, or fewer slopes than modes.
    """
    return _reconstructed(slopes, rig, "southwell", modes)


@estimator("reconstruction", cites="D. L. Fried, JOSA 67:370, 1977 (phases at the lenslets' corners)")
def zonal_fried(slopes: xr.Dataset, rig: DeclaredRig, *, modes: int = 0) -> xr.Dataset:
    """Phases at the lenslets' corners, whose mean differences along both edges are the slopes, by least squares; waffle is 0.

    Other arguments and returns as for `zonal-southwell`.
    """
    return _reconstructed(slopes, rig, "fried", modes)
