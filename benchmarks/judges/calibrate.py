"""The condition "calibrated": the estimators' pulse and gate samples come from a simulated, noisy calibration.

A laboratory does not know its waveforms: it records them. Here each is recorded once, from the true scene's shapes,
with counting noise:

- the pulse by a photodetector faster than the pulse: bin i holds Poisson(N ∫_bin p dt + d) counts;
- each gate by a scan of a probe pulse one step long, whose delay moves evenly on while it counts: step k holds
  Poisson(n ∫ g(τ) hat((τ − τ_k)/h) dτ/h + d) counts, h the step;

with N and n photoelectrons from the suite and a dark level d of 1e-3 of the brightest sample, both on the declared
sampling step. What is recovered from these records replaces the samples in the declared rig; all else in it stays.

A calibration moves all ranges of a capture together, so that one drawn once would pass for a property of the estimators.
Each scene and seed of a suite therefore draws its own, shared by the levels of a stress, which it must not blur.

What is left of the error, as the shift of R that a range sees (waveforms about 1 ns long, steps to 20 ps):

- without noise, below .06 mm: an edge that is not odd about its half height, and straight lines between samples;
- from counting, mean 0 to first order in the records. The gate's half height, averaged over w to either side of an edge
  of slope s, has the standard deviation √(.625 h/(n w))/s, h the step: .4 mm for a rise of .3 ns at n = 1e3. The
  pulse's place has at most σ_p/√N: .2 mm at N = 1e5.
- Second order is left where a tail sinks into the dark counts: below .1 mm at these counts, and falling with them.
"""

from __future__ import annotations

import json
from enum import IntEnum

import numpy as np
import numpy.typing as npt

from ...estimators.calibration.response import gate_from_scan, pulse_from_trace
from ...optics.correlation import waveforms
from ...scenes.rigs.gated import gated_rig
from ...scenes.rigs.waveform import shown_pulse, waveform_rig
from ...scenes.sampling import optics_gate, optics_pulse
from ...scenes.scene import Scene
from ..suites.spec import Calibration
from ..suites.suite import CELL_NONE, Cell, capture_key

__all__ = ["Calibrations", "Record", "calibrated_rig", "record_gate", "record_pulse"]

Float = npt.NDArray[np.float64]


class Record(IntEnum):
    """What is recorded: the stage in its random stream's name. Never renumber; apart from the generator's stages."""

    PULSE = 101
    GATE = 102


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
    """(time, counts) of a pulse in bins of `step_s` centred at `time`; the clock's zero is the pulse's centroid."""
    time = _grid(*_core(waveforms.pulse_support(pulse), waveforms.pulse_variance(pulse)), step_s)
    edge = np.append(time - 0.5 * step_s, time[-1] + 0.5 * step_s)
    mean = photoelectrons * np.maximum(-np.diff(waveforms.pulse_part(pulse).upper(edge)), 0.0)
    mean = mean + _DARK * mean.max()
    return time, rng.poisson(mean).astype(np.float64)


def _core(support: tuple[float, float], variance: float) -> tuple[float, float]:
    """The support, cut at 6 standard deviations where it is longer: tails far below one count are not recorded."""
    reach = 6.0 * float(np.sqrt(variance))
    return max(support[0], -reach), min(support[1], reach)


def record_gate(
    gate: waveforms.Gate, step_s: float, photoelectrons: float, rng: np.random.Generator
) -> tuple[Float, Float]:
    """(delay, counts) of a gate scanned in steps of `step_s`; `photoelectrons` per step at transmission 1.

    Each step sees the gate through the hat that spans the steps beside it, so that the record read with straight lines
    keeps the gate's area and centroid, and a jump its place: sampled at points, a jump between two of them, or on one, is
    read up to half a step away.
    """
    delay = _grid(*waveforms.gate_support(gate), step_s)
    edge = np.concatenate([[delay[0] - step_s], delay, [delay[-1] + step_s]])
    seen = sum(np.diff(part.upper2(edge), n=2) for part in waveforms.gate_parts(gate)) / step_s**2
    mean = photoelectrons * np.clip(seen, 0.0, 1.0)
    return delay, rng.poisson(mean + _DARK * mean.max()).astype(np.float64)


