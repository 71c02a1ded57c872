"""The condition "calibrated": estimators get pulse and gate samples from a simulated, noisy calibration.

A laboratory does not know its waveforms; it records them. Here each is recorded once, from the shapes of the true scene,
with counting noise:

- the pulse by a photodetector faster than the pulse: bin i holds Poisson(N ∫_bin p dt + d) counts;
- each gate by a scan of a probe pulse one step long, whose delay moves uniformly during the count: step k holds
  Poisson(n ∫ g(τ) hat((τ − τ_k)/h) dτ/h + d) counts, h the step;

with N and n photoelectrons from the suite and a dark level d of 1e-3 of the brightest sample, both with the declared
sampling step. The waveforms recovered from these records replace the samples in the declared rig; all else is unchanged.

The error of a calibration moves all ranges of a capture together, so that a single draw would look like a property of the
estimators. Each scene and seed of a suite therefore has its own draw. The levels of a stress share it, so that it does not
add scatter between them.

Remaining error, as the shift of R that a range has (waveforms about 1 ns long, steps up to 20 ps):

- without noise, below .06 mm: from an edge that is not odd about its half height, and from linear interpolation;
- from counting, mean 0 to first order in the records. The gate's half height, averaged over w to either side of an edge
  of slope s, has the standard deviation √(.625 h/(n w))/s, h the step: .4 mm for a rise of .3 ns at n = 1e3. The
  pulse's place has at most σ_p/√N: .2 mm at N = 1e5.
- a second-order error where a tail vanishes in the dark counts: below .1 mm at these counts, and less at higher ones.
"""

from __future__ import annotations

import json

import numpy as np

from ...scenes.scene import Scene
from ..suites.spec import Calibration
from ..suites.suite import CELL_NONE, Cell, capture_key
from . import judge_of

__all__ = ["Calibrations", "calibrated_rig"]


def _generator(calibration: Calibration, seed: int, key: int, record: int, block: int = 0) -> np.random.Generator:
    """The random generator of one record; its key holds the record and the seed of the calibration."""
    sequence = np.random.SeedSequence((calibration.seed, seed), spawn_key=(key, int(record), block))
    return np.random.Generator(np.random.PCG64(sequence))


class Calibrations:
    """The calibrations of one suite: one for each scene and seed, shared by all levels of a stress."""

    def __init__(self, calibration: Calibration) -> None:
        self._calibration = calibration
        self._known: dict[tuple[str, int, str, str], str] = {}

    def declared(self, cell: Cell, rig: str) -> str:
        """The declared rig `rig` of a cell's capture after its calibration; computed once for equal instruments."""
        place = (cell.scene_name, cell.random_seed, rig, cell.scene.model_dump_json(include={"rig"}))
        if place not in self._known:
            key = capture_key(cell.scene_name, CELL_NONE, float("nan"))  # from the unchanged scene, for all its levels
            self._known[place] = calibrated_rig(cell.scene, rig, self._calibration, seed=cell.random_seed, key=key)
        return self._known[place]


def calibrated_rig(scene: Scene, declared: str, calibration: Calibration, *, seed: int = 0, key: int = 0) -> str:
    """The declared rig (JSON), with what a calibration recovers from simulated records of the true instrument.

    Main arguments:
        scene: the scene whose rig is recorded. declared: the capture's attribute `rig`. calibration: the suite's noise and seed.
    Other arguments:
        seed, key: identify the draw, as for a capture: SeedSequence((calibration.seed, seed), spawn_key=(key, record, gate)).

    A rig that declares nothing which a calibration recovers is returned unchanged.
    """
    calibrate = judge_of(scene.modality).calibrate
    if calibrate is None:
        return declared
    rig = calibrate(
        scene, json.loads(declared), calibration,
        lambda record, block: _generator(calibration, seed, key, record, block),
    )  # fmt: skip
    return json.dumps(rig, allow_nan=False)
