"""Speckle of a diffuse target: the field of a rough disc of even light, in the pupil.

A point of the disc at an angle α sends a plane wave of frequency α/λ; all have independent circular Gaussian amplitudes, so that
the field g is circular Gaussian of unit mean power, with van Cittert's and Zernike's covariance

    ⟨g(x) g*(x')⟩ = 2 J₁(v)/v,    v = π D |x − x'|/(λ r),

D the diameter of the disc, r its range, λ the wavelength in the water. A draw adds `_WAVES` waves from random points of the disc:
that covariance holds on the average over draws, and products of two covariances err by 1/_WAVES. The field multiplies that of a
point source, as if all points of the disc saw the same turbulence. M patterns of independent draws add as irradiances.

Source: J. W. Goodman, Speckle Phenomena in Optics, 2007, sec. 3.3 (sums of patterns), 4.4 (van Cittert and Zernike).
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from ...scenes.errors import InputError
from ...scenes.rigs.wavefront_spec import WavefrontRig
from ..random import Stage, generator

__all__ = ["Speckle", "disc_field"]

Float = NDArray[np.float64]
Complex = NDArray[np.complex128]

_WAVES = 256
#: Fewest samples over the width λr/D of a speckle.
_LEAST_SAMPLES = 2.0


class Speckle:
    """The patterns of all frames; without the effect, one factor of 1. `step_m`: distance of samples in the water, `wavelength_m`
    there."""

    def __init__(self, rig: WavefrontRig, side: int, step_m: float, wavelength_m: float, seed: int, key: int) -> None:
        self.looks = 0 if rig.effects is None else rig.effects.speckle_looks or 0
        self._width_m = rig.bench.beam_diameter_m / rig.bench.magnification
        self._side, self._step_m, self._wavelength_m = side, step_m, wavelength_m
        self._seed, self._key = seed, key

    def parts(self, frame: int, range_m: float) -> Iterator[tuple[float, Complex | float]]:
        """(share of the light, factor (side, side) of the field) of each pattern of a frame.

        Raises InputError for speckle finer than the samples of the pupil.
        """
        if not self.looks:
            yield 1.0, 1.0
            return
        cycles = 0.5 * self._width_m / (self._wavelength_m * range_m) * self._step_m
        if 2.0 * cycles * _LEAST_SAMPLES > 1.0:
            raise InputError(
                "The samples of the pupil are too far apart for the speckle of the target.", where="rig.pupil.samples",
                value=f"{0.5 / cycles:.3g} samples over a speckle", allowed=f"{_LEAST_SAMPLES:g} or more",
                next_step="raise rig.pupil.samples, narrow rig.bench.beam_diameter_m, or move the target away",
            )  # fmt: skip
        rng = generator(self._seed, self._key, Stage.SPECKLE, frame)
        for _ in range(self.looks):
            yield 1.0 / self.looks, disc_field(self._side, cycles, rng)


def disc_field(side: int, cycles: float, rng: np.random.Generator) -> Complex:
    """A draw (side, side) of g; `cycles` per sample at the edge of the disc, D/2λr times the distance of samples."""
    radius, turn = cycles * np.sqrt(rng.random(_WAVES)), 2.0 * np.pi * rng.random(_WAVES)
    amplitude = rng.standard_normal((2, _WAVES)) * np.sqrt(0.5 / _WAVES)
    at = np.arange(side) - 0.5 * (side - 1)
    x = np.exp(2j * np.pi * (radius * np.cos(turn))[:, None] * at)
    y = np.exp(2j * np.pi * at[:, None] * (radius * np.sin(turn)))
    return np.asarray((y * (amplitude[0] + 1j * amplitude[1])) @ x)
