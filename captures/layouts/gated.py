"""Layout of the captures of a range-gated camera: a stack of slices, one per gate delay."""

from __future__ import annotations

from typing import Any

import xarray as xr

from ...scenes.errors import InputError
from ..quantities import CAPTURE, Stage
from .layout import Layout
from .ranges import radial_range
from .variables import BOOL, COUNTS, INT, MAP, REAL, camera_extras, coord, data, per_frame, truth

__all__ = ["LAYOUT"]

#: Components of the lamp's light, stored separately on request; the sum of those that a rung has is the whole.
_LIGHT = {
    "direct": "one surface",
    "scattered": "scattered by the medium, once or more",
    "interreflection": "several surfaces",
    "single": "scattered once by the medium, no surface",
    "multiple": "scattered, and not once alone",
}

_GATED = (
    data("counts", "slice row col", COUNTS, "DN", "digital counts of the slices", channel=True),
    coord("delay", "slice", REAL, "s", "gate's opening half-height edge minus the pulse centroid, at the camera"),
    coord("gate", "slice", INT, "1", "index into the rig's gates"),
    coord("pulses", "slice", INT, "1", "laser pulses accumulated in the slice; absent: equally many", required=False),
    coord("laser_on", "slice", BOOL, "1", "whether the laser fired"),
    *per_frame("slice"),
    truth("truth_range", "row col", REAL, "m", "radial range along the pixel-centre ray"),
    truth("truth_depth", "row col", REAL, "m", "orthogonal distance along the optical axis"),
    truth("truth_incidence", "row col", REAL, "rad", "angle between the surface normal and the ray"),
    truth("truth_normal", "row col xyz", MAP, "1", "unit surface normal in the camera frame"),
    truth("truth_albedo", "row col", MAP, "1", "hemispherical albedo at normal incidence"),
    truth("truth_material", "row col", INT, "1", "code of the material; −1 where there is none"),
    truth(
        "truth_instance", "row col", INT, "1",
        "number of the piece of the target, counted through all objects; −1 where there is none", required=False,
    ),
    truth("truth_mixed", "row col", BOOL, "1", "whether the pixel's sub-samples span over 5 % of R's width"),
    truth("truth_first", "row col", REAL, "m", "range of the nearest sub-sample"),
    truth("truth_last", "row col", REAL, "m", "range of the farthest sub-sample"),
    truth(
        "truth_amplitude", "row col", REAL, "electron",
        "photoelectrons at an open gate of transmission 1 of light that was reflected once and not scattered",
        required=False, channel=True,
    ),
    truth(
        "truth_background", "slice row col", REAL, "electron", "ambient and dark electrons of the slice",
        required=False, channel=True, also=(("slice",), ("row", "col")),
    ),
    truth(
        "truth_halo", "row col", REAL, "electron",
        "target light scattered forward into the pixel, at an open gate, by the small-angle picture (paths traced by the "
        "rung `full` hold up to a sixth more of it under wide beams); part of truth_background",
        required=False,
    ),
    truth(
        "truth_standard_error", "row col", REAL, "electron", "standard error of the path-traced light, at an open gate",
        required=False,
    ),
    *(
        truth(f"truth_{name}", "slice row col", MAP, "electron", f"expected light: {component}", required=False)
        for name, component in _LIGHT.items()
    ),
    truth("truth_ambient", "slice", REAL, "electron", "ambient and dark electrons of the slice", required=False),
    data("valid_sample", "slice row col", BOOL, "1", "whether the sample was recorded soundly", required=False),
    *camera_extras("slice row col"),
)  # fmt: skip


def _check(capture: xr.Dataset, rig: dict[str, Any], where: str) -> None:
    """Raise InputError if a slice uses a gate that the rig does not have."""
    gates = rig.get("gates")
    if isinstance(gates, list) and int(capture["gate"].values.max()) >= len(gates):
        raise InputError(
            "A slice uses a gate that the rig does not have.",
            where=f"{where}: gate", value=int(capture["gate"].values.max()), allowed=f"0 … {len(gates) - 1}",
        )  # fmt: skip


LAYOUT = Layout(
    name="gated",
    variables=_GATED,
    data="counts",
    element=("row", "col"),
    noun="pixel",
    stages=(Stage("gated", "range", "gated", (CAPTURE,), (radial_range("row", "col"),)),),
    finite=("delay",),
    check=_check,
)
