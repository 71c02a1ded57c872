"""Reconstruction by Zernike polynomials: least squares, and the most probable coefficients under Kolmogorov turbulence.

Slopes s = A c + noise, A_{(l, axis), j} = ⟨∂Z_j/∂x⟩_l/k, the gradient averaged over lenslet l (not that at its centre).
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
import numpy.typing as npt
import xarray as xr

from ...optics.lenslets.gradients import mean_gradients
from ...optics.zernike import zernike
from ...scenes.errors import InputError
from ..registry import estimator
from ..result import stage_result
from ..rig import DeclaredRig
from .geometry import Geometry, declared_geometry
from .options import whole

__all__ = [
    "Modes", "Solver", "check_disc", "check_square", "last_mode", "modal_result", "modes_of", "pupil_grid", "read_slopes",
    "zernike_ls",
]  # fmt: skip

Float = npt.NDArray[np.float64]
Bool = npt.NDArray[np.bool_]

#: Greatest ratio of singular values of the equations at which the modes count as told apart.
_CONDITION = 1e6


@dataclass(frozen=True, eq=False)
class Modes:
    """Zernike modes 2 … J of a declared rig: `slope` (lenslet, axis, mode) [rad per rad rms] along the array's axes; `surface`
    (mode, inside) values at the samples `mask` (side, side) inside the pupil, their mean removed."""

    slope: Float
    surface: Float
    mask: Bool


def check_square(geometry: Geometry, method: str, reason: str) -> None:
    """Raise InputError for hexagonal lenslets, which a method does not reconstruct from."""
    if geometry.hexagonal:
        raise InputError(
            f"{method} reconstructs from square lenslets only: {reason}.", where="attribute rig: lenslets.grid",
            value="hexagonal", allowed="square", next_step="take zernike-ls, which averages gradients over hexagons",
        )  # fmt: skip


def check_disc(geometry: Geometry) -> None:
    """Raise InputError for a pupil that is no disc."""
    if geometry.shape != "disc":
        raise InputError(
            "Zernike polynomials are those of a disc.", where="attribute rig: pupil.shape", value=geometry.shape, allowed="disc",
            next_step="take a zonal reconstruction",
        )  # fmt: skip


@lru_cache(maxsize=8)
def modes_of(rig: DeclaredRig, last: int) -> Modes:
    """The modes up to Noll's index `last`. Raises InputError for a pupil that is no disc."""
    geometry = declared_geometry(rig)
    check_disc(geometry)
    noll = range(2, last + 1)
    radius = 0.5 * geometry.diameter_m
    slope = mean_gradients(noll, geometry.centre_m, geometry.corners_m, radius) / geometry.wavenumber
    x, y, mask = pupil_grid(geometry)
    surface = zernike(noll, x[mask] / radius, y[mask] / radius)
    return Modes(slope, surface - surface.mean(axis=1, keepdims=True), mask)


def pupil_grid(geometry: Geometry) -> tuple[Float, Float, Bool]:
    """x, y [m] (side, side) of the samples of the pupil's grid, and which lie inside the pupil."""
    t = geometry.step_m * (np.arange(geometry.samples) - 0.5 * (geometry.samples - 1))
    x, y = np.broadcast_arrays(t[None, :], t[:, None])
    half = 0.5 * geometry.diameter_m
    mask = np.hypot(x, y) <= half if geometry.shape == "disc" else (np.abs(x) <= half) & (np.abs(y) <= half)
    return np.asarray(x), np.asarray(y), np.asarray(mask)


def modal_result(
    modes: Modes, coefficient: Float, covariance: list[Float | None], good: Bool, last: int = 0, *, sigma: Float | None = None
) -> xr.Dataset:  # fmt: skip
    """The result of the stage `reconstruction` from coefficients (frame, mode) and their covariances, None where there are none.

    Other arguments:
        last: greatest Noll index that is reported (0: all), while all make the phase. sigma (frame, mode): standard errors of the
            coefficients, where a covariance is shared by frames of different noise: it is then scaled to their mean square.

    The phase's standard error is that of the coefficients, √(Zᵀ C Z); samples outside the pupil are invalid.
    """
    frames, number = coefficient.shape
    side = modes.mask.shape[0]
    own = np.full((frames, number), np.nan) if sigma is None else sigma.copy()
    phase, spread = np.full((frames, side, side), np.nan), np.full((frames, side, side), np.nan)
    shown: dict[int, Float] = {}
    for frame in range(frames):
        held = covariance[frame]
        if not good[frame] or held is None:
            continue
        variance = np.diagonal(held)
        if sigma is None:
            own[frame] = np.sqrt(variance)
        phase[frame][modes.mask] = coefficient[frame] @ modes.surface
        if id(held) not in shown:
            shown[id(held)] = np.sqrt(
                np.maximum(np.einsum("jp,jk,kp->p", modes.surface, held, modes.surface, optimize=True), 0)
            )
        spread[frame][modes.mask] = shown[id(held)] * np.sqrt((own[frame] ** 2).mean() / variance.mean())
    if last:
        coefficient, own = coefficient[:, : last - 1], own[:, : last - 1]
    there = np.broadcast_to(good[:, None], coefficient.shape)
    inside = good[:, None, None] & modes.mask
    return stage_result(
        "reconstruction",
        zernike=coefficient,
        sigma=own,
        valid=there,
        phase=phase,
        sigma_phase=spread,
        valid_phase=inside,
    )


