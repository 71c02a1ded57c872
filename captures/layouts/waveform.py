"""Layout of the captures of a pulsed ranger with one photodetector: a record of its signal per shot."""

from __future__ import annotations

from typing import Any

import numpy as np
import xarray as xr

from ...scenes.errors import InputError
from ..quantities import CAPTURE, Stage
from .layout import Layout
from .ranges import radial_range
from .variables import BOOL, INT, MAP, REAL, coord, data, truth

__all__ = ["LAYOUT"]

_WAVEFORM = (
    data("signal", "shot sample", ("float32", "float64", "uint16"), "DN|V|A|electron", "photodetector signal"),
    coord("time", "sample", REAL, "s", "time of the sample; 0 is the pulse centroid at emission"),
    data(
        "valid_sample", "shot sample", BOOL, "1", "whether the sample was recorded soundly", required=False,
    ),
    data(
        "pulse", "shot pulse_sample", ("float64", "float32"), "1|DN|V|A|electron|W",
        "outgoing pulse of the shot, its baseline subtracted, any scale", required=False,
    ),
    coord(
        "pulse_time", "pulse_sample", REAL, "s",
        "time of the pulse's sample on the clock of the records, which then start at the pulse's own centroid", required=False,
    ),
    coord("start", "shot", REAL, "s", "start of the shot's record: added to `time`", required=False),
    coord("pulses", "shot", INT, "1", "laser pulses averaged in the shot", required=False),
    coord("laser_on", "shot", BOOL, "1", "whether the laser fired", required=False),
    coord("valid", "shot", BOOL, "1", "whether the shot was recorded soundly", required=False),
    truth("truth_range", "shot", REAL, "m", "radial range; of the first return where a shot has several"),
    truth(
        "truth_returns", "shot return", REAL, "m", "radial ranges of all returns of the shot, NaN beyond their number",
        required=False,
    ),
    truth(
        "truth_amplitude", "shot", REAL, "electron",
        "photoelectrons of the whole echo, with what was scattered forward on its way", required=False,
    ),
    truth(
        "truth_background", "shot sample", REAL, "electron",
        "ambient and dark electrons of the sample, and what the water scatters back",
        required=False, also=(("shot",),),
    ),
    truth("truth_electrons", "shot sample", MAP, "electron", "noise-free expectation", required=False),
)  # fmt: skip


def _check(capture: xr.Dataset, rig: dict[str, Any], where: str) -> None:
    """Refuse an outgoing pulse without its times, and returns that are no ranges."""
    names = [name for name in ("pulse", "pulse_time") if name in capture.variables]
    if len(names) == 1:
        raise InputError(
            "An outgoing pulse needs its samples and their times.", where=f"{where}: {names[0]}", value=names,
            allowed="pulse(shot,pulse_sample) and pulse_time(pulse_sample) in s, or neither",
        )  # fmt: skip
    if "truth_returns" in capture.variables:
        returns = capture["truth_returns"].values
        bad = returns[np.isinf(returns) | (returns <= 0)]
        if bad.size:
            raise InputError(
                "The ranges of the returns must be positive, or NaN beyond their number.", where=f"{where}: truth_returns",
                value=float(bad[0]), allowed="> 0 or NaN",
            )  # fmt: skip


LAYOUT = Layout(
    name="waveform",
    variables=_WAVEFORM,
    data="signal",
    element=("shot",),
    noun="shot",
    stages=(Stage("waveform", "range", "waveform", (CAPTURE,), (radial_range("shot"),)),),
    finite=("time", "start", "pulse_time"),
    check=_check,
)
