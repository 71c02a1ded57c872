"""Reconstruction with the prior of Kolmogorov turbulence: the most probable phase, given slopes and how phases belong together.

Phase and slopes are Gaussian with known covariances but for the strength q = r0^{−5/3}. With C_ss the covariance of the slopes for
r0 = 1 m, N that of their noise, and c(x) that of φ(x) − ⟨φ⟩ with the slopes,

    φ̂(x) = q c(x)ᵀ (q C_ss + N)⁻¹ s,    var = q v(x) − q² c(x)ᵀ (q C_ss + N)⁻¹ c(x),

and the same for Zernike coefficients, c_j = ∫ Z_j c dx. Nothing is left out, so that fitting and aliasing are in the stated errors.
The covariance with the mean gradient over a lenslet of side d is −1/2d times the difference of the means of D over its two edges.
q is what the slopes of all frames together show, by maximum likelihood.

Source: E. P. Wallner, JOSA 73:1771, 1983.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
import numpy.typing as npt
import xarray as xr
from scipy.linalg import cho_factor, cho_solve
from scipy.signal import fftconvolve

from ...optics.turbulence.slopes import gradient_covariance
from ...optics.turbulence.strength import kolmogorov_structure
from ...optics.zernike import zernike
from ...scenes.errors import InputError
from ..registry import estimator
from ..result import stage_result
from ..rig import DeclaredRig
from .geometry import Geometry, declared_geometry
from .modal import check_square, last_mode, pupil_grid, read_slopes
from .strengths import shared_lenslets, slope_covariance, strength_of

__all__ = ["zernike_map"]

Float = npt.NDArray[np.float64]
Bool = npt.NDArray[np.bool_]

#: Weakest turbulence that is taken as the prior, r0 in diameters of the pupil.
_WEAKEST = 1e3
#: Nodes along a lenslet's edge; blocks of a side of the pupil for which the phase's standard error is computed.
_NODES, _BLOCKS = 8, 24
#: Share of the prior's variance below which that of the posterior is rounding.
_ROUNDING = 1e-9


@dataclass(frozen=True, eq=False)
class _Prior:
    """Covariances for r0 = 1 m of one rig and its valid lenslets `used`.

    slopes (2n, 2n) [rad²]. table (2, 2·side, 2·side): with φ at a distance of samples from a lenslet. site (n, 2): row and column
    of a lenslet's centre in samples. modes (mode, 2n), coefficients (mode): variances. blocks (k, 2): samples whose error is
    computed; at_blocks (k, 2n), spread (k): their covariance with the slopes and variance.
    """

    used: npt.NDArray[np.int64]
    slopes: Float
    table: Float
    site: npt.NDArray[np.int64]
    modes: Float
    coefficients: Float
    blocks: npt.NDArray[np.int64]
    at_blocks: Float
    spread: Float
    mask: Bool


@lru_cache(maxsize=4)
def _prior(rig: DeclaredRig, last: int, valid: bytes) -> _Prior:
    geometry = declared_geometry(rig)
    used = np.flatnonzero(np.frombuffer(valid, bool))
    centre, side, k = geometry.centre_m[used], geometry.samples, geometry.wavenumber
    slopes = gradient_covariance(lambda r: kolmogorov_structure(r, 1.0), centre, geometry.pitch_m) / k**2
    _, _, mask = pupil_grid(geometry)
    # Lenslets lie on one grid of samples, up to a common part of a sample.
    place = centre[:, ::-1] / geometry.step_m + 0.5 * (side - 1)
    part = float(np.median(place - np.floor(place)))
    site = np.rint(place - part).astype(np.int64)
    offset = np.asarray((np.arange(-side, side) - part) * geometry.step_m, np.float64)
    table = (
        np.stack(
            [_edges(offset[None, :], offset[:, None], geometry), _edges(offset[:, None], offset[None, :], geometry)]
        )
        / k
    )
    count = float(mask.sum())
    unit = _unit(geometry)
    values = zernike(range(1, last + 1), *(one[mask] for one in unit))
    project = np.linalg.solve(values @ values.T, values)[1:]
    lag = np.arange(-side, side) * geometry.step_m
    kernel = kolmogorov_structure(np.hypot(lag[:, None], lag[None, :]), 1.0)
    modes, own_modes = np.empty((last - 1, 2 * len(used))), np.empty(last - 1)
    for number, row in enumerate(project):
        image = np.zeros(mask.shape)
        image[mask] = row
        modes[number] = _gathered(image, table, site)
        # On the same samples as the covariance with the slopes: differences of the two must not be those of the sampling.
        own_modes[number] = -0.5 * float((image * fftconvolve(image, kernel)[side : 2 * side, side : 2 * side]).sum())
    mean = _gathered(mask / count, table, site)
    structure = fftconvolve(mask / count, kernel)
    own = structure[side : 2 * side, side : 2 * side]
    blocks = _block_samples(mask)
    row, col = blocks.T
    at_blocks = np.stack(
        [one[row[:, None] - site[:, 0] + side, col[:, None] - site[:, 1] + side] for one in table], axis=2
    ).reshape(len(blocks), -1)
    return _Prior(
        used, slopes, table, site, modes, own_modes, blocks,
        at_blocks - mean, own[row, col] - 0.5 * float(own[mask].mean()), mask,
    )  # fmt: skip


def _unit(geometry: Geometry) -> tuple[Float, Float]:
    x, y, _ = pupil_grid(geometry)
    radius = 0.5 * geometry.diameter_m
    return x / radius, y / radius


def _edges(along: Float, across: Float, geometry: Geometry) -> Float:
    """Covariance [rad²/m] of φ at (along, across) [m] from a lenslet's centre with its mean gradient along the first axis."""
    node, weight = np.polynomial.legendre.leggauss(_NODES)
    d = geometry.pitch_m
    total: Float = np.zeros(np.broadcast_shapes(along.shape, across.shape))
    for t, w in zip(0.5 * d * node, 0.5 * weight, strict=True):
        right, left = (kolmogorov_structure(np.hypot(along - edge, across - t), 1.0) for edge in (0.5 * d, -0.5 * d))
        total = total + w * (right - left)
    return -0.5 * total / d


