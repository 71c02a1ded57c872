"""Blur by a wave and its removal: Guo et al. 2017, Eq. 31 and 32; point spread from a phase, total-variation deblurring.

    v = H(u) + p                                         (Eq. 31)
    u' = argmin ½‖H(u) − p‖₂² + Δ‖u‖                     (Eq. 32, as printed)
    u' = argmin ½‖H(u) − v‖₂² + Δ Σ|∇u|                  (as meant: the image v for the noise p, and total variation)

As printed the image v does not occur: with unknown noise p of zero mean taken as 0 the minimum is u = 0, whatever was seen.
Both are here; `deblur` minimises the second by the primal-dual method of Chambolle and Pock until its gap falls below a share
of the objective. For any dual field |q| ≤ Δ, w = ∇ᵀq and r = Hu − v, every image u' has

    ½‖Hu' − v‖² + Δ Σ|∇u'| ≥ ½‖r‖² + ⟨w, u⟩ + ⟨Hᵀr + w, u' − u⟩,

so that the objective exceeds its minimum over all images within a distance ρ of u by no more than the gap, which takes ρ‖Hᵀr
+ w‖ for the last term, ρ = 2‖v − mean v‖. (H cannot be inverted where it is zero; the gap without ρ would be infinite.)

Sources: J. W. Goodman, Introduction to Fourier Optics, 2005, sec. 6.4; L. I. Rudin, S. Osher and E. Fatemi, Physica D 60:259, 1992;
A. Chambolle and T. Pock, J. Math. Imaging Vis. 40:120, 2011.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.fft import fft2, fftshift, irfft2, rfft2

__all__ = [
    "Deblurred", "blurred_eq31", "deblur", "objective_eq32_as_meant", "objective_eq32_as_printed", "point_spread",
    "total_variation", "transfer_of",
]  # fmt: skip

Float = NDArray[np.float64]
Complex = NDArray[np.complex128]


#: Step of the image in units of its range over the weight: measured on edges and gradients.
_STEP = 0.01


@dataclass(frozen=True, eq=False)
class Deblurred:
    """Main arguments:
    image (rows, cols): u'. objective: its value. gap: as the module's head defines it. iterations: done.
    converged: whether gap ≤ tolerance · objective.
    """

    image: Float
    objective: float
    gap: float
    iterations: int
    converged: bool


def point_spread(phase_rad: ArrayLike, pupil: ArrayLike, *, padding: int = 2) -> Float:
    """|F[P e^{iφ}]|² (padding·rows, padding·cols), sum 1, its origin in the middle (index n//2).

    Main arguments:
        phase_rad, pupil (rows, cols): φ [rad] and amplitude P. NaN phases are allowed where P = 0.

    Other arguments:
        padding: with 2 the spread is sampled at Nyquist's rate: pixels of λ/(2·size of the array) rad.

    Raises ValueError for different shapes or a pupil without light.
    """
    p = np.asarray(pupil, np.float64)
    phase = np.where(p > 0, np.asarray(phase_rad, np.float64), 0.0)
    if phase.shape != p.shape or p.ndim != 2 or not (p > 0).any():
        raise ValueError("phase_rad and pupil need one shape (rows, cols), and the pupil some light.")
    field = np.zeros((padding * p.shape[0], padding * p.shape[1]), np.complex128)
    field[: p.shape[0], : p.shape[1]] = p * np.exp(1j * phase)
    spread = np.abs(fft2(field)) ** 2
    return np.asarray(fftshift(spread / spread.sum()))


def transfer_of(spread: ArrayLike, shape: tuple[int, int]) -> Complex:
    """The half spectrum (rows, cols//2 + 1) by which a point spread (its origin at index n//2) acts on images of `shape`, periodic.

    A larger spread is cut about its origin and scaled to unit sum; a smaller one is padded.
    """
    s = np.asarray(spread, np.float64)
    kernel = np.zeros(shape)
    index = []
    for n, m in zip(s.shape, shape, strict=True):
        offset = np.arange(n) - n // 2
        index.append((np.flatnonzero((offset >= -(m // 2)) & (offset < m - m // 2)), offset))
    (rows, dy), (cols, dx) = index
    kernel[np.ix_(dy[rows] % shape[0], dx[cols] % shape[1])] = s[np.ix_(rows, cols)]
    return np.asarray(rfft2(kernel / kernel.sum()))


def blurred_eq31(image: ArrayLike, transfer: Complex, noise: ArrayLike = 0.0) -> Float:
    """v = H(u) + p (rows, cols): H a periodic convolution by its half spectrum `transfer`."""
    u = np.asarray(image, np.float64)
    return np.asarray(irfft2(transfer * rfft2(u), s=u.shape) + np.asarray(noise, np.float64))


def total_variation(image: ArrayLike) -> float:
    """Σ|∇u|: forward differences, none across the last row and column."""
    g = _gradient(np.asarray(image, np.float64))
    return float(np.sqrt((g**2).sum(axis=0)).sum())


def objective_eq32_as_printed(image: ArrayLike, transfer: Complex, noise: ArrayLike, weight: float) -> float:
    """½‖H(u) − p‖₂² + Δ‖u‖₂ with the noise p where the image v is meant."""
    rest = blurred_eq31(image, transfer) - np.asarray(noise, np.float64)
    return float(0.5 * (rest**2).sum() + weight * np.sqrt((np.asarray(image, np.float64) ** 2).sum()))


def objective_eq32_as_meant(image: ArrayLike, transfer: Complex, seen: ArrayLike, weight: float) -> float:
    """½‖H(u) − v‖₂² + Δ Σ|∇u|."""
    rest = blurred_eq31(image, transfer) - np.asarray(seen, np.float64)
    return float(0.5 * (rest**2).sum() + weight * total_variation(image))


def deblur(
    seen: ArrayLike, transfer: Complex, weight: float, *, tolerance: float = 1e-4, iterations: int = 2000
) -> Deblurred:
    """argmin ½‖H(u) − v‖₂² + Δ Σ|∇u|.

    Main arguments:
        seen (rows, cols): v. transfer: of H, from `transfer_of`. weight: Δ > 0, about the noise's standard deviation times the mean
            gradient that noise may have; the caller's to choose.

    Other arguments:
        tolerance: of the duality gap over the objective. iterations: at most; `converged` says whether they sufficed.

    Raises ValueError for a weight that is not positive or values that are not finite.
    """
    v = np.asarray(seen, np.float64)
    if not (weight > 0 and np.isfinite(weight)) or not np.isfinite(v).all():
        raise ValueError(f"weight must be positive and finite, and seen finite; weight is {weight!r}.")
    return _primal_dual(v, transfer, float(weight), tolerance, iterations)


def _primal_dual(v: Float, transfer: Complex, weight: float, tolerance: float, iterations: int) -> Deblurred:
    """Chambolle and Pock with the exact proximal step of the fidelity by FFT; steps in the scales of image and dual field."""
    shape = (v.shape[0], v.shape[1])
    power, back = np.abs(transfer) ** 2, np.conj(transfer) * rfft2(v)
    tau = _STEP * max(float(np.ptp(v)), weight) / weight
    sigma = 1.0 / (8.0 * tau)  # ‖∇‖² ≤ 8
    u, q = v.copy(), np.zeros((2, *shape))
    ahead = u
    gap, objective, done = np.inf, np.inf, 0
    for done in range(1, iterations + 1):
        q = q + sigma * _gradient(ahead)
        q = q / np.maximum(1.0, np.sqrt((q**2).sum(axis=0)) / weight)
        old = u
        point = old - tau * _gradient_transposed(q)
        u = irfft2((rfft2(point) + tau * back) / (1.0 + tau * power), s=shape)
        ahead = 2.0 * u - old
        if done % 10 == 0 or done == iterations:
            objective = objective_eq32_as_meant(u, transfer, v, weight)
            gap = objective - _lower_bound(q, u, transfer, v, weight)
            if gap <= tolerance * objective:
                break
    return Deblurred(np.asarray(u), float(objective), float(gap), done, bool(gap <= tolerance * objective))


def _lower_bound(q: Float, u: Float, transfer: Complex, v: Float, weight: float) -> float:
    """The least that the objective can be within ρ of u, by the inequality of the module's head."""
    w = _gradient_transposed(q)
    rest = blurred_eq31(u, transfer) - v
    slope = irfft2(np.conj(transfer) * rfft2(rest), s=v.shape) + w
    radius = 2.0 * float(np.sqrt(((v - v.mean()) ** 2).sum()))
    return float(0.5 * (rest**2).sum() + (w * u).sum() - radius * np.sqrt((slope**2).sum()))


def _gradient(u: Float) -> Float:
    g = np.zeros((2, *u.shape))
    g[0, :, :-1] = np.diff(u, axis=1)
    g[1, :-1, :] = np.diff(u, axis=0)
    return g


def _gradient_transposed(q: Float) -> Float:
    out = np.zeros(q.shape[1:])
    out[:, :-1] -= q[0, :, :-1]
    out[:, 1:] += q[0, :, :-1]
    out[:-1, :] -= q[1, :-1, :]
    out[1:, :] += q[1, :-1, :]
    return out
