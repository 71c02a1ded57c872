"""The noise of a camera's detector as the record that likelihoods, bounds and tolerances read."""

from __future__ import annotations

from ...optics.likelihood.model import NoiseModel
from .parts import Detector

__all__ = ["camera_noise"]


def camera_noise(detector: Detector) -> NoiseModel:
    """The likelihood of one sample of a camera. Dark electrons are part of its mean, except behind an intensifier."""
    tube = detector.intensifier
    return NoiseModel(
        read_noise_e=detector.read_noise_e,
        gain_dn_per_e=detector.gain_dn_per_e,
        offset_dn=detector.offset_dn,
        adc_max_dn=2**detector.adc_bits - 1,
        full_well_e=detector.full_well_e,
        excess_noise_factor=1.0 if tube is None else tube.excess_noise_factor,
        intensifier_gain=1.0 if tube is None else tube.gain,
        dark_e=0.0 if tube is None else detector.dark_current_e_per_s * detector.exposure_s,
    )
