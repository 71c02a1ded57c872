"""The amplitude-modulated modality: samples = readout(½ (Σ_j a_j (1 + ½ m d cos(2πf(τ_j − t₀) − φ)) + ambient) + dark)."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from ...captures.build import make_capture
from ...optics.constants import C_M_PER_S
from ...scenes.declared import declared_rig
from ...scenes.medium_index import group_index
from ...scenes.rigs.amcw import AmcwDetector, amcw_rig
from ...scenes.rigs.parts import Detector
from ...scenes.scene import Scene
from ..detector import detect, fixed_pattern
from ..random import Stage, blocks, generator
from ..rays.trace import Tracer
from .capture import ranger_attributes, warn_about
from .effects import amcw_effects
from .footprint import Footprint, rays_for
from .scatter import Ramp, ranger_light

if TYPE_CHECKING:
    import xarray as xr

__all__ = ["amcw_detector", "expected_ramp", "expected_samples", "generate_amcw", "phase_steps", "ramp_reach"]

Float = NDArray[np.float64]


def generate_amcw(
    scene: Scene,
    *,
    seed: int,
    key: int,
    rtol: float,
    truth_electrons: bool,
    tracer: Tracer | None,
    rung: str = "direct",
) -> xr.Dataset:
    """One AMCW capture with its truth. Arguments as for `generate`; called by it."""
    rig = amcw_rig(scene)
    rays = rays_for(rtol)
    beam, ramp = ranger_light(scene, rays, tracer, rung, **ramp_reach(scene))
    signal, background = expected_samples(scene, beam, seed, key)
    veil = np.zeros(1) if ramp is None else expected_ramp(scene, ramp, seed, key)
    expected = (signal + background + veil).astype(np.float32)
    shots, frequencies, phases = expected.shape
    detector = amcw_detector(rig.detector)
    flat = np.ascontiguousarray(expected.reshape(shots, -1).T)[:, :, None]
    counts = detect(flat, detector, fixed_pattern(detector, shots, 1), seed, key)[:, :, 0].T
    declared = declared_rig(scene)
    truth: dict[str, Any] = {
        "truth_range": beam.axis_range,
        "truth_amplitude": 0.5 * beam.amplitude.sum(axis=1) * rig.laser.power_w * rig.modulation.integration_s,
        "truth_background": np.full(shots, background) if ramp is None else veil + background,
    }
    if truth_electrons:
        truth["truth_electrons"] = expected
    effects = amcw_effects(scene, beam, truth["truth_range"], rung)
    warn_about(scene, float(signal.max()), "the field of view", effects, rung)
    return make_capture(
        "amcw",
        data={"samples": np.ascontiguousarray(counts).reshape(shots, frequencies, phases)},
        coords={
            "frequency": np.asarray(rig.modulation.frequencies_hz),
            "phase": phase_steps(rig.modulation.phase_steps),
            "laser_on": True,
            "valid": True,
        },
        truth=truth,
        attrs=ranger_attributes(scene, declared, seed, key, rtol, beam.tau.size, effects, truth_electrons, rung),
    )


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