def read_slopes(slopes: xr.Dataset, geometry: Geometry) -> tuple[Float, Float, Bool]:
    """(slopes along the array's axes [rad], variances, valid), (frame, lenslet, axis) and (frame, lenslet).

    Variances of the two axes are averaged where the array is turned: both have nearly the same.
    """
    value, sigma = (np.asarray(slopes[name].values, np.float64) for name in ("slope", "sigma"))
    valid = np.asarray(slopes["valid"].values, bool)
    own = geometry.own_axes(np.where(valid[:, :, None], value, 0.0))
    variance = np.where(valid[:, :, None], sigma**2, np.inf)
    if geometry.rotation_rad != 0.0:
        variance = np.broadcast_to(variance.mean(axis=2, keepdims=True), variance.shape)
    return own, variance, valid


def last_mode(rig: DeclaredRig, modes: int, *, disc: bool = False) -> int:
    """Greatest Noll index to estimate; 0: that of the rig. Raises InputError for an index that is none, or fewer slopes than
    modes."""
    geometry = declared_geometry(rig)
    if disc:
        check_disc(geometry)
    last = geometry.modes if modes == 0 else whole("modes", modes, 2)
    lenslets = len(geometry.centre_m)
    if last - 1 > 2 * lenslets:
        raise InputError(
            "There are fewer slopes than modes.", where="modes", value=f"{last - 1} modes, {2 * lenslets} slopes",
            allowed=f"2 to {2 * lenslets + 1}", next_step=f"fit fewer modes: the option modes={2 * lenslets + 1}, or less",
        )  # fmt: skip
    return last


@estimator(
    "reconstruction",
    cites="Guo et al. 2017, Eq. 27 and 30; R. Cubalchini, JOSA 69:972, 1979 (least squares of lenslet-averaged gradients)",
    joint=True,
)
def zernike_ls(slopes: xr.Dataset, rig: DeclaredRig, *, modes: int = 0, weighted: bool = True) -> xr.Dataset:
    """c minimises Σ w (s − A c)², A the gradients averaged over the lenslets.

    w is 1 over the mean, over the frames with the same valid lenslets, of σ² in units of a frame's own mean; or 1, not `weighted`.
    All these frames have one inverse: their own σ is noisier than what it tells of a lenslet.

    Main arguments: slopes [rad] and their standard errors; the declared rig.
    Other arguments:
        modes: greatest Noll index; 0: that of the rig, as far as the slopes can tell modes apart.

    Returns zernike, sigma [rad rms] (frame, mode), Noll's index from 2, and phase [rad] on the pupil's grid. sigma is the noise's,
    of a frame's own σ; what the modes that are left out do to those that are fitted (aliasing) is not in it. A frame is invalid
    where its slopes do not tell the modes apart. Raises InputError for fewer slopes than modes.
    """
    last = last_mode(rig, modes)
    basis = modes_of(rig, last)
    own, variance, valid = read_slopes(slopes, declared_geometry(rig))
    return _least_squares(basis, own, variance, valid, weighted=weighted)


def _least_squares(basis: Modes, own: Float, variance: Float, valid: Bool, *, weighted: bool) -> xr.Dataset:
    frames, number = len(own), basis.slope.shape[2]
    coefficient, sigma, good = (
        np.full((frames, number), np.nan),
        np.full((frames, number), np.nan),
        np.zeros(frames, bool),
    )
    shared: list[Float | None] = [None] * frames
    for used in np.unique(valid, axis=0):
        group = np.flatnonzero((valid == used).all(axis=1))
        use = np.repeat(used, 2)
        if 2 * int(used.sum()) < number:
            continue
        v = variance[group].reshape(len(group), -1)[:, use]
        shape = (v / v.mean(axis=1, keepdims=True)).mean(axis=0) if weighted else np.ones(v.shape[1])
        solver = Solver.of(basis.slope.reshape(-1, number)[use], shape)
        if solver is None:
            continue
        for frame, own_variance in zip(group, v, strict=True):
            coefficient[frame], square = solver.modes(own[frame].reshape(-1)[use], own_variance)
            sigma[frame], good[frame] = np.sqrt(square), True
            shared[frame] = solver.covariance
    return modal_result(basis, coefficient, shared, good, sigma=sigma)


@dataclass(frozen=True, eq=False)
class Solver:
    """Least squares of one set of lenslets and weights: c = G s, and with N the variances of the slopes C = G N Gᵀ.

    inverse (mode, slope): G. squares: of its elements, so that diag C = squares · variances. covariance: C for the variances that
    the weights were taken from, of mean 1.
    """

    inverse: Float
    squares: Float
    covariance: Float

    @staticmethod
    def of(slope: Float, shape: Float) -> Solver | None:
        """For gradients `slope` (slope, mode) and variances that are as `shape` (slope); None where modes are not told apart."""
        root = 1.0 / np.sqrt(shape)
        u, d, vt = np.linalg.svd(slope * root[:, None], full_matrices=False)
        if not d[-1] * _CONDITION > d[0]:
            return None
        inverse = np.ascontiguousarray(((vt.T / d) @ u.T) * root)
        return Solver(inverse, inverse**2, (inverse * shape) @ inverse.T)

    def modes(self, slope: Float, variance: Float) -> tuple[Float, Float]:
        """(coefficients, their variances) of one frame: two products of a matrix with a vector."""
        return self.inverse @ slope, self.squares @ variance
