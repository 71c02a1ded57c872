"""Fits of a spot to the pixels of its cell: a Gaussian by least squares, and the declared spot by maximum likelihood.

Gauss-Newton with Marquardt's damping on the parameters of a model μ. Weights are 1 (least squares), or 1/V(μ), V = F²(μ + B) + σ²,
anew in each step: quasi-maximum likelihood (R. W. M. Wedderburn, Biometrika 61:439, 1974), as precise as maximum likelihood for
Poisson light and read noise.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np
import numpy.typing as npt
import xarray as xr
from scipy.spatial import cKDTree
from scipy.special import ndtr

from ..registry import estimator
from .cells import Cells, Found, Search, first_guess, measured
from .options import whole

__all__ = ["joint_positions", "spot_gaussian", "spot_joint", "spot_ml"]

Float = npt.NDArray[np.float64]
#: Distance [pitches] up to which a spot's light is taken off other cells.
_REACH = 2.6
#: Parameters (lenslet, p) -> (μ above the background (lenslet, w, w), its gradient (lenslet, p, w, w)).
Model = Callable[[Float], tuple[Float, Float]]


def _fitted(cells: Cells, model: Model, start: Float, steps: int) -> Found:
    """The first two parameters of a fit, x and y, and their variances."""
    p = start.copy()
    lenslets = np.arange(len(p))
    damping = np.full(len(p), 1e-3)
    mu, gradient = model(p)
    moved = np.full(len(p), np.inf)
    weight = cells.inside.astype(np.float64)
    for _ in range(steps):
        rest = cells.z - mu
        normal = np.einsum("lij,laij,lbij->lab", weight, gradient, gradient, optimize=True)
        pull = np.einsum("lij,laij,lij->la", weight, gradient, rest, optimize=True)
        diagonal = normal[:, np.arange(p.shape[1]), np.arange(p.shape[1])]
        damped = normal + (damping[:, None] * diagonal + 1e-300)[:, :, None] * np.eye(p.shape[1])
        step = _solve(damped, pull)
        step[:, :2] = np.clip(step[:, :2], -0.5, 0.5)
        trial_mu, trial_gradient = model(p + step)
        cost, new = ((weight * one**2).sum(axis=(1, 2)) for one in (rest, cells.z - trial_mu))
        better = np.isfinite(new) & (new <= cost * (1.0 + 1e-9))
        moved = np.where(better, np.abs(step[:, :2]).max(axis=1), moved)
        p[better] += step[better]
        mu[better], gradient[better] = trial_mu[better], trial_gradient[better]
        damping = np.clip(np.where(better, 0.2 * damping, 8.0 * damping), 1e-12, 1e12)
        if moved[cells.sound].max(initial=0.0) < 1e-5:
            break
    normal = np.einsum("lij,laij,lbij->lab", weight, gradient, gradient, optimize=True)
    spread = weight**2 * (cells.excess * np.maximum(mu + cells.level[:, None, None], 0.0) + cells.floor_e2)
    meat = np.einsum("lij,laij,lbij->lab", spread, gradient, gradient, optimize=True)
    inverse = _inverse(normal)
    covariance = inverse @ meat @ inverse
    variance = np.stack([covariance[:, 0, 0], covariance[:, 1, 1]], axis=1)
    good = (moved < 1e-3) & (p[lenslets, 2] > 0) & (variance > 0).all(axis=1)
    return Found(p[:, :2], variance, good)


def _solve(matrix: Float, right: Float) -> Float:
    return np.asarray((_inverse(matrix) @ right[:, :, None])[:, :, 0])


def _inverse(matrix: Float) -> Float:
    """Inverses (lenslet, p, p); zeros where there is none."""
    scale = np.sqrt(np.maximum(np.einsum("laa->la", matrix), 1e-300))
    unit = matrix / (scale[:, :, None] * scale[:, None, :])
    sound = np.isfinite(unit).all(axis=(1, 2))
    unit = np.where(sound[:, None, None], unit, np.eye(matrix.shape[1]))
    sound &= np.linalg.det(unit) > 1e-12
    unit = np.where(sound[:, None, None], unit, np.eye(matrix.shape[1]))
    found = np.linalg.inv(unit) / (scale[:, :, None] * scale[:, None, :])
    return np.asarray(np.where(sound[:, None, None], found, 0.0))


def _fit_declared(cells: Cells, others: Float, start: Float, steps: int) -> tuple[Found, Float]:
    """(positions, photoelectrons) of the declared spot in every cell, `others` (lenslet, w, w) the light of other spots there."""
    from .fit_kernel import fit_spots

    spot = cells.spot
    level = cells.level[:, None, None] + others
    position, variance, good, light = fit_spots(
        cells.z - others, cells.x, cells.y, cells.inside, level, start, spot.tables, spot.start_px, spot.per_px, cells.excess,
        cells.floor_e2, steps,
    )  # fmt: skip
    return Found(position, variance, good), light


@estimator(
    "centroid", cites="R. W. M. Wedderburn, Biometrika 61:439, 1974 (quasi-maximum likelihood), per spot", joint=True
)
def spot_ml(
    capture: xr.Dataset, *, neighbours: bool = True, steps: int = 40, least_sigmas: float = 5.0, search: Search = "cell"
) -> xr.Dataset:
    """x, y and A of μ = B + A P(x − cx) P(y − cy) + O by maximum likelihood, P the declared spot, B the background.

    Other arguments:
        neighbours: O is the light of the spots around, where a first fit without O finds them; False: no O. Their pattern is the
            reference's and drops out as far as no spot moves; of spots that move by .08 px rms it costs a seventh of the error
            at 30,000 photoelectrons.

    Returns spot, sigma [px], valid (frame, lenslet, axis), as `spot-centroid`. The spot's shape is the flat wave's: what a lenslet
    sees of a wavefront beside its slope moves the fit (`benchmarks.checks.spot_likelihood`) and is not in sigma.
    """
    method = partial(joint_positions, steps=whole("steps", steps, 1), rounds=1 if neighbours else 0)
    return measured(capture, method, least_sigmas=least_sigmas, search=search)


def _neighbours(cells: Cells) -> npt.NDArray[np.int64]:
    """(lenslet, k): numbers of the lenslets whose light reaches a cell, −1 where there are fewer."""
    place = cells.geometry.place_px
    near: Any = cKDTree(place).query_ball_point(place, _REACH * cells.geometry.pitch_px)
    most = max(len(one) for one in near)
    return np.array(
        [[*(n for n in one if n != own), *([-1] * (most + 1 - len(one)))][:most] for own, one in enumerate(near)]
    )


def _light_of_others(cells: Cells, near: npt.NDArray[np.int64], found: Found, light: Float) -> Float:
    """Photoelectrons (lenslet, w, w) of the spots of other lenslets in every cell."""
    from .fit_kernel import light_of_others

    place, spot = cells.geometry.place_px, cells.spot
    position = np.where(found.good[:, None], found.position, 0.0)
    bright = np.where(found.good, light, 0.0)
    return light_of_others(
        place, near, position, bright, cells.x, cells.y, cells.inside, spot.tables[0], spot.start_px, spot.per_px
    )


def joint_positions(cells: Cells, steps: int = 40, rounds: int = 3) -> Found:
    """Positions [px] from the declared places, by `spot_joint`'s method: also of an image that no reference is taken off.

    `rounds` fits after the first one, each with the light of neighbours as the fit before has it.
    """
    found, light = _fit_declared(cells, np.zeros_like(cells.z), first_guess(cells), steps)
    if cells.alone or rounds == 0:
        return found
    near = _neighbours(cells)
    for _ in range(rounds):
        others = _light_of_others(cells, near, found, light)
        start = np.where(found.good[:, None], np.column_stack([found.position, light]), first_guess(cells))
        found, light = _fit_declared(cells, others, start, steps)
    return found


@estimator(
    "centroid",
    cites="R. W. M. Wedderburn, Biometrika 61:439, 1974 (quasi-maximum likelihood), all spots of a frame",
    joint=True,
)
def spot_joint(
    capture: xr.Dataset, *, rounds: int = 3, steps: int = 40, least_sigmas: float = 5.0, search: Search = "cell"
) -> xr.Dataset:
    """As `spot-ml`, with all spots fitted in turn `rounds` times, the light of the spots around taken off each cell anew.

    Intensities add: what neighbours' fields do to each other is not in the model. Returns spot, sigma [px], valid (frame, lenslet,
    axis), as `spot-centroid`.
    """
    method = partial(joint_positions, steps=whole("steps", steps, 1), rounds=whole("rounds", rounds, 1))
    return measured(capture, method, least_sigmas=least_sigmas, search=search)


def _gaussian(cells: Cells, p: Float) -> tuple[Float, Float]:
    """B + A ΔΦ((x − cx)/s) ΔΦ((y − cy)/s) over (cx, cy, A, B, ln s)."""
    s = np.exp(np.clip(p[:, 4:5], -2.0, 3.0))

    def along(u: Float) -> tuple[Float, Float, Float]:
        high, low = (u + 0.5) / s, (u - 0.5) / s
        up, down = (np.exp(-0.5 * t * t) / np.sqrt(2.0 * np.pi) for t in (high, low))
        return ndtr(high) - ndtr(low), -(up - down) / s, -(high * up - low * down)

    px, dx, wx = along(cells.x - p[:, :1])
    py, dy, wy = along(cells.y - p[:, 1:2])
    light = p[:, 2, None, None]
    shape = py[:, :, None] * px[:, None, :]
    gradient = np.stack(
        [
            light * py[:, :, None] * dx[:, None, :],
            light * dy[:, :, None] * px[:, None, :],
            shape,
            np.ones_like(shape),
            light * (wy[:, :, None] * px[:, None, :] + py[:, :, None] * wx[:, None, :]),
        ],
        axis=1,
    )
    inside = cells.inside
    return (light * shape + p[:, 3, None, None]) * inside, gradient * inside[:, None]


def _gaussian_fit(cells: Cells, steps: int) -> Found:
    start = first_guess(cells)
    more = np.zeros((len(start), 2))
    more[:, 1] = np.log(cells.spot.sigma_px)
    return _fitted(cells, partial(_gaussian, cells), np.concatenate([start, more], axis=1), steps)


@estimator(
    "centroid",
    cites="K. Levenberg, Q. Appl. Math. 2:164, 1944; D. W. Marquardt, J. SIAM 11:431, 1963 (Gaussian over pixels, per spot)",
)
def spot_gaussian(
    capture: xr.Dataset, *, steps: int = 40, least_sigmas: float = 5.0, search: Search = "cell"
) -> xr.Dataset:
    """Least squares of B + A ΔΦ((x − cx)/s) ΔΦ((y − cy)/s), all five free, to the pixels of a cell.

    Returns spot, sigma [px], valid (frame, lenslet, axis), as `spot-centroid`; sigma from the noise of the pixels, not from the
    residuals.
    """
    return measured(
        capture, partial(_gaussian_fit, steps=whole("steps", steps, 1)), least_sigmas=least_sigmas, search=search
    )
