"""The light of every frame: photoelectrons per lenslet of each reflector in the gate, and the pedestal of scattered light."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...optics.constants import C_M_PER_S, PLANCK_J_S
from ...optics.correlation.response import lookup
from ...optics.water.phase_forms import phase_density
from ...scenes.medium_index import group_index, phase_index
from ...scenes.rigs.wavefront import WavefrontRig, wavefront_rig
from ...scenes.rigs.wavefront_geometry import clear_area_m2, echo_delay_s
from ...scenes.sampling import optics_gate, optics_pulse, response_table
from ...scenes.scene import Scene
from ..random import Stage, generator
from ..water.phase import phase_of

__all__ = ["Reflector", "coordinates", "echoes", "pedestal", "reflectors"]

Float = NDArray[np.float64]

#: Accuracy of the tabulated response of pulse and gate, relative to its peak.
_TABLE_RTOL = 1e-5
#: Nodes of the integral of scattered light over the range.
_NODES = 400


@dataclass(frozen=True)
class Reflector:
    """A reflector: its range [m] and the photoelectrons of a lenslet from one frame whose gate lets all of its light through."""

    range_m: float
    electrons: float


def coordinates(scene: Scene) -> dict[str, Any]:
    """Coordinates of the frames: `delay` [s] without the declared zero, `time` [s], `valid`."""
    series = wavefront_rig(scene).frames
    return {"delay": series.delays_s(), "time": series.interval_s * np.arange(series.count), "valid": True}


def _photoelectrons_per_j(rig: WavefrontRig) -> float:
    """Photoelectrons per joule that reaches a lenslet."""
    photons = rig.wavelength_m / (PLANCK_J_S * C_M_PER_S)
    return rig.lenslets.transmission * rig.camera.quantum_efficiency * photons


def _share_of_lenslet(rig: WavefrontRig) -> float:
    """Area of a lenslet's clear part over that of the beam."""
    return clear_area_m2(rig) / (0.25 * np.pi * rig.bench.beam_diameter_m**2)


def reflectors(scene: Scene) -> list[Reflector]:
    """The reflectors, nearest first.

    Of a mirror of reflectance ρ the beam returns with ρ e^{−2cr}, and 1 − ρ of it goes on to the next one and passes again on
    its way back. A diffuse target returns ρ e^{−2cr} A/(π r²) into an array of the beam's area A, and hides what is behind it.
    """
    rig = wavefront_rig(scene)
    per_frame = rig.laser.pulse_energy_j * rig.frames.pulses * rig.bench.splitter_transmission
    per_frame *= _share_of_lenslet(rig) * _photoelectrons_per_j(rig)
    found, passed = [], 1.0
    for item in sorted(scene.target, key=lambda item: item.shape.center_m[2]):
        at = float(item.shape.center_m[2])
        share = float(item.material.albedo_at_normal()) * float(np.exp(-2.0 * scene.medium.attenuation_per_m * at))
        if rig.reflection == "diffuse":
            area = 0.25 * np.pi * (rig.bench.beam_diameter_m / rig.bench.magnification) ** 2
            return [Reflector(at, per_frame * share * area / (np.pi * at**2))]
        found.append(Reflector(at, per_frame * share * passed))
        passed *= (1.0 - float(item.material.albedo_at_normal())) ** 2
    return found


def echoes(scene: Scene, delay: Float, seed: int, key: int) -> Float:
    """Photoelectrons of a lenslet (frame, reflector): those of `reflectors`, times R(echo − delay), energy and jitter."""
    rig = wavefront_rig(scene)
    index = group_index(scene.medium, rig.wavelength_m)
    actual, energy = np.array(delay + rig.t0_s), np.ones(delay.shape)
    if rig.laser.energy_fluctuation:
        draw = generator(seed, key, Stage.ENERGY).standard_normal(delay.size)
        energy = np.maximum(1.0 + rig.laser.energy_fluctuation * draw, 0.0)
    if rig.laser.jitter_frame_s:
        actual = actual + rig.laser.jitter_frame_s * generator(seed, key, Stage.JITTER).standard_normal(delay.size)
    table = _response(scene)
    columns = [
        one.electrons * lookup(table, echo_delay_s(rig, one.range_m, index) - actual) for one in reflectors(scene)
    ]
    return np.asarray(np.stack(columns, axis=1) * energy[:, None])


def _response(scene: Scene) -> Any:
    rig = wavefront_rig(scene)
    return response_table(optics_pulse(rig.laser.pulse), optics_gate(rig.gate), _TABLE_RTOL, f"{scene.name}: rig.gate")


def pedestal(scene: Scene, delay: Float) -> Float:
    """Photoelectrons per pixel (frame) that the water scatters back into the open gate, once, and ambient light.

    A pixel of pitch p behind a lenslet of area a collects over a p²/f² sr the radiance ∫ E b β(π) e^{−2cz} R(2 n_g z/c − t) dz,
    E the beam's fluence: the line of sight is taken to stay within the beam, which holds for z below its diameter over the angle
    of the pixel, and is the upper limit beyond. In air the radiance of the water is 1/n² as high. Each pixel collects through the
    one lenslet before it.
    """
    rig = wavefront_rig(scene)
    ambient = np.full(delay.shape, rig.ambient_e_per_s * _open_s(rig) * rig.frames.pulses)
    phase = phase_of(scene)
    if phase is None:
        return ambient
    index = group_index(scene.medium, rig.wavelength_m)
    table = _response(scene)
    end = min((float(item.shape.center_m[2]) for item in scene.target), default=np.inf)
    latest = float(delay.max()) + rig.t0_s + table.start_s + table.step_s * table.value.size
    far = min(end, max(latest - echo_delay_s(rig, 0.0, index), 0.0) * C_M_PER_S / (2.0 * index))
    z = (np.arange(_NODES) + 0.5) / _NODES * max(far, 1e-6)
    weight = scene.medium.scattering_per_m * float(phase_density(phase, np.pi)) * max(far, 1e-6) / _NODES
    weight = weight * np.exp(-2.0 * scene.medium.attenuation_per_m * z)
    echo = np.array([echo_delay_s(rig, float(at), index) for at in z])
    seen = lookup(table, echo[None, :] - (delay[:, None] + rig.t0_s)) @ weight
    solid = (rig.camera.pixel_pitch_m / rig.lenslets.focal_length_m) ** 2 * rig.bench.magnification**2
    solid /= phase_index(scene.medium, rig.wavelength_m) ** 2  # array and camera are in air, where a beam is n² as wide
    energy = rig.laser.pulse_energy_j * rig.frames.pulses * rig.bench.splitter_transmission * _share_of_lenslet(rig)
    return np.asarray(ambient + energy * solid * _photoelectrons_per_j(rig) * seen)


def _open_s(rig: WavefrontRig) -> float:
    """Area of the gate, s."""
    from ...optics.correlation import waveforms

    return float(waveforms.gate_area(optics_gate(rig.gate)))
