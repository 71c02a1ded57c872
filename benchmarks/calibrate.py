"""The condition "calibrated": the estimators' pulse and gate samples come from a simulated, noisy calibration.

A laboratory does not know its waveforms: it records them. Here each is recorded once, from the true scene's shapes,
with counting noise:

- the pulse by a photodetector faster than the pulse: bin i holds Poisson(N ∫_bin p dt + d) counts;
- each gate by a scan of a probe pulse far shorter than the gate's edges: step k holds Poisson(n g(τ_k) + d) counts;

with N and n photoelectrons from the suite and a dark level d of 1e-3 of the brightest sample, both on the declared
sampling step. What is recovered from these records replaces the samples in the declared rig; all else in it stays.
"""

from __future__ import annotations

import json

import numpy as np
import numpy.typing as npt

from ..estimators.calibration.response import gate_from_scan, pulse_from_trace
from ..optics import waveforms
from ..scenes.declare import optics_gate, optics_pulse
from ..scenes.declare_waveform import shown_pulse
from ..scenes.scene import Scene, gated_rig, waveform_rig
from .suite_spec import Calibration

__all__ = ["calibrated_rig", "record_gate", "record_pulse"]

Float = npt.NDArray[np.float64]

#: Dark counts per sample, as a fraction of the brightest sample's.
_DARK = 1e-3
#: Empty room on both sides of a record, in lengths of the shape: a laboratory does not know where it ends.
_MARGIN = 0.5


def _grid(low: float, high: float, step: float) -> Float:
    length = high - low
    first = np.floor((low - _MARGIN * length) / step)
    last = np.ceil((high + _MARGIN * length) / step)
    return np.asarray(np.arange(first, last + 1) * step, np.float64)


def record_pulse(
    pulse: waveforms.Pulse, step_s: float, photoelectrons: float, rng: np.random.Generator
) -> tuple[Float, Float]:
    """(time, counts) of a pulse in bins of `step_s` centred at `time`; the clock's zero is the pulse's centroid.

    A bin's expectation is Simpson's rule over its two edges and centre.
    """
    time = _grid(*_core(waveforms.pulse_support(pulse), waveforms.pulse_variance(pulse)), step_s)
    edge = [waveforms.pulse_density(pulse, time + shift * step_s) for shift in (-0.5, 0.0, 0.5)]
    mean = photoelectrons * step_s * (edge[0] + 4 * edge[1] + edge[2]) / 6
    mean = mean + _DARK * mean.max()
    return time, rng.poisson(mean).astype(np.float64)


def _core(support: tuple[float, float], variance: float) -> tuple[float, float]:
    """The support, cut at 6 standard deviations where it is longer: tails far below one count are not recorded."""
    reach = 6.0 * float(np.sqrt(variance))
    return max(support[0], -reach), min(support[1], reach)


def record_gate(
    gate: waveforms.Gate, step_s: float, photoelectrons: float, rng: np.random.Generator
) -> tuple[Float, Float]:
    """(delay, counts) of a gate scanned in steps of `step_s`; `photoelectrons` per step at transmission 1."""
    delay = _grid(*waveforms.gate_support(gate), step_s)
    mean = photoelectrons * np.asarray(waveforms.gate_transmission(gate, delay), np.float64)
    return delay, rng.poisson(mean + _DARK * mean.max()).astype(np.float64)


def calibrated_rig(scene: Scene, declared: str, calibration: Calibration) -> str:
    """The declared rig (JSON) with pulse and gate samples recovered from simulated records of the true ones.

    Main arguments:
        scene: its rig is what is recorded. declared: the capture's attribute `rig`. calibration: photons and seed.

    A waveform rig's response is the pulse as its own detector shows it: that is recorded, and keeps its declared mean
    time. An AMCW rig declares no waveform, so that nothing of it changes.
    """
    if scene.modality == "waveform":
        return _calibrated_waveform(scene, declared, calibration)
    if scene.modality == "amcw":
        return declared
    rig = json.loads(declared)
    step = float(rig["pulse"]["step_s"])
    streams = np.random.SeedSequence(calibration.seed).spawn(1 + len(gated_rig(scene).gates))
    rngs = [np.random.Generator(np.random.PCG64(stream)) for stream in streams]
    time, counts = record_pulse(
        optics_pulse(gated_rig(scene).laser.pulse), step, calibration.pulse_photoelectrons, rngs[0]
    )
    rig["pulse"] = pulse_from_trace(float(time[0]), step, counts)
    gates = []
    for gate, rng, old in zip(gated_rig(scene).gates, rngs[1:], rig["gates"], strict=True):
        delay, counts = record_gate(optics_gate(gate), step, calibration.gate_photoelectrons, rng)
        # The scan tells the shape; the height belongs to the photon transfer, which the declared rig already holds.
        gates.append(gate_from_scan(float(delay[0]), step, counts, transmission=max(old["value"])))
    rig["gates"] = gates
    return json.dumps(rig, allow_nan=False)


def _calibrated_waveform(scene: Scene, declared: str, calibration: Calibration) -> str:
    rig = json.loads(declared)
    old = rig["response"]
    step, weight = float(old["step_s"]), np.asarray(old["value"], np.float64)
    mean_time = float(old["start_s"]) + step * float((np.arange(weight.size) * weight).sum() / weight.sum())
    rng = np.random.Generator(np.random.PCG64(np.random.SeedSequence(calibration.seed)))
    pulse, _ = shown_pulse(waveform_rig(scene))
    time, counts = record_pulse(pulse, step, calibration.pulse_photoelectrons, rng)
    found = pulse_from_trace(float(time[0]), step, counts)
    rig["response"] = found | {"start_s": found["start_s"] + mean_time}
    return json.dumps(rig, allow_nan=False)
