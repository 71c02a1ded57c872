"""The waveform modality: signal = readout(counts(footprint ⊗ pulse ⊗ detector)).

A sample collects the charge of its interval Δ, which is what a gate of that width does: with q the pulse as detector and
jitter show it, the echo of a ray at τ gives sample k (interval about t_k) the share R(τ − t_k + Δ/2) of its
photoelectrons, R the correlation of q with a rectangle of width Δ. So the tables and returns of gated stacks serve here.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...optics import pile_up
from ...optics.constants import C_M_PER_S
from ...optics.correlation import waveforms
from ...scenes.medium_index import group_index
from ...scenes.rigs.parts import Detector, Intensifier
from ...scenes.rigs.waveform import (
    AnalogReadout,
    SinglePhotonReadout,
    WaveformRig,
    shared_jitter_s,
    shown_pulse,
    waveform_rig,
)
from ...scenes.sampling import response_table
from ...scenes.scene import Scene
from ..detector import detect, fixed_pattern
from ..effect import no_light
from ..model import Expected
from ..random import Stage, blocks, generator, jitter_about_mean
from ..rays.lamp import RoundBeam
from ..rays.returns import gather_returns, render_stack
from ..request import Request
from .footprint import Footprint, Ranger, rays_for, shot_angles
from .scatter import Ramp, ranger_light

__all__ = ["analog_detector", "expect", "expected_ramp", "expected_waveform", "ramp_reach", "read", "waveform_ranger"]

Float = NDArray[np.float64]

#: Rays within this many σ of the detected pulse become one return.
_MERGE_SIGMAS = 0.25
_TABLE_RTOL = 1e-5


def waveform_ranger(scene: Scene) -> Ranger:
    """Beam, lens and shots of a waveform scene. Raises InputError for a scene of another modality."""
    rig = waveform_rig(scene)
    return Ranger(
        rig.laser.wavelength_m, RoundBeam(rig.laser.illumination), rig.receiver, rig.detector.active_diameter_m,
        rig.detector.quantum_efficiency, shot_angles(rig.record.shots, rig.record.scan_half_angle_rad),
    )  # fmt: skip


def expect(scene: Scene, request: Request) -> Expected[Footprint]:
    """Photoelectrons (shot, sample), of single-photon detectors per pulse; coordinates and truth."""
    rig, seed, key = waveform_rig(scene), request.seed, request.capture_key
    beam, ramp = ranger_light(
        scene, waveform_ranger(scene), rays_for(request.error), request.tracer, request.rung, **ramp_reach(scene)
    )
    signal, ambient = expected_waveform(scene, beam, seed, key)
    expected = signal + np.float32(ambient)
    background: Any = np.full(rig.record.shots, ambient * _pulses_in_a_rate(scene))
    if ramp is not None:
        water = expected_ramp(scene, ramp, seed, key)
        expected += water
        background = (water.astype(np.float64) + ambient) * _pulses_in_a_rate(scene)
    truth: dict[str, Any] = {
        "truth_range": beam.axis_range,
        "truth_amplitude": beam.amplitude.sum(axis=1) * rig.laser.pulse_energy_j * rig.pulses_per_shot,
        "truth_background": background,
    }
    if request.truth_electrons:
        truth["truth_electrons"] = expected * np.float32(_pulses_in_a_rate(scene))
    setting = rig.record.start_s + rig.record.step_s * np.arange(rig.record.samples)
    coords = {
        "time": setting,
        "pulses": np.full(rig.record.shots, rig.pulses_per_shot, dtype=np.int32),
        "laser_on": True,
        "valid": True,
    }
    dark = (no_light(scene, "sample", f"the record {setting[0]:.4g} … {setting[-1]:.4g} s"),)
    shown = float(signal.max()) > 0 or (ramp is not None and float(water.max()) > 0)
    return Expected(expected, coords, truth, beam.tau.size, beam, () if shown else dark)


def read(scene: Scene, expected: Expected[Footprint], request: Request) -> NDArray[np.uint16]:
    """The record (shot, sample), drawn by the readout."""
    rig, seed, key = waveform_rig(scene), request.seed, request.capture_key
    readout, electrons = rig.detector.readout, expected.electrons
    if isinstance(readout, SinglePhotonReadout):
        return _count(electrons.astype(np.float64), readout, rig.pulses_per_shot, rig.record.step_s, seed, key)
    detector = analog_detector(readout)
    pattern = fixed_pattern(detector, rig.record.shots, 1)
    counts = detect(np.ascontiguousarray(electrons.T)[:, :, None], detector, pattern, seed, key)
    return np.ascontiguousarray(counts[:, :, 0].T)


def _pulses_in_a_rate(scene: Scene) -> int:
    """Pulses of a shot that `expected_waveform` does not hold: single-photon rates are per pulse."""
    rig = waveform_rig(scene)
    return rig.pulses_per_shot if isinstance(rig.detector.readout, SinglePhotonReadout) else 1


def expected_waveform(scene: Scene, beam: Footprint, seed: int, key: int) -> tuple[NDArray[np.float32], float]:
    """(expected photoelectrons of the echoes (shot, sample), those of ambient and dark in a sample).

    Per shot of an analog detector, per pulse of a single-photon one. Energy fluctuation and timing jitter of the shots
    are drawn here, because they are common to all samples of a shot.
    """
    rig = waveform_rig(scene)
    order = np.argsort(beam.tau, axis=1, kind="stable")
    light, tau = (np.take_along_axis(v, order, 1) for v in (beam.amplitude, beam.tau))
    step, pulses = rig.record.step_s, rig.pulses_per_shot / _pulses_in_a_rate(scene)
    background = (rig.ambient_e_per_s + rig.detector.dark_e_per_s) * step * pulses
    return _sampled(scene, light, tau, np.zeros(tau.shape), seed, key), background


def expected_ramp(scene: Scene, ramp: Ramp, seed: int, key: int) -> NDArray[np.float32]:
    """Expected photoelectrons of the water's backscatter (shot, sample), with the energy and timing of
    `expected_waveform`."""
    shape = ramp.amplitude.shape
    tau, spread = (np.broadcast_to(v, shape) for v in (ramp.tau, ramp.spread))
    return _sampled(scene, ramp.amplitude, tau, spread, seed, key)


def ramp_reach(scene: Scene) -> dict[str, float]:
    """Cells and end of the ramp that the record can show: half a σ of the detected pulse, and its last sample."""
    rig = waveform_rig(scene)
    pulse, _ = shown_pulse(rig)
    speed = C_M_PER_S / (2.0 * group_index(scene.medium, rig.laser.wavelength_m))
    sigma = float(np.sqrt(waveforms.pulse_variance(pulse)))
    end = (
        rig.record.start_s + rig.t0_s + rig.record.step_s * rig.record.samples + 8.0 * (sigma + rig.laser.jitter_shot_s)
    )
    return {"step_m": 0.5 * sigma * speed, "furthest_m": max(end, 0.0) * speed}


def _sampled(scene: Scene, light: Float, tau: Float, spread: Float, seed: int, key: int) -> NDArray[np.float32]:
    """Photoelectrons (shot, sample) of `light` per joule (shot, n) that arrives at `tau` ± `spread`, in ascending order."""
    rig = waveform_rig(scene)
    shots, samples, step = rig.record.shots, rig.record.samples, rig.record.step_s
    pulses = rig.pulses_per_shot / _pulses_in_a_rate(scene)
    energy, jitter = np.ones(shots), np.zeros(shots)
    for block, part in blocks(shots):
        size = part.stop - part.start
        if rig.laser.energy_fluctuation:
            draw = generator(seed, key, Stage.ENERGY, block).standard_normal(size)
            energy[part] = np.maximum(1 + rig.laser.energy_fluctuation * draw, 0.0)
        if rig.laser.jitter_shot_s:
            jitter[part] = rig.laser.jitter_shot_s * generator(seed, key, Stage.JITTER, block).standard_normal(size)
        if shared_jitter_s(rig):
            jitter[part] += shared_jitter_s(rig) * generator(seed, key, Stage.PULSES, block).standard_normal(size)
    pulse, delay = _pulse_of_a_record(rig)
    gate = waveforms.RectangularGate(step, 1.0)
    table = response_table(pulse, gate, _TABLE_RTOL, f"{scene.name}: rig.record.step_s")
    sigma = float(np.sqrt(waveforms.pulse_variance(pulse)))
    amplitude = light * (energy * pulses * rig.laser.pulse_energy_j)[:, None]
    owner = np.repeat(np.arange(shots, dtype=np.int64), tau.shape[1])
    returns, _, _ = gather_returns(
        shots, owner, amplitude.ravel(), tau.ravel(), spread.ravel(), width_s=_MERGE_SIGMAS * sigma
    )
    # The interval opens half a step before the sample's time, and the detector lags the light by `delay`.
    opening: Float = rig.record.start_s + rig.t0_s - delay + step * (np.arange(samples, dtype=np.float64) - 0.5)
    out = np.empty((samples, shots), dtype=np.float32)
    render_stack(returns, table, opening, np.ones(samples), jitter, out)
    return np.maximum(out.T, 0.0)


def _pulse_of_a_record(rig: WaveformRig) -> tuple[waveforms.Pulse, float]:
    """`shown_pulse` with its pulses jittering about the mean of the record's, where that is drawn."""
    if not shared_jitter_s(rig):
        return shown_pulse(rig)
    about = jitter_about_mean(rig.laser.jitter_pulse_s, rig.pulses_per_shot)
    return shown_pulse(rig.model_copy(update={"laser": rig.laser.model_copy(update={"jitter_pulse_s": about})}))


