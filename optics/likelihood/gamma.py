"""The intensified detector chain: a compound Poisson-gamma distribution on a lattice, by Fourier transform.

The well's content x = Σ gamma(1/(F²−1), G(F²−1)) over n ~ Poisson(μ) has the transform exp(μ(f̂ − 1)), f̂ that of one
photoelectron's output. Two lattices: a *fine* one for few photoelectrons, where the atom at n = 0 and the gamma's shape
matter (mean-preserving masses, spacing 1/24 of the output's σ: variance accurate to 2e-4), and a *smooth* one above
`_SMOOTH_FROM` photoelectrons, where the density is band-limited and the exact transform is sampled.
"""

from __future__ import annotations

import math

import numpy as np

from ..reflection.angles import Array
from .model import NoiseModel

__all__ = ["intensified_cells"]

_SMOOTH_FROM = 200.0
_REACH = 9.0


def _severity(noise: NoiseModel, step: float) -> Array:
    """Masses at 0, h, 2h … of one photoelectron's output: ∫ density · hat((x − jh)/h) dx, which keeps the mean."""
    from scipy.special import gammainc

    excess = noise.excess_noise_factor - 1.0
    if excess < 1e-6:
        place = noise.intensifier_gain / step
        masses = np.zeros(int(place) + 2)
        masses[int(place)], masses[int(place) + 1] = 1.0 - place % 1.0, place % 1.0
        return masses
    shape, scale = 1.0 / excess, noise.intensifier_gain * excess
    end = noise.intensifier_gain + _REACH * noise.intensifier_gain * math.sqrt(excess) + 40.0 * scale
    x = step * np.arange(int(end / step) + 3)
    # A(x) = ∫₀ˣ cdf; its second differences are the hat's integrals.
    area = x * gammainc(shape, x / scale) - shape * scale * gammainc(shape + 1.0, x / scale)
    inner = np.diff(area, 2) / step
    return np.maximum(np.concatenate(([1.0 - inner.sum()], inner)), 0.0)


def _well_masses(noise: NoiseModel, mu: float, step: float, smooth: bool, dark: float) -> tuple[int, Array, Array]:
    """Index of the first lattice point, masses of x before clipping, and their slopes in μ."""
    from scipy.fft import irfft, next_fast_len, rfft

    gain, excess = noise.intensifier_gain, noise.excess_noise_factor - 1.0
    spread = math.sqrt(gain * gain * (excess + 1.0) * mu + dark)
    mean = gain * mu + dark
    low = max(0.0, mean - _REACH * spread)
    high = mean + _REACH * spread + 40.0 * gain * max(excess, 0.1) + 3.0 * gain + (12.0 if dark > 0 else 0.0)
    start = int(low / step)
    size = next_fast_len(int((high - low) / step) + 8, real=True)
    angle = 2.0 * np.pi * np.arange(size // 2 + 1) / size
    if smooth:
        s = 1j * angle / step
        one = np.power(1.0 + s * gain * excess, -1.0 / excess) if excess > 1e-6 else np.exp(-s * gain)
    else:
        masses = _severity(noise, step)
        # A cyclic transform depends only on the index modulo `size`; the window contains all the mass.
        folded = np.bincount(np.arange(masses.size) % size, weights=masses, minlength=size)
        one = rfft(folded)
    law = np.exp(mu * (one - 1.0))
    if dark > 0.0:
        if smooth:
            unit = np.exp(-1j * angle / step)
        else:
            place = 1.0 / step
            unit = (1.0 - place % 1.0) * np.exp(-1j * angle * int(place)) + (place % 1.0) * np.exp(
                -1j * angle * (int(place) + 1)
            )
        law = law * np.exp(dark * (unit - 1.0))
    p = np.roll(irfft(law, size), -(start % size))
    dp = np.roll(irfft(law * (one - 1.0), size), -(start % size))
    return start, np.maximum(p, 0.0), dp


def _clip(start: int, p: Array, dp: Array, step: float, well: float) -> tuple[Array, Array]:
    """Moves the mass above the full well onto it, split over the two nearest lattice points."""
    place = well / step - start
    last = int(np.clip(np.floor(place), -1, p.size))
    if last >= p.size - 2:
        return p, dp
    last = max(last, 0)
    share = float(np.clip(place - last, 0.0, 1.0))
    out = []
    for v in (p, dp):
        over = float(v[last + 1 :].sum())
        kept = np.append(v[: last + 1], over * share)
        kept[last] += over * (1.0 - share)
        out.append(kept)
    return out[0], out[1]


def intensified_cells(noise: NoiseModel, mu: float) -> tuple[int, Array, Array]:
    """First code, P(code), dP/dμ for an intensified chain at μ > 0 photoelectrons."""
    from scipy.signal import oaconvolve
    from scipy.special import ndtr

    gain, sigma = noise.gain_dn_per_e, noise.read_noise_e
    smooth = mu >= _SMOOTH_FROM
    if smooth:
        cap = math.sqrt(noise.well_variance_e2(mu)) / 60.0
    else:
        cap = noise.intensifier_gain * max(math.sqrt(noise.excess_noise_factor - 1.0) / 24.0, 1.0 / 64.0)
        if noise.dark_e > 0.0 and noise.intensifier_gain < 32.0:
            cap = min(cap, 0.25)
    parts = max(1, math.ceil(1.0 / (gain * cap) - 1e-9))
    step = 1.0 / (gain * parts)
    dark, offset = noise.dark_e, noise.offset_dn
    if not smooth and step > 1.0 and dark > 0.0:
        # A lattice coarser than one electron cannot represent single dark electrons: their variance is added to read noise.
        sigma, offset, dark = math.sqrt(sigma * sigma + dark), offset + gain * dark, 0.0
    start, p, dp = _well_masses(noise, mu, step, smooth, dark)
    p, dp = _clip(start, p, dp, step, noise.full_well_e)
    # Code y collects x = jh where (y ± ½ − offset)/gain encloses x + noise: one kernel in i = y·parts − j.
    reach = 9.0 * sigma / step
    i_low = math.floor((offset - 0.5) * parts - reach) - 1
    i_high = math.ceil((offset + 0.5) * parts + reach) + 1
    i = np.arange(i_low, i_high + 1, dtype=np.float64)
    upper, lower = i + (0.5 - offset) * parts, i - (0.5 + offset) * parts
    if sigma > 0.0:
        cell = ndtr(upper * step / sigma) - ndtr(lower * step / sigma)
    elif smooth:  # a mass stands for the interval around it
        cell = np.clip(upper + 0.5, 0.0, 1.0) - np.clip(lower + 0.5, 0.0, 1.0)
    else:
        cell = ((upper > 0.0) & (lower <= 0.0)).astype(np.float64)
    first_i = start + i_low  # value of y·parts at the convolution's first element
    y_first = -(-first_i // parts)
    skip = y_first * parts - first_i
    if cell.size * p.size < 2_000_000:
        fine, dfine = np.convolve(p, cell), np.convolve(dp, cell)
    else:
        fine, dfine = oaconvolve(p, cell), oaconvolve(dp, cell)
    return _codes(noise.adc_max_dn, y_first, np.maximum(fine[skip::parts], 0.0), dfine[skip::parts])


def _codes(top: int, first: int, p: Array, dp: Array) -> tuple[int, Array, Array]:
    """Adds the mass outside 0 … top to the end codes."""
    y = np.clip(first + np.arange(p.size), 0, top)
    origin = int(y[0])
    mass, slope = (np.asarray(np.bincount(y - origin, weights=v), dtype=np.float64) for v in (p, dp))
    return origin, mass, slope