def _gathered(image: Float, table: Float, site: npt.NDArray[np.int64]) -> Float:
    """Σ_x image(x) table(x − x_l) as (2n): (lenslet, axis)."""
    side = len(image)
    made = []
    for one in table:
        whole = fftconvolve(image, one[::-1, ::-1])
        made.append(whole[site[:, 0] + side - 1, site[:, 1] + side - 1])
    return np.stack(made, axis=1).ravel()


def _block_samples(mask: Bool) -> npt.NDArray[np.int64]:
    """Samples inside the pupil, some in each direction."""
    step = max(len(mask) // _BLOCKS, 1)
    chosen = np.zeros(mask.shape, bool)
    chosen[step // 2 :: step, step // 2 :: step] = True
    return np.argwhere(chosen & mask)


def _surface(prior: _Prior, weight: Float) -> Float:
    """Σ_l table(x − x_l)·w_l (side, side), without its mean over the pupil."""
    side = len(prior.mask)
    total = np.zeros(prior.mask.shape)
    for axis, one in enumerate(prior.table):
        image = np.zeros(prior.mask.shape)
        image[prior.site[:, 0], prior.site[:, 1]] = weight[axis::2]
        total += fftconvolve(image, one)[side : 2 * side, side : 2 * side]
    return np.asarray(total - total[prior.mask].mean())


def _fried_m(rig: DeclaredRig, own: Float, variance: Float, valid: Bool) -> float:
    """r0 [m] from the frames' slopes, of lenslets valid in all of them; infinite where none shows.

    Where fewer than half of the lenslets are valid throughout it follows from the mean square of all slopes.
    """
    if shared_lenslets(valid) is not None:
        return strength_of(rig, own, variance, valid)[0].r0_m
    square = float(np.mean(own[valid] ** 2 - variance[valid])) / float(slope_covariance(rig, (0,))[0, 0])
    return square ** (-3.0 / 5.0) if square > 0.0 else np.inf


@estimator(
    "reconstruction",
    cites="E. P. Wallner, JOSA 73:1771, 1983 (maximum a posteriori with the turbulence's covariance)",
    joint=True,
)
def zernike_map(slopes: xr.Dataset, rig: DeclaredRig, *, modes: int = 0, r0_m: float = 0.0) -> xr.Dataset:
    """The most probable phase under Kolmogorov turbulence, and its Zernike coefficients.

    Main arguments: slopes [rad] and their standard errors; the declared rig.
    Other arguments:
        modes: greatest Noll index; 0: that of the rig. r0_m: Fried parameter of the wavefront as it reaches the array; 0:
            estimated from all frames together.

    Returns zernike, sigma [rad rms] (frame, mode) and phase [rad] on the pupil's grid; sigma is that of the posterior, fitting and
    aliasing included. A frame is invalid where fewer than two of its lenslets are valid.
    Raises InputError for a negative r0, a pupil that is no disc, hexagonal lenslets, or fewer slopes than modes.
    """
    if not r0_m >= 0.0:
        raise InputError(
            "A Fried parameter is not negative.", where="r0_m", value=r0_m, allowed="above 0, or 0: estimated"
        )
    geometry, last = declared_geometry(rig), last_mode(rig, modes, disc=True)
    check_square(geometry, "zernike-map", "its covariances are those of squares on one grid of samples")
    own, variance, valid = read_slopes(slopes, geometry)
    frames, side = len(own), geometry.samples
    coefficient, sigma = np.full((frames, last - 1), np.nan), np.full((frames, last - 1), np.nan)
    phase, spread = np.full((frames, side, side), np.nan), np.full((frames, side, side), np.nan)
    held = [frame for frame in range(frames) if int(valid[frame].sum()) >= 2]
    if held:
        r0 = r0_m or _fried_m(rig, own[held], variance[held], valid[held])
        q = min(r0, _WEAKEST * geometry.diameter_m) ** (-5.0 / 3.0)
        for frame in held:
            prior = _prior(rig, last, valid[frame].tobytes())
            noise = variance[frame][prior.used].ravel()
            factor = cho_factor(q * prior.slopes + np.diag(noise))
            weight = cho_solve(factor, own[frame][prior.used].ravel())
            coefficient[frame] = q * prior.modes @ weight
            told = q**2 * np.einsum("jl,lj->j", prior.modes, cho_solve(factor, prior.modes.T))
            sigma[frame] = np.sqrt(np.maximum(q * prior.coefficients - told, _ROUNDING * q * prior.coefficients))
            phase[frame][prior.mask] = q * _surface(prior, weight)[prior.mask]
            seen = q**2 * np.einsum("kl,lk->k", prior.at_blocks, cho_solve(factor, prior.at_blocks.T))
            spread[frame][prior.mask] = _spread_out(
                prior, np.sqrt(np.maximum(q * prior.spread - seen, _ROUNDING * q * prior.spread))
            )
    return stage_result(
        "reconstruction", zernike=coefficient, sigma=sigma, valid=np.isfinite(coefficient), phase=phase, sigma_phase=spread,
        valid_phase=np.isfinite(phase),
    )  # fmt: skip


def _spread_out(prior: _Prior, value: Float) -> Float:
    """Values of the blocks' samples at every sample inside the pupil: those of the nearest one."""
    from scipy.ndimage import distance_transform_edt

    far = np.ones(prior.mask.shape, bool)
    image = np.zeros(prior.mask.shape)
    far[prior.blocks[:, 0], prior.blocks[:, 1]] = False
    image[prior.blocks[:, 0], prior.blocks[:, 1]] = value
    row, col = distance_transform_edt(far, return_distances=False, return_indices=True)
    return np.asarray(image[row, col][prior.mask])