def analog_detector(readout: AnalogReadout) -> Detector:
    """The readout as a one-pixel sensor of the gated detector chain: no fixed pattern, no own dark current."""
    tube = readout.avalanche
    return Detector(
        dark_current_e_per_s=0.0,
        exposure_s=1.0,
        read_noise_e=readout.read_noise_e,
        prnu=0.0,
        dsnu_e=0.0,
        gain_dn_per_e=readout.gain_dn_per_e,
        offset_dn=readout.offset_dn,
        full_well_e=readout.full_well_e,
        adc_bits=readout.adc_bits,
        fixed_pattern_seed=0,
        intensifier=None
        if tube is None
        else Intensifier(gain=tube.gain, excess_noise_factor=tube.excess_noise_factor, phosphor_sigma_px=0.0),
    )


def _count(
    rate: Float, readout: SinglePhotonReadout, pulses: int, step_s: float, seed: int, key: int
) -> NDArray[np.uint16]:
    """Histograms (shot, bin) of counts: n_k ~ Binomial(live_k, 1 − exp(−λ_k)).

    Pulses are exchangeable, so that drawing the number of live ones that count is drawing every pulse.
    """
    shots, bins = rate.shape
    dead = pile_up.dead_bins(readout.dead_time_s, step_s, bins)
    chance = -np.expm1(-rate)
    counts = np.zeros((shots, bins), dtype=np.int64)
    for block, part in blocks(shots):
        draw = generator(seed, key, Stage.PHOTONS, block)
        live = np.full(part.stop - part.start, pulses, dtype=np.int64)
        for k in range(bins):
            if dead > 0 and k > dead:
                live += counts[part, k - dead - 1]  # their dead time is over
            counts[part, k] = draw.binomial(live, chance[part, k])
            if dead > 0:
                live = live - counts[part, k]
    return counts.astype(np.uint16)
