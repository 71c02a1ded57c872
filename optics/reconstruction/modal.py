"""Modal reconstruction: least squares, maximum a posteriori, and the errors of either, apart.

Slopes are s = G a + G_h b + n with a the modes that are estimated, b all higher ones, n noise of covariance N. A
reconstructor R gives â = R s, with

    least squares       R = (Gᵀ N⁻¹ G)⁻¹ Gᵀ N⁻¹,
    maximum a posteriori R = (Gᵀ N⁻¹ G + C⁻¹)⁻¹ Gᵀ N⁻¹,    C = ⟨a aᵀ⟩ (for Kolmogorov: Noll's covariance),

and the mean square error of the wave [rad²] is fitting ⟨b²⟩ + aliasing tr(R G_h C_bb G_hᵀ Rᵀ) + noise tr(R N Rᵀ) + bias
tr((RG − 1) C_aa (RG − 1)ᵀ) + 2 tr((RG − 1) C_ab G_hᵀ Rᵀ). The last two vanish for least squares.

Sources: E. P. Wallner, JOSA 73:1771, 1983; J. Herrmann, JOSA 71:989, 1981 (aliasing); R. J. Noll, JOSA 66:207, 1976 (C).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.linalg import cho_factor, cho_solve

__all__ = ["ErrorBudget", "error_budget", "least_squares", "maximum_a_posteriori", "stacked"]

Float = NDArray[np.float64]


@dataclass(frozen=True)
class ErrorBudget:
    """Mean square error of a reconstructed wave [rad²] by cause; `cross` is between bias and aliasing and may be negative."""

    fitting: float
    aliasing: float
    noise: float
    bias: float
    cross: float

    @property
    def total(self) -> float:
        """The sum [rad²]."""
        return self.fitting + self.aliasing + self.noise + self.bias + self.cross


def stacked(gradients: ArrayLike) -> Float:
    """G (2·lenslets, modes) of mean gradients (lenslets, 2, modes): slopes ordered (lenslet, axis)."""
    g = np.asarray(gradients, np.float64)
    return np.asarray(g.reshape(-1, g.shape[-1]))


def least_squares(gradients: ArrayLike, variance: ArrayLike = 1.0) -> Float:
    """R (modes, 2·lenslets) of G (2·lenslets, modes) and slope variances (2·lenslets) or one for all.

    Raises ValueError where G does not determine all modes (fewer slopes than modes, or modes that look alike): the singular values
    span more than 10¹⁰.
    """
    g, scale = _whitened(gradients, variance)
    if g.shape[0] < g.shape[1]:
        raise ValueError(f"{g.shape[1]} modes need as many slopes; there are {g.shape[0]}.")
    u, value, vt = np.linalg.svd(g, full_matrices=False)
    if not value[-1] > 1e-10 * value[0]:
        raise ValueError(
            f"The slopes do not determine all {g.shape[1]} modes: fewer modes or more lenslets are needed."
        )
    return np.asarray((vt.T / value) @ u.T * scale)


def maximum_a_posteriori(gradients: ArrayLike, variance: ArrayLike, prior: ArrayLike) -> Float:
    """R (modes, 2·lenslets) of G, slope variances, and the prior covariance C (modes, modes) in the square of the modes' unit.

    Raises ValueError where C is not positive definite or a variance not positive.
    """
    g, scale = _whitened(gradients, variance)
    c = np.asarray(prior, np.float64)
    if c.shape != (g.shape[1],) * 2:
        raise ValueError(f"prior needs the shape {(g.shape[1],) * 2}, not {c.shape}.")
    try:
        inverse = cho_solve(cho_factor(c), np.eye(len(c)))
    except np.linalg.LinAlgError as error:
        raise ValueError("prior must be positive definite.") from error
    return np.asarray(cho_solve(cho_factor(g.T @ g + inverse), g.T) * scale)


def error_budget(
    reconstructor: ArrayLike,
    gradients: ArrayLike,
    higher: ArrayLike,
    covariance: ArrayLike,
    variance: ArrayLike,
    fitting: float,
) -> ErrorBudget:
    """The errors of a reconstructor, apart.

    Main arguments:
        reconstructor (modes, 2·lenslets): R. gradients (2·lenslets, modes): G. higher (2·lenslets, higher modes): G_h of as
        many higher
            modes as matter. covariance: of estimated and higher modes together, in this order. variance: of the slopes.
        fitting: mean square of all that is not estimated, such as `noll_residual`; the higher modes given are only a part of it.
    """
    r, g, h = (np.asarray(value, np.float64) for value in (reconstructor, gradients, higher))
    c = np.asarray(covariance, np.float64)
    modes = g.shape[1]
    off, alias = r @ g - np.eye(modes), r @ h
    noise = np.broadcast_to(np.asarray(variance, np.float64), (g.shape[0],))
    return ErrorBudget(
        fitting=float(fitting),
        aliasing=float(np.einsum("ij,jk,ik->", alias, c[modes:, modes:], alias, optimize=True)),
        noise=float((r**2 * noise).sum()),
        bias=float(np.einsum("ij,jk,ik->", off, c[:modes, :modes], off, optimize=True)),
        cross=float(2.0 * np.einsum("ij,jk,ik->", off, c[:modes, modes:], alias, optimize=True)),
    )


def _whitened(gradients: ArrayLike, variance: ArrayLike) -> tuple[Float, Float]:
    """G over the slopes' standard deviations, and 1/σ."""
    g = np.asarray(gradients, np.float64)
    if g.ndim != 2:
        raise ValueError(f"gradients need the shape (2·lenslets, modes), not {g.shape}.")
    v = np.broadcast_to(np.asarray(variance, np.float64), (g.shape[0],))
    if not ((v > 0) & np.isfinite(v)).all():
        raise ValueError("The variances of the slopes must be positive and finite.")
    scale = 1.0 / np.sqrt(v)
    return g * scale[:, None], scale
