"""Cramér-Rao bound on time of flight and range of a gated stack, with amplitude and background as nuisance parameters.

    μ_k = a·R(τ − t_k) + b·q_k,    F_ij = Σ_k J(μ_k) ∂_iμ_k ∂_jμ_k,    var τ >= 1/(F_ττ − F_τn F_nn⁻¹ F_nτ)

over the nuisance parameters n that are not known.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from ..constants import C_M_PER_S
from ..reflection.angles import Array
from .fisher_moments import moment_information, quadratic_information
from .fisher_table import InformationTable, information_table

__all__ = [
    "InformationTable",
    "information_table",
    "moment_information",
    "quadratic_information",
    "range_bound",
    "range_sigma",
    "stack_information",
    "tau_bound",
]


def stack_information(
    mu: ArrayLike,
    dmu_dtau: ArrayLike,
    dmu_damplitude: ArrayLike,
    dmu_dbackground: ArrayLike,
    table: InformationTable,
) -> Array:
    """The Fisher matrix (pixel, 3, 3) of (τ, amplitude, background), summed over slices.

    Arrays broadcast to (slice, pixel); μ and its derivatives are in photoelectrons per unit of each parameter. Beyond the
    inputs it needs memory for six sums per pixel. Raises ValueError for arrays of another rank.
    """
    from .fisher_kernels import accumulate

    given = (mu, dmu_dtau, dmu_damplitude, dmu_dbackground)
    arrays = np.broadcast_arrays(*(np.asarray(v, dtype=np.float64) for v in given))
    if arrays[0].ndim != 2:
        raise ValueError(f"arrays must broadcast to (slice, pixel), not {arrays[0].shape}")
    sums = np.zeros((6, arrays[0].shape[1]))
    accumulate(*arrays, table.log_mu, table.log_j, table.slope, sums)
    return np.moveaxis(sums[[[0, 1, 2], [1, 3, 4], [2, 4, 5]]], -1, 0)


def tau_bound(
    mu: ArrayLike,
    dmu_dtau: ArrayLike,
    dmu_damplitude: ArrayLike,
    dmu_dbackground: ArrayLike,
    table: InformationTable,
    *,
    amplitude_known: bool = False,
    background_known: bool = False,
) -> Array:
    """Least standard deviation of τ [s] of an unbiased estimate, per pixel; inf where the stack contains no information.

    Main arguments: as `stack_information`.
    Other arguments: nuisance parameters that the estimator is given. One that the stack does not depend on is ignored.
    Source: C. R. Rao 1945, H. Cramér 1946; nuisance parameters by the Schur complement of the Fisher matrix.
    """
    f = stack_information(mu, dmu_dtau, dmu_damplitude, dmu_dbackground, table)
    tt, ta, tb, aa, ab, bb = f[:, 0, 0], f[:, 0, 1], f[:, 0, 2], f[:, 1, 1], f[:, 1, 2], f[:, 2, 2]
    keep_a = np.zeros_like(tt) if amplitude_known else np.where(aa > 0.0, 1.0, 0.0)
    keep_b = np.zeros_like(tt) if background_known else np.where(bb > 0.0, 1.0, 0.0)
    # Eliminate the amplitude first, then the remaining part of the background.
    over_a = keep_a / np.where(aa > 0.0, aa, 1.0)
    left = tt - ta * ta * over_a
    cross = tb - ta * ab * over_a
    rest = bb - ab * ab * over_a
    usable = rest > 1e-12 * bb  # else the background is collinear with the amplitude, and was eliminated with it
    left = left - keep_b * np.where(usable, cross * cross / np.where(usable, rest, 1.0), 0.0)
    live = left > 1e-12 * tt
    return np.where(live, 1.0 / np.sqrt(np.where(live, left, 1.0)), np.inf)


def range_sigma(tau_sigma_s: ArrayLike, group_index: float) -> Array:
    """σ_r = cσ_τ/(2n_g) [m] of a coaxial rig from σ_τ [s], any shape."""
    return np.asarray(C_M_PER_S / (2.0 * group_index) * np.asarray(tau_sigma_s, dtype=np.float64))


def range_bound(
    mu: ArrayLike,
    dmu_dtau: ArrayLike,
    dmu_damplitude: ArrayLike,
    dmu_dbackground: ArrayLike,
    table: InformationTable,
    *,
    group_index: float,
    amplitude_known: bool = False,
    background_known: bool = False,
) -> Array:
    """`tau_bound` as a range of a coaxial rig [m], per pixel."""
    sigma = tau_bound(
        mu, dmu_dtau, dmu_damplitude, dmu_dbackground, table,
        amplitude_known=amplitude_known, background_known=background_known,
    )  # fmt: skip
    return range_sigma(sigma, group_index)
