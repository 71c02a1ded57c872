"""Layout of the captures of a pulsed ranger with one photodetector: a record of its signal per shot."""

from __future__ import annotations

from ..quantities import CAPTURE, Stage
from .layout import Layout
from .ranges import radial_range
from .variables import BOOL, INT, MAP, REAL, coord, data, truth

__all__ = ["LAYOUT"]

_WAVEFORM = (
    data("signal", "shot sample", ("float32", "float64", "uint16"), "DN|V|A|electron", "photodetector signal"),
    coord("time", "sample", REAL, "s", "time of the sample; 0 is the pulse centroid at emission"),
    coord("pulses", "shot", INT, "1", "laser pulses averaged in the shot", required=False),
    coord("laser_on", "shot", BOOL, "1", "whether the laser fired", required=False),
    coord("valid", "shot", BOOL, "1", "whether the shot was recorded soundly", required=False),
    truth("truth_range", "shot", REAL, "m", "radial range"),
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

LAYOUT = Layout(
    name="waveform",
    variables=_WAVEFORM,
    data="signal",
    element=("shot",),
    noun="shot",
    stages=(Stage("waveform", "range", "waveform", (CAPTURE,), (radial_range("shot"),)),),
    finite=("time",),
)
