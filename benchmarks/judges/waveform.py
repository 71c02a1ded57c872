"""The judge of pulsed rangers."""

from __future__ import annotations

from typing import Any

import numpy as np

from ...estimators.calibration.response import pulse_from_trace
from ...scenes.rigs.waveform import shown_pulse, waveform_rig
from ...scenes.scene import Scene
from ..bounds.waveform import waveform_bound
from ..bounds.waveform_scan import waveform_scan
from ..suites.spec import Calibration
from .judge import Draw, Judge
from .ranges import range_truth
from .records import Record, record_pulse

__all__ = ["JUDGE"]


def _calibrated(scene: Scene, rig: dict[str, Any], calibration: Calibration, draw: Draw) -> dict[str, Any]:
    """The declared rig with a recorded response, i.e. the pulse as the rig's own detector shows it; its mean time is unchanged."""
    old = rig["response"]
    step, weight = float(old["step_s"]), np.asarray(old["value"], np.float64)
    mean_time = float(old["start_s"]) + step * float((np.arange(weight.size) * weight).sum() / weight.sum())
    pulse, _ = shown_pulse(waveform_rig(scene))
    time, counts = record_pulse(pulse, step, calibration.pulse_photoelectrons, draw(Record.PULSE, 0))
    found = pulse_from_trace(float(time[0]), step, counts)
    rig["response"] = found | {"start_s": found["start_s"] + mean_time}
    return rig


JUDGE = Judge(
    truth=range_truth,
    bound=lambda capture: {"range": waveform_bound(capture)},
    scan=waveform_scan,
    calibrate=_calibrated,
    neighbours=("waveform-ml", "waveform-average", "waveform-constant-fraction"),
    scenes=("photodetector-5m", "counter"),
    laws="beambench.benchmarks.laws.waveform:LAWS",
)
