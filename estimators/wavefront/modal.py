"""Reconstruction by Zernike polynomials: least squares, and the most probable coefficients under Kolmogorov turbulence.

Slopes s = A c + noise, A_{(l, axis), j} = ⟨∂Z_j/∂x⟩_l/k, the gradient averaged over lenslet l (not that at its centre).
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from typing import Any

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

__all__ = [
    "Modes", "check_disc", "check_square", "last_mode", "modal_result", "modes_of", "pupil_grid", "read_slopes", "zernike_ls",
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
    modes: Modes, coefficient: Float, covariance: list[Float | None], good: Bool, last: int = 0
) -> xr.Dataset:
    """The result of the stage `reconstruction` from coefficients (frame, mode) and their covariances, None where there are none;
    `last`: greatest Noll index that is reported (0: all), while all make the phase.

    The phase's standard error is that of the coefficients, √(Zᵀ C Z); samples outside the pupil are invalid.
    """
    frames, number = coefficient.shape
    side = modes.mask.shape[0]
    sigma = np.full((frames, number), np.nan)
    phase, spread = np.full((frames, side, side), np.nan), np.full((frames, side, side), np.nan)
    shown: dict[int, Float] = {}
    for frame in range(frames):
        held = covariance[frame]
        if not good[frame] or held is None:
            continue
        sigma[frame] = np.sqrt(np.diagonal(held))
        phase[frame][modes.mask] = coefficient[frame] @ modes.surface
        if id(held) not in shown:
            shown[id(held)] = np.sqrt(
                np.maximum(np.einsum("jp,jk,kp->p", modes.surface, held, modes.surface, optimize=True), 0)
            )
        spread[frame][modes.mask] = shown[id(held)]
    if last:
        coefficient, sigma = coefficient[:, : last - 1], sigma[:, : last - 1]
    there = np.broadcast_to(good[:, None], coefficient.shape)
    inside = good[:, None, None] & modes.mask
    return stage_result(
        "reconstruction",
        zernike=coefficient,
        sigma=sigma,
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
    """Greatest Noll index to estimate; 0: that of the rig. Raises InputError for fewer slopes than modes."""
    geometry = declared_geometry(rig)
    if disc:
        check_disc(geometry)
    last = geometry.modes if modes == 0 else int(modes)
    lenslets = len(geometry.centre_m)
    if last < 2 or last - 1 > 2 * lenslets:
        raise InputError(
            "There are fewer slopes than modes.", where="modes", value=f"{last - 1} modes, {2 * lenslets} slopes",
            allowed=f"2 to {2 * lenslets + 1}", next_step="fit fewer modes, e.g. zernike-ls[modes=10]",
        )  # fmt: skip
    return last


@estimator(
    "reconstruction",
    cites="Guo et al. 2017, Eq. 27 and 30; R. Cubalchini, JOSA 69:972, 1979 (least squares of lenslet-averaged gradients)",
)
def zernike_ls(slopes: xr.Dataset, rig: DeclaredRig, *, modes: int = 0, weighted: bool = True) -> xr.Dataset:
    """c minimises Σ w (s − A c)², A the gradients averaged over the lenslets, w = 1/σ² or, not `weighted`, 1.

    Main arguments: slopes [rad] and their standard errors; the declared rig.
    Other arguments:
        modes: greatest Noll index; 0: that of the rig, as far as the slopes can tell modes apart.

    Returns zernike, sigma [rad rms] (frame, mode), Noll's index from 2, and phase [rad] on the pupil's grid. sigma is the noise's,
    (Aᵀ Σ⁻¹ A)⁻¹; what the modes that are left out do to those that are fitted (aliasing) is not in it. A frame is invalid where its
    slopes do not tell the modes apart. Raises InputError for fewer slopes than modes.
    """
    last = last_mode(rig, modes)
    basis = modes_of(rig, last)
    own, variance, valid = read_slopes(slopes, declared_geometry(rig))
    return _least_squares(basis, own, variance, valid, weighted=weighted)


def _least_squares(basis: Modes, own: Float, variance: Float, valid: Bool, *, weighted: bool) -> xr.Dataset:
    frames, number = len(own), basis.slope.shape[2]
    coefficient, good = np.full((frames, number), np.nan), np.zeros(frames, bool)
    covariance: list[Float | None] = [None] * frames
    known: dict[bytes, tuple[Any, Any, Float] | None] = {}
    for frame in range(frames):
        use = np.repeat(valid[frame], 2)
        if 2 * int(valid[frame].sum()) < number:
            continue
        a, s = basis.slope.reshape(-1, number)[use], own[frame].reshape(-1)[use]
        v = variance[frame].reshape(-1)[use]
        if weighted:
            root = 1.0 / np.sqrt(v)
            solved = _solver(a * root[:, None])
            if solved is not None:
                inverse, noise = solved
                coefficient[frame], covariance[frame] = inverse @ (s * root), noise
                good[frame] = True
            continue
        key = use.tobytes()
        if key not in known:
            plain = _solver(a)
            known[key] = None if plain is None else (*plain, a)
        held = known[key]
        if held is not None:
            inverse = held[0]
            coefficient[frame], covariance[frame] = inverse @ s, (inverse * v) @ inverse.T
            good[frame] = True
    return modal_result(basis, coefficient, covariance, good)


def _solver(a: Float) -> tuple[Float, Float] | None:
    """(pseudo-inverse, (AᵀA)⁻¹) of a tall matrix; None where its columns are not told apart."""
    u, d, vt = np.linalg.svd(a, full_matrices=False)
    if not d[-1] * _CONDITION > d[0]:
        return None
    return (vt.T / d) @ u.T, (vt.T / d**2) @ vt
