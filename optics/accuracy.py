"""Signal-to-noise ratio and range accuracy of a gated stack: Eq. 14-17 and 25 of Guo et al. 2017 as printed, each named
by its number, and the corrected forms.

σ is the standard deviation of the correlation R(u) of pulse and gate, in s; intensities are photoelectrons. Where the
delay step is small against R, with photon noise only and no background, a weighted average attains c σ/(2 n √N),
N = Σ I_i.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from .constants import C_M_PER_S
from .correlation.parts import Array

__all__ = [
    "depth_accuracy", "depth_error_percent_eq25", "range_accuracy_eq17", "snr_eq14", "snr_eq15", "snr_eq16",
    "snr_gaussian_stack", "weighted_average_std",
]  # fmt: skip

#: Area of a Gaussian over σ times its peak.
_ROOT_2PI = float(np.sqrt(2.0 * np.pi))


def _array(value: ArrayLike) -> Array:
    return np.asarray(value, dtype=np.float64)


def snr_eq14(intensity: ArrayLike, noise: ArrayLike) -> Array:
    """Eq. 14: SNR = Σ I_i / √Σ(δI_i)², over the last axis (slices)."""
    return np.asarray(np.sum(_array(intensity), axis=-1) / np.sqrt(np.sum(_array(noise) ** 2, axis=-1)))


def snr_eq15(intensity: ArrayLike) -> Array:
    """Eq. 15: SNR = √Σ I_i, over the last axis: Eq. 14 with δI_i² = I_i, so I_i must be counts of photoelectrons.

    The document prints (δI_i)² ≈ Iⁱ, with the index raised; it is read as I_i, as the document's next line uses it.
    """
    return np.asarray(np.sqrt(np.sum(_array(intensity), axis=-1)))


def snr_eq16(sigma_s: ArrayLike, step_s: ArrayLike, maximum: ArrayLike) -> Array:
    """Eq. 16 *as printed*: SNR = √(σ/t_step · max(I_i)): σ/t_step slices, each as bright as the brightest.

    A Gaussian response has Σ I_i = √(2π)·σ/t_step·max(I_i): `snr_gaussian_stack`.
    """
    return np.asarray(np.sqrt(_array(sigma_s) / _array(step_s) * _array(maximum)))


def snr_gaussian_stack(sigma_s: ArrayLike, step_s: ArrayLike, maximum: ArrayLike) -> Array:
    """√(√(2π)·σ/t_step·max(I_i)): Eq. 16 with the factor that it omits, (2π)^¼ = 1.583 in the ratio.

    Accurate to 5e-9 for σ ≥ t_step (Poisson summation), and to 1.5 % at σ = t_step/2.
    """
    return np.asarray(np.sqrt(_ROOT_2PI) * snr_eq16(sigma_s, step_s, maximum))


def range_accuracy_eq17(sigma_s: ArrayLike, snr: ArrayLike, speed_m_per_s: float = C_M_PER_S) -> Array:
    """Eq. 17: δr = ½ c σ/SNR, m.

    `speed_m_per_s` is c over the group index; the document uses c. This is the standard deviation of one range; for the
    difference of two ranges, such as the depth of an object, see `depth_accuracy`.
    """
    return np.asarray(0.5 * speed_m_per_s * _array(sigma_s) / _array(snr))


def depth_accuracy(near_m: ArrayLike, far_m: ArrayLike) -> Array:
    """√(δr₁² + δr₂²), m: standard deviation of the difference of two independent ranges, √2·δr where they are equal."""
    return np.asarray(np.hypot(near_m, far_m))


def depth_error_percent_eq25(error_m: ArrayLike, depth_m: ArrayLike) -> Array:
    """Eq. 25: 100·δr/depth, %."""
    return np.asarray(100.0 * _array(error_m) / _array(depth_m))


def weighted_average_std(intensity: ArrayLike, noise: ArrayLike, time_s: ArrayLike) -> Array:
    """Standard deviation of t̂ = Σ I_i t_i/Σ I_i, s, for independent noise δI_i: √Σ δI_i²(t_i − t̂)²/Σ I_i.

    Main arguments: expected intensity and noise (…, slice), times (slice). First order in the noise. With photon noise
    it is σ/√N, as in Eq. 17; read noise and background increase it, weighted by each slice's squared distance from t̂.
    """
    value, time = _array(intensity), _array(time_s)
    total = np.sum(value, axis=-1)
    mean = np.sum(value * time, axis=-1) / total
    spread = _array(noise) ** 2 * (time - mean[..., None]) ** 2
    return np.asarray(np.sqrt(np.sum(spread, axis=-1)) / np.abs(total))
