"""The judge of range-gated cameras."""

from __future__ import annotations

from typing import Any

from ...estimators.calibration.response import gate_from_scan, pulse_from_trace
from ...scenes.rigs.gated import gated_rig
from ...scenes.sampling import optics_gate, optics_pulse
from ...scenes.scene import Scene
from ..bounds.gated import gated_bound
from ..bounds.gated_scan import gated_scan
from ..suites.spec import Calibration
from .judge import Draw, Judge
from .ranges import range_truth
from .records import Record, record_gate, record_pulse

__all__ = ["JUDGE"]


def _calibrated(scene: Scene, rig: dict[str, Any], calibration: Calibration, draw: Draw) -> dict[str, Any]:
    """The declared rig with pulse and gates recovered from records of the true ones."""
    step, true = float(rig["pulse"]["step_s"]), gated_rig(scene)
    rng = draw(Record.PULSE, 0)
    time, counts = record_pulse(optics_pulse(true.laser.pulse), step, calibration.of("pulse_photoelectrons"), rng)
    pulse = pulse_from_trace(float(time[0]), step, counts)
    gates = []
    for block, (gate, old) in enumerate(zip(true.gates, rig["gates"], strict=True)):
        rng = draw(Record.GATE, block)
        delay, counts = record_gate(optics_gate(gate), step, calibration.of("gate_photoelectrons"), rng)
        # The scan yields the shape only; the height is part of the photon transfer, which the declared rig already holds.
        gates.append(gate_from_scan(float(delay[0]), step, counts, transmission=max(old["value"])))
    rig["pulse"], rig["gates"] = pulse, gates
    return rig


JUDGE = Judge(
    truth=range_truth,
    bound=lambda capture: {"range": gated_bound(capture)},
    scan=gated_scan,
    calibrate=_calibrated,
    neighbours=("poisson-ml", "weighted-average[background=outside]", "parabola"),
    scenes=("flat-wall", "tilted-wall", "sphere"),
    laws="beambench.benchmarks.laws.gated:LAWS",
    design="beambench.benchmarks.design.gated:DESIGNS",
    twin="beambench.benchmarks.twin.gated:TWIN",
)
