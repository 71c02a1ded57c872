"""What written captures of every modality share: how counts are drawn, and the attributes of a capture with truth."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

from ...optics.likelihood.model import NoiseModel
from ...scenes.scene import Scene

__all__ = ["drawn_counts", "generator", "truth_attributes"]

Float = npt.NDArray[np.float64]


def generator(seed: int) -> np.random.Generator:
    """The random generator of a written capture."""
    return np.random.Generator(np.random.PCG64(seed))


def drawn_counts(mean: Float, noise: NoiseModel, rng: np.random.Generator) -> npt.NDArray[np.uint16]:
    """Counts [DN] of mean photoelectrons, any shape: Poisson, gamma of the tube, full well, read noise, rounding, ADC."""
    electrons = rng.poisson(mean).astype(np.float64)
    if noise.intensified:
        excess = noise.excess_noise_factor - 1.0
        if excess > 0:
            shape = electrons / excess
            electrons = rng.gamma(np.where(shape > 0, shape, 1.0)) * excess * (shape > 0)
        electrons *= noise.intensifier_gain
    if noise.dark_e > 0:
        electrons += rng.poisson(noise.dark_e, mean.shape)
    electrons = np.minimum(electrons, noise.full_well_e)
    if noise.read_noise_e > 0:
        electrons += noise.read_noise_e * rng.standard_normal(mean.shape)
    dn = np.floor(electrons * noise.gain_dn_per_e + noise.offset_dn + 0.5)
    return np.clip(dn, 0, noise.adc_max_dn).astype(np.uint16)


def truth_attributes(scene: Scene, declared: dict[str, Any]) -> dict[str, Any]:
    """Attributes of a capture whose truth is known: the declared rig, and the scene that it was made from."""
    return {"rig": declared, "truth_scene": scene.model_dump(mode="json"), "truth_kind": "rendered"}
