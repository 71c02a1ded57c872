"""The response of a Gaussian pulse and a rectangular gate in closed form, independent of the generator's tables."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.special import erf

from beambench.generator.gated.full import Slices
from beambench.scenes.rigs.gated import gated_rig
from beambench.scenes.scene import Scene

C = 299_792_458.0
Float = NDArray[np.float64]


def slices_of(scene: Scene) -> Slices:
    """One slice per delay of the rig, all of its only gate, with the laser on."""
    spec = gated_rig(scene).delays
    delay = spec.start_s + spec.step_s * np.arange(spec.count)
    return Slices(delay, np.ones(spec.count), np.zeros(spec.count, dtype=np.int32), None)


def electrons_per_radiance(scene: Scene) -> float:
    """Photoelectrons of a pixel per unit of BRDF·cos/r², for an even cone of light."""
    rig = gated_rig(scene)
    camera, laser = rig.camera, rig.laser
    solid = 2 * np.pi * (1 - np.cos(laser.illumination.half_angle_rad))
    joule = laser.pulse_energy_j / solid * camera.pixel_pitch_m**2 * np.pi / (4 * camera.f_number**2)
    per_joule = laser.wavelength_m / (6.62607015e-34 * C)
    return float(rig.pulses_per_slice * joule * camera.transmission * camera.quantum_efficiency * per_joule)


def gate_response(scene: Scene, tau: Float) -> Float:
    """R(τ − delay) by its closed form, (slices, *τ's shape)."""
    laser, gate = gated_rig(scene).laser, gated_rig(scene).gates[0]
    wide = laser.pulse.fwhm_s / np.sqrt(8 * np.log(2)) * np.sqrt(2)  # type: ignore[union-attr]
    u = tau - slices_of(scene).delay_s.reshape(-1, *([1] * tau.ndim))
    return np.asarray(0.5 * (erf((gate.width_s - u) / wide) + erf(u / wide)))  # type: ignore[union-attr]
