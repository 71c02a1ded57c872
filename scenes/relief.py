"""Heights of a surface that is drawn from a power law: a sum of plane waves of random phase, by Fourier transform."""

from __future__ import annotations

import numpy as np
import scipy.fft
from numpy.typing import NDArray

from ..optics.roughness import surface_density_factor

__all__ = ["relief_heights"]

#: The period of the waves, in outer scales: the spectrum is sampled twice within the first of its octaves.
_PERIODS = 2.0


def relief_heights(
    width_m: float,
    height_m: float,
    pitch_m: float,
    *,
    slope: float,
    rms_m: float,
    outer_m: float,
    inner_m: float,
    seed: int,
) -> NDArray[np.float64]:
    """Heights (rows along y, columns along x) [m] at a spacing of `pitch_m`, of mean 0 over the whole period, of a patch of
    `width_m` by `height_m`; the other arguments are those of the shape "power-law".

    h = Re Σ_k √Ψ(k) dk z_k e^(2πi k·x), real and imaginary parts of z standard normal, k on a lattice of spacing dk = 1/period;
    Ψ = B k^−(γ+1) between 1/outer and 1/inner, 0 elsewhere. Only the patch is kept, so that its ends do not meet. `seed` alone
    decides the phases.
    """
    cols, rows = (round(side / pitch_m) + 1 for side in (width_m, height_m))
    least = int(np.ceil(_PERIODS * outer_m / pitch_m))
    nx, ny = (scipy.fft.next_fast_len(max(count, least)) for count in (cols, rows))
    rng = np.random.Generator(np.random.PCG64(np.random.SeedSequence(seed)))
    kx = np.fft.fftfreq(nx, pitch_m)
    ky = np.fft.fftfreq(ny, pitch_m)
    k = np.hypot(kx[None, :], ky[:, None])
    factor = surface_density_factor(slope, rms_m, outer_m, inner_m)
    inside = (k >= 1.0 / outer_m) & (k <= 1.0 / inner_m)
    cell = 1.0 / (nx * ny * pitch_m**2)
    wave = np.zeros((ny, nx), np.complex128)
    count = int(inside.sum())
    # The real part of one wave has the variance Ψ dk², whatever its phase.
    drawn = rng.standard_normal((2, count))
    wave[inside] = np.sqrt(factor * k[inside] ** (-slope - 1.0) * cell) * (drawn[0] + 1j * drawn[1])
    heights = scipy.fft.ifft2(wave, norm="forward").real
    return np.ascontiguousarray(heights[:rows, :cols])
