"""Captures of amplitude-modulated rangers from closed forms.

The sample at frequency f and phase φ has the mean A (1 + C cos(2πf(τ − t₀) − φ)) + b photoelectrons, C half of the product
of modulation depth and demodulation contrast, τ = 2 n_g r/c.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import xarray as xr

from ...captures.build import make_capture
from ...optics.amcw import correlation_sample
from ...optics.constants import C_M_PER_S
from ...scenes.declared import declared_rig
from ...scenes.medium_index import group_index
from ...scenes.rigs.amcw import amcw_rig
from ...scenes.scene import Scene
from ..bounds.amcw import amcw_noise
from .draw import drawn_counts, generator, truth_attributes

__all__ = ["written_capture"]


def written_capture(
    scene: Scene, amplitude: Any, background: float, range_m: Any, *, seed: int | None = None, **attrs: Any
) -> xr.Dataset:
    """An AMCW capture with its truth, for the rig of `scene` and any range and amplitude of each shot.

    Main arguments:
        amplitude (shot) or a number: mean photoelectrons of a sample, those of the background apart. background:
        photoelectrons of a sample, dark electrons included. range_m (shot), m, or a number.
    Other arguments:
        seed: of the samples; None leaves them zero, which is enough for bounds. attrs: more attributes.

    Raises InputError for a scene of another modality.
    """
    rig = amcw_rig(scene)
    ranges, light = (np.broadcast_to(np.asarray(v, np.float64), (rig.shots,)).copy() for v in (range_m, amplitude))
    tau = 2.0 * group_index(scene.medium, rig.laser.wavelength_m) / C_M_PER_S * ranges
    frequency = np.asarray(rig.modulation.frequencies_hz, np.float64)
    phase = 2.0 * np.pi * np.arange(rig.modulation.phase_steps) / rig.modulation.phase_steps
    contrast = 0.5 * rig.laser.modulation_depth * rig.detector.demodulation_contrast
    delay = (tau - rig.t0_s)[:, None, None]
    mean = correlation_sample(light[:, None, None], contrast, delay, frequency[:, None], phase) + background
    samples = np.zeros(mean.shape, np.uint16) if seed is None else drawn_counts(mean, amcw_noise(rig), generator(seed))
    return make_capture(
        "amcw",
        data={"samples": samples},
        coords={"frequency": frequency, "phase": phase, "laser_on": True, "valid": True},
        truth={
            "truth_range": ranges, "truth_amplitude": light, "truth_background": np.full(rig.shots, float(background)),
        },
        attrs=truth_attributes(scene, declared_rig(scene)) | attrs,
    )  # fmt: skip
