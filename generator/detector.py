"""The detector: from expected photoelectrons to counts. Reads as its chain:

counts = adc(gain · (well(spread(intensify(photons(signal·energy + ambient)·prnu)) + dark) + read + dsnu) + offset)
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..scenes.errors import InputError
from ..scenes.rigs.parts import Detector, Intensifier
from .random import Stage, blocks, generator

__all__ = ["FixedPattern", "detect", "fixed_pattern"]

Float32 = NDArray[np.float32]


@dataclass(frozen=True)
class FixedPattern:
    """What belongs to the chip, not to the capture: relative response and dark offset of the pixels (rows, cols)."""

    response: Float32
    offset_e: Float32


def fixed_pattern(detector: Detector, rows: int, cols: int) -> FixedPattern:
    """PRNU (mean 1, rms `prnu`, never below 0) and DSNU (rms `dsnu_e` electrons) of one chip, by its own seed."""
    response = np.ones((rows, cols), dtype=np.float32)
    offset = np.zeros((rows, cols), dtype=np.float32)
    for block, part in blocks(rows):
        size = (part.stop - part.start, cols)
        if detector.prnu:
            draw = generator(detector.fixed_pattern_seed, 0, Stage.PRNU, block).standard_normal(size, dtype=np.float32)
            response[part] = np.maximum(1 + detector.prnu * draw, 0)
        if detector.dsnu_e:
            draw = generator(detector.fixed_pattern_seed, 0, Stage.DSNU, block).standard_normal(size, dtype=np.float32)
            offset[part] = detector.dsnu_e * draw
    return FixedPattern(response, offset)


def detect(
    expected: Float32, detector: Detector, pattern: FixedPattern, seed: int, capture_key: int, *,
    exposure_factor: NDArray[np.float64] | None = None, gain_factor: NDArray[np.float64] | None = None,
) -> NDArray[np.uint16]:  # fmt: skip
    """Draw one capture.

    Main arguments:
        expected: photoelectrons (slices, rows, cols) from signal and ambient light, without PRNU and dark current.
        detector: its parameters; `pattern`: the chip's fixed pattern.
        seed, capture_key: name the random numbers.
    Other arguments:
        exposure_factor, gain_factor: of each slice (slices), where they differ from the detector's; `expected` holds that of
            the exposure already.

    Photons are Poisson. An intensifier turns n photoelectrons into Gamma(n/(F²−1), G(F²−1)): mean Gn, and variance
    G²F²n over n. Its phosphor spreads light over neighbours (correlated noise). Dark electrons are Poisson and join
    after the intensifier. Then full well, Gaussian read noise, gain, offset, rounding, and the ADC's limits.
    """
    slices, rows, cols = expected.shape
    electrons = np.empty_like(expected)
    tube = detector.intensifier
    dark: Any = detector.dark_current_e_per_s * detector.exposure_s
    if exposure_factor is not None:
        dark = np.reshape(dark * exposure_factor, (-1, 1, 1)).astype(np.float32)
    for block, part in blocks(rows):
        # A look-up in the table of R may leave −1e-30 beside its support, and NumPy refuses that.
        mean = np.maximum(expected[:, part], 0) * pattern.response[part]
        if tube is None:
            mean += np.float32(dark)  # the sum of two Poisson draws is one
        n = _poisson(generator(seed, capture_key, Stage.PHOTONS, block), mean)
        if tube is not None:
            n = _intensify(generator(seed, capture_key, Stage.INTENSIFIER, block), n, tube)
        electrons[:, part] = n
    if tube is not None and tube.phosphor_sigma_px > 0:
        electrons = _spread(electrons, tube.phosphor_sigma_px)
    counts = np.empty((slices, rows, cols), dtype=np.uint16)
    top = float(2**detector.adc_bits - 1)
    gain: Any = np.float32(detector.gain_dn_per_e)
    if gain_factor is not None:
        gain = np.reshape(gain * gain_factor, (-1, 1, 1)).astype(np.float32)
    offset = np.float32(detector.offset_dn)
    for block, part in blocks(rows):
        e = electrons[:, part]
        if tube is not None and np.any(dark > 0):
            draw = generator(seed, capture_key, Stage.DARK, block)
            e = e + _poisson(draw, np.broadcast_to(np.float32(dark), e.shape))
        e = np.minimum(e, np.float32(detector.full_well_e))
        if detector.read_noise_e:
            draw = generator(seed, capture_key, Stage.READ, block)
            noise = draw.standard_normal(e.shape, dtype=np.float32)
            noise *= np.float32(detector.read_noise_e)
            e += noise
        e += pattern.offset_e[part]
        e *= gain
        # An ADC's code is that of the cell which the level falls in, halves up, as the likelihood has it.
        e += offset + np.float32(0.5)
        np.floor(e, out=e)
        np.clip(e, 0.0, top, out=e)
        counts[:, part] = e
    return counts


def _poisson(draw: np.random.Generator, mean: Float32) -> Float32:
    """Poisson numbers; beyond 10⁷ the Gaussian limit, whose skewness error is below 3e-4, and which cannot overflow.

    A mean beyond 10³⁰ is taken as that: it fills any well.
    """
    large = mean > 1e7
    try:
        if not large.any():
            return draw.poisson(mean).astype(np.float32)
        small = draw.poisson(np.where(large, 0.0, mean)).astype(np.float32)
    except ValueError as error:  # NumPy looks at every mean; to do so here too would take as long again
        raise InputError(
            "Some pixel's expected photoelectrons are no number: a product of the scene's values overflows.",
            where="rig.laser.pulse_energy_j and what multiplies it",
            value=f"{int(np.count_nonzero(np.isnan(mean)))} of {mean.size} values",
            allowed="finite expected photoelectrons",
            next_step="lower the energy, the pulses per slice, or the camera's aperture and pixel",
        ) from error
    mean = np.minimum(mean, np.float32(1e30))
    gauss = mean + np.sqrt(mean) * draw.standard_normal(mean.shape, dtype=np.float32)
    return np.where(large, gauss, small).astype(np.float32)


def _intensify(draw: np.random.Generator, n: Float32, tube: Intensifier) -> Float32:
    excess = tube.excess_noise_factor - 1.0
    if excess <= 0:
        return n * np.float32(tube.gain)
    shape = n.astype(np.float64) / excess
    amplified = draw.standard_gamma(np.where(shape > 0, shape, 1.0)) * (tube.gain * excess)
    return np.where(shape > 0, amplified, 0.0).astype(np.float32)


def _spread(electrons: Float32, sigma_px: float) -> Float32:
    """The phosphor's point spread: a Gaussian, mirrored at the borders so that no electron is lost."""
    from scipy.ndimage import gaussian_filter

    return np.asarray(gaussian_filter(electrons, sigma=(0, sigma_px, sigma_px), mode="reflect"), dtype=np.float32)
