"""Looks: what a picture of a capture or of a run shows, as panels; drawn as a chart, or as blocks of colour in a terminal."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    import xarray as xr

    from .panel import Curves, Image

    #: (capture, number of the element that is shown, or None for the brightest) -> panels.
    Look = Callable[[xr.Dataset, int | None], list[Image | Curves]]

__all__ = ["LOOKS", "look_of"]

#: modality -> "module:function". Captures of a modality without a line here are shown plane by plane.
LOOKS: dict[str, str] = {
    "gated": "beambench.benchmarks.looks.gated:gated_look",
    "waveform": "beambench.benchmarks.looks.waveform:waveform_look",
    "amcw": "beambench.benchmarks.looks.amcw:amcw_look",
    "laser_line": "beambench.benchmarks.looks.laser_line:laser_line_look",
    "wavefront": "beambench.benchmarks.looks.wavefront:wavefront_look",
}


def look_of(modality: object) -> Look:
    """The function that gives the panels of a capture."""
    from ...scenes.records import object_at

    look: Look = object_at(LOOKS.get(str(modality), "beambench.benchmarks.looks.planes:planes_look"))
    return look
