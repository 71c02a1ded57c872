"""Propagation of a sampled field: angular spectrum, split step through phase screens, scintillation of a thin layer.

    u(z) = F⁻¹ [F[u(0)] exp(i z (√(k² − κ²) − k))],    evanescent waves removed,

on the periodic grid of the samples, so that energy is kept exactly up to these. k = 2πn/λ: the wavelength is that in the
medium. The carrier e^{ikz} is left out. Split step: propagate, multiply by e^{iφ}, and so on. It is needed where Rytov's
variance exceeds about .05 or √(λL/n) reaches the scale of interest (.63 mm at 1 m, 1.26 mm at 4 m of water).

Sources: J. W. Goodman, Introduction to Fourier Optics, 2005, sec. 3.10; J. D. Schmidt, Numerical Simulation of Optical Wave
Propagation, 2010, ch. 6 to 9; L. C. Andrews and R. L. Phillips, Laser Beam Propagation through Random Media, 2005, ch. 8.
"""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.fft import fft2, fftfreq, ifft2
from scipy.special import gamma

from .strength import FRIED, KOLMOGOROV_INDEX, PATH_FACTOR, positive

__all__ = [
    "angular_spectrum", "fresnel_scale_m", "guard_band", "scintillation_index", "split_step", "thin_layer_scintillation",
    "transfer_function",
]  # fmt: skip

Float = NDArray[np.float64]
Complex = NDArray[np.complex128]


def fresnel_scale_m(distance_m: float, wavelength_m: float, index: float = 1.0) -> float:
    """√(λL/n) [m], λ in vacuum: the scale at which phase becomes scintillation."""
    return float(np.sqrt(wavelength_m * distance_m / index))


def transfer_function(shape: tuple[int, int], spacing_m: float, wavelength_m: float, distance_m: float) -> Complex:
    """exp(i z (√(k² − κ²) − k)) (rows, cols) on FFT frequencies; 0 for evanescent waves. `wavelength_m` in the medium."""
    f2 = fftfreq(shape[0], positive(spacing_m, "spacing_m"))[:, None] ** 2 + fftfreq(shape[1], spacing_m)[None, :] ** 2
    inside = 1.0 - wavelength_m**2 * f2
    # √(1 − a) − 1 = −a/(1 + √(1 − a)) keeps its digits.
    along = -(wavelength_m**2) * f2 / (1.0 + np.sqrt(np.maximum(inside, 0.0)))
    wave = np.exp(2j * np.pi * distance_m / positive(wavelength_m, "wavelength_m") * along)
    return np.where(inside > 0.0, wave, 0.0)


def angular_spectrum(field: ArrayLike, spacing_m: float, wavelength_m: float, distance_m: float) -> Complex:
    """u(x, y, z) (rows, cols) from u(x, y, 0). `wavelength_m` is that in the medium; `distance_m` may be negative."""
    u = np.asarray(field, np.complex128)
    return np.asarray(ifft2(fft2(u) * transfer_function((u.shape[0], u.shape[1]), spacing_m, wavelength_m, distance_m)))


def split_step(
    field: ArrayLike,
    steps: Iterable[tuple[float, ArrayLike | None]],
    spacing_m: float,
    wavelength_m: float,
    *,
    guard: ArrayLike = 1.0,
) -> Complex:
    """The field after steps of (distance [m], phase screen (rows, cols) [rad] or None): each propagates, then adds its phase.

    Main arguments:
        field (rows, cols), spacing_m, wavelength_m (in the medium).

    Other arguments:
        guard (rows, cols): factor 0 … 1 after each step, as `guard_band` makes it, so that light that leaves the grid does not
            come back at its other side; 1 keeps the periodic grid and its energy.
    """
    u = np.asarray(field, np.complex128)
    kept = np.asarray(guard, np.float64)
    last: tuple[float, Complex] | None = None
    for distance, screen in steps:
        if distance != 0.0:
            if last is None or last[0] != distance:
                last = distance, transfer_function((u.shape[0], u.shape[1]), spacing_m, wavelength_m, distance)
            u = np.asarray(ifft2(fft2(u) * last[1]) * kept)
        if screen is not None:
            u = u * np.exp(1j * np.asarray(screen, np.float64))
    return np.asarray(u)


def guard_band(shape: tuple[int, int], share: float = 0.1) -> Float:
    """Factor (rows, cols): 1 in the middle, falling as a squared cosine to 0 over `share` of each side at every edge."""
    if not 0.0 < share <= 0.5:
        raise ValueError(f"share must be above 0 and at most .5, not {share!r}.")

    def line(count: int) -> Float:
        edge = (np.minimum(np.arange(count), np.arange(count)[::-1]) + 0.5) / (share * count)
        return np.asarray(np.sin(0.5 * np.pi * np.minimum(edge, 1.0)) ** 2)

    return np.asarray(line(shape[0])[:, None] * line(shape[1])[None, :])


def scintillation_index(irradiance: ArrayLike) -> float:
    """σ_I² = ⟨I²⟩/⟨I⟩² − 1 over all values."""
    i = np.asarray(irradiance, np.float64)
    return float((i**2).mean() / i.mean() ** 2 - 1.0)


def thin_layer_scintillation(r0_m: float, distance_m: float, wavelength_m: float) -> float:
    """σ_lnI² = 5.32 (L/(k r₀²))^{5/6} of a plane wave at distance L behind a thin Kolmogorov layer, weak turbulence.

    8π² 0.033 k₀² ∫C_n² dz ∫ κ^{−8/3} (1 − cos(κ² L/k)) dκ with r₀ for ∫C_n² dz; `wavelength_m` in the medium.
    """
    k = 2.0 * np.pi / positive(wavelength_m, "wavelength_m")
    # ∫ κ^{−8/3}(1 − cos(κ² b)) dκ = ½ b^{5/6} ∫ u^{−11/6}(1 − cos u) du, and the latter is −Γ(−5/6) cos(5π/12).
    hankel = -0.5 * gamma(-5.0 / 6.0) * np.cos(5.0 * np.pi / 12.0)
    factor = 8.0 * np.pi**2 * KOLMOGOROV_INDEX * FRIED / PATH_FACTOR * hankel
    return float(factor * (distance_m / k) ** (5.0 / 6.0) * positive(r0_m, "r0_m") ** (-5.0 / 3.0))
