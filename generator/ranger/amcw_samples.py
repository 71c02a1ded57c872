"""The amplitude-modulated modality: samples = readout(½ (Σ_j a_j (1 + ½ m d cos(2πf(τ_j − t₀) − φ)) + ambient) + dark)."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...optics.constants import C_M_PER_S
from ...scenes.medium_index import group_index
from ...scenes.rigs.amcw import AmcwDetector, amcw_rig
from ...scenes.rigs.parts import Detector
from ...scenes.scene import Scene
from ..detector import detect, fixed_pattern
from ..effect import no_light
from ..model import Expected
from ..random import Stage, blocks, generator
from ..rays.lamp import RoundBeam
from ..request import Request
from .footprint import Footprint, Ranger, rays_for, shot_angles
from .scatter import Ramp, ranger_light

__all__ = [
    "amcw_detector",
    "amcw_ranger",
    "expect",
    "expected_ramp",
    "expected_samples",
    "phase_steps",
    "ramp_reach",
    "read",
]

Float = NDArray[np.float64]


def amcw_ranger(scene: Scene) -> Ranger:
    """Beam, lens and shots of an AMCW scene. Raises InputError for a scene of another modality."""
    rig = amcw_rig(scene)
    return Ranger(
        rig.laser.wavelength_m, RoundBeam(rig.laser.illumination), rig.receiver, rig.detector.active_diameter_m,
        rig.detector.quantum_efficiency, shot_angles(rig.shots, rig.scan_half_angle_rad),
    )  # fmt: skip


def expect(scene: Scene, request: Request) -> Expected[Footprint]:
    """Photoelectrons (shot, frequency, phase), coordinates and truth."""
    rig, seed, key = amcw_rig(scene), request.seed, request.capture_key
    beam, ramp = ranger_light(
        scene, amcw_ranger(scene), rays_for(request.error), request.tracer, request.rung, **ramp_reach(scene)
    )
    signal, background = expected_samples(scene, beam, seed, key)
    water = np.zeros(1) if ramp is None else expected_ramp(scene, ramp, seed, key)
    expected = (signal + background + water).astype(np.float32)
    truth: dict[str, Any] = {
        "truth_range": beam.axis_range,
        "truth_amplitude": 0.5 * beam.amplitude.sum(axis=1) * rig.laser.power_w * rig.modulation.integration_s,
        "truth_background": np.full(rig.shots, background) if ramp is None else water + background,
    }
    if request.truth_electrons:
        truth["truth_electrons"] = expected
    coords = {
        "frequency": np.asarray(rig.modulation.frequencies_hz),
        "phase": phase_steps(rig.modulation.phase_steps),
        "laser_on": True,
        "valid": True,
    }
    dark = (no_light(scene, "sample", "the field of view"),)
    shown = max(float(signal.max()), float(water.max())) > 0
    return Expected(expected, coords, truth, beam.tau.size, beam, () if shown else dark)


def read(scene: Scene, expected: Expected[Footprint], request: Request) -> NDArray[np.uint16]:
    """The samples (shot, frequency, phase), drawn by the detector."""
    electrons, detector = expected.electrons, amcw_detector(amcw_rig(scene).detector)
    shots = len(electrons)
    flat = np.ascontiguousarray(electrons.reshape(shots, -1).T)[:, :, None]
    counts = detect(flat, detector, fixed_pattern(detector, shots, 1), request.seed, request.capture_key)
    return np.ascontiguousarray(counts[:, :, 0].T).reshape(electrons.shape)


def phase_steps(count: int) -> Float:
    """Reference phases 2πk/count, rad."""
    return 2.0 * np.pi * np.arange(count) / count


def ramp_reach(scene: Scene) -> dict[str, float]:
    """Cells of the ramp, a quarter radian of the fastest modulation long, and no end: a mixer sees all ranges."""
    rig = amcw_rig(scene)
    speed = C_M_PER_S / (2.0 * group_index(scene.medium, rig.laser.wavelength_m))
    return {"step_m": 0.25 * speed / (2.0 * np.pi * max(rig.modulation.frequencies_hz)), "furthest_m": float("inf")}


def expected_samples(scene: Scene, beam: Footprint, seed: int, key: int) -> tuple[Float, float]:
    """(expected photoelectrons of the echoes (shot, frequency, phase), those of ambient light and dark in a sample).

    Rays of different τ add as phasors, Z = Σ a_j exp(iωτ_j): a deep footprint loses contrast. The mean power of a shot
    fluctuates as a whole.
    """
    rig = amcw_rig(scene)
    background = (0.5 * rig.ambient_e_per_s + rig.detector.dark_e_per_s) * rig.modulation.integration_s
    return _mixed(scene, beam.amplitude, beam.tau, np.zeros(1), seed, key), background


def expected_ramp(scene: Scene, ramp: Ramp, seed: int, key: int) -> Float:
    """Expected photoelectrons of the water's backscatter (shot, frequency, phase): the Fourier component of its ramp."""
    return _mixed(scene, ramp.amplitude, ramp.tau, ramp.spread, seed, key)


def _mixed(scene: Scene, light: Float, tau: Float, spread: Float, seed: int, key: int) -> Float:
    """Samples (shot, frequency, phase) of `light` per watt and second (shot, n) that arrives at `tau` ± `spread`.

    Light spread by s about its mean time keeps the share e^{−(ωs)²/2} of its modulation.
    """
    rig = amcw_rig(scene)
    power = np.ones(rig.shots)
    for block, part in blocks(rig.shots):
        if rig.laser.power_fluctuation:
            draw = generator(seed, key, Stage.ENERGY, block).standard_normal(part.stop - part.start)
            power[part] = np.maximum(1 + rig.laser.power_fluctuation * draw, 0.0)
    modulation = rig.modulation
    amplitude = light * (power * rig.laser.power_w * modulation.integration_s)[:, None]
    depth = 0.5 * rig.laser.modulation_depth * rig.detector.demodulation_contrast
    phase = phase_steps(modulation.phase_steps)
    total = amplitude.sum(axis=1)
    out = np.empty((rig.shots, len(modulation.frequencies_hz), modulation.phase_steps))
    for number, frequency in enumerate(modulation.frequencies_hz):
        omega = 2.0 * np.pi * frequency
        kept = np.exp(-0.5 * (omega * spread) ** 2)
        phasor = (amplitude * kept * np.exp(1j * omega * (tau - rig.t0_s))).sum(axis=1)
        wave = (phasor[:, None] * np.exp(-1j * phase)[None, :]).real
        out[:, number] = 0.5 * (total[:, None] + depth * wave)
    return out


def amcw_detector(spec: AmcwDetector) -> Detector:
    """The demodulating detector as a one-pixel sensor of the gated detector chain."""
    return Detector(
        dark_current_e_per_s=0.0,
        exposure_s=1.0,
        read_noise_e=spec.read_noise_e,
        prnu=0.0,
        dsnu_e=0.0,
        gain_dn_per_e=spec.gain_dn_per_e,
        offset_dn=spec.offset_dn,
        full_well_e=spec.full_well_e,
        adc_bits=spec.adc_bits,
        fixed_pattern_seed=0,
    )
