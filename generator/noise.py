"""The variance of a sample of a camera: what a tolerance of "noise" and weights of errors are taken from."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..scenes.rigs.camera_noise import camera_noise
from ..scenes.rigs.parts import Detector

__all__ = ["noise_variance"]

Float = NDArray[np.float64]


def noise_variance(
    detector: Detector, electrons: NDArray[np.floating[Any]] | float, *, exposure: float = 1.0, gain: float = 1.0
) -> Float:
    """Variance [photoelectrons²] of samples of these expectations, dark ones not included: F² μ + (dark + σ_read² + 1/(12 K²))/G².

    Other arguments:
        exposure, gain: of the frame over the detector's own; `electrons` are those of the frame. Dark electrons grow with the one,
            rounding falls with the other.
    """
    dark = detector.dark_current_e_per_s * detector.exposure_s * exposure
    noise = replace(camera_noise(detector), gain_dn_per_e=detector.gain_dn_per_e * gain, dark_e=dark)
    return np.asarray(noise.excess_noise_factor * np.maximum(electrons, 0.0) + noise.sample_variance(0.0))