def _generator(calibration: Calibration, seed: int, key: int, record: Record, block: int = 0) -> np.random.Generator:
    """The random generator of one record: named by what is drawn, as all randomness, and by the calibration's seed."""
    sequence = np.random.SeedSequence((calibration.seed, seed), spawn_key=(key, int(record), block))
    return np.random.Generator(np.random.PCG64(sequence))


class Calibrations:
    """The calibrations of one suite: one for each scene and seed, whatever the level of a stress."""

    def __init__(self, calibration: Calibration) -> None:
        self._calibration = calibration
        self._known: dict[tuple[str, int, str, str], str] = {}

    def declared(self, cell: Cell, rig: str) -> str:
        """The declared rig `rig` of a cell's capture as its calibration leaves it; computed once for equal instruments."""
        place = (cell.scene_name, cell.seed, rig, cell.scene.model_dump_json(include={"rig"}))
        if place not in self._known:
            key = capture_key(cell.scene_name, CELL_NONE, float("nan"))  # of the scene as written, for all its levels
            self._known[place] = calibrated_rig(cell.scene, rig, self._calibration, seed=cell.seed, key=key)
        return self._known[place]


def calibrated_rig(scene: Scene, declared: str, calibration: Calibration, *, seed: int = 0, key: int = 0) -> str:
    """The declared rig (JSON) with pulse and gate samples recovered from simulated records of the true ones.

    Main arguments:
        scene: its rig is what is recorded. declared: the capture's attribute `rig`. calibration: photons and seed.
    Other arguments:
        seed, key: name the draw, as a capture's do: SeedSequence((calibration.seed, seed), spawn_key=(key, record, gate)).

    A waveform rig's response is the pulse as its own detector shows it: that is recorded, and keeps its declared mean
    time. An AMCW rig declares no waveform, so that nothing of it changes.
    """
    if scene.modality == "waveform":
        return _calibrated_waveform(scene, declared, calibration, _generator(calibration, seed, key, Record.PULSE))
    if scene.modality == "amcw":
        return declared
    rig = json.loads(declared)
    step = float(rig["pulse"]["step_s"])
    rng = _generator(calibration, seed, key, Record.PULSE)
    time, counts = record_pulse(optics_pulse(gated_rig(scene).laser.pulse), step, calibration.pulse_photoelectrons, rng)
    rig["pulse"] = pulse_from_trace(float(time[0]), step, counts)
    gates = []
    for block, (gate, old) in enumerate(zip(gated_rig(scene).gates, rig["gates"], strict=True)):
        rng = _generator(calibration, seed, key, Record.GATE, block)
        delay, counts = record_gate(optics_gate(gate), step, calibration.gate_photoelectrons, rng)
        # The scan tells the shape; the height belongs to the photon transfer, which the declared rig already holds.
        gates.append(gate_from_scan(float(delay[0]), step, counts, transmission=max(old["value"])))
    rig["gates"] = gates
    return json.dumps(rig, allow_nan=False)


def _calibrated_waveform(scene: Scene, declared: str, calibration: Calibration, rng: np.random.Generator) -> str:
    rig = json.loads(declared)
    old = rig["response"]
    step, weight = float(old["step_s"]), np.asarray(old["value"], np.float64)
    mean_time = float(old["start_s"]) + step * float((np.arange(weight.size) * weight).sum() / weight.sum())
    pulse, _ = shown_pulse(waveform_rig(scene))
    time, counts = record_pulse(pulse, step, calibration.pulse_photoelectrons, rng)
    found = pulse_from_trace(float(time[0]), step, counts)
    rig["response"] = found | {"start_s": found["start_s"] + mean_time}
    return json.dumps(rig, allow_nan=False)
