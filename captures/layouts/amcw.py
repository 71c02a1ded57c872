"""Layout of the captures of an amplitude-modulated ranger: correlation samples per shot, frequency and phase."""

from __future__ import annotations

from ..quantities import CAPTURE, Stage
from .layout import Layout
from .ranges import radial_range
from .variables import BOOL, MAP, REAL, coord, data, truth

__all__ = ["LAYOUT"]

_AMCW = (
    data("samples", "shot frequency phase", ("float32", "float64", "uint16"), "DN|V|electron", "correlation samples"),
    coord("frequency", "frequency", REAL, "Hz", "modulation frequency", required=False),
    coord("phase", "phase", REAL, "rad", "phase step of the reference", required=False),
    coord("laser_on", "shot", BOOL, "1", "whether the laser shone", required=False),
    coord("valid", "shot", BOOL, "1", "whether the shot was recorded soundly", required=False),
    truth("truth_range", "shot", REAL, "m", "radial range"),
    truth("truth_amplitude", "shot", REAL, "electron", "mean photoelectrons of a sample", required=False),
    truth(
        "truth_background", "shot frequency phase", REAL, "electron",
        "ambient and dark electrons of the sample, and what the water scatters back",
        required=False, also=(("shot",),),
    ),
    truth("truth_electrons", "shot frequency phase", MAP, "electron", "noise-free expectation", required=False),
)  # fmt: skip

LAYOUT = Layout(
    name="amcw",
    variables=_AMCW,
    data="samples",
    element=("shot",),
    noun="shot",
    stages=(Stage("amcw", "range", "amcw", (CAPTURE,), (radial_range("shot"),)),),
    finite=("frequency", "phase"),
)
