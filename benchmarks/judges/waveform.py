"""The judge of pulsed rangers."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
import xarray as xr

from ...estimators.calibration.response import pulse_from_trace
from ...scenes.rigs.waveform import shown_pulse, waveform_rig
from ...scenes.scene import Scene
from ..bounds.waveform import waveform_bound
from ..bounds.waveform_scan import waveform_scan
from ..scores.truth import Truth
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
    time, counts = record_pulse(pulse, step, calibration.of("pulse_photoelectrons"), draw(Record.PULSE, 0))
    found = pulse_from_trace(float(time[0]), step, counts)
    rig["response"] = found | {"start_s": found["start_s"] + mean_time}
    return rig


def _truth(capture: xr.Dataset) -> Mapping[str, Truth]:
    """The true range, m; a shot of several returns (`truth_returns`) has as many true values, the nearest of which counts."""
    plain = range_truth(capture)
    if "truth_returns" not in capture:
        return plain
    first = plain["range"].value
    returns = np.asarray(capture["truth_returns"].values, np.float64)
    others = tuple(np.where(np.isfinite(one), one, first) for one in returns.T)
    several = np.isfinite(first) & np.any([one != first for one in others], axis=0)
    return {"range": Truth(first, several, (first, *others))}


JUDGE = Judge(
    truth=_truth,
    bound=lambda capture: {"range": waveform_bound(capture)},
    scan=waveform_scan,
    calibrate=_calibrated,
    neighbours=("waveform-ml", "waveform-average", "waveform-constant-fraction"),
    scenes=("photodetector-5m", "counter"),
    laws="beambench.benchmarks.laws.waveform:LAWS",
    twin="beambench.benchmarks.twin.waveform:TWIN",
)
