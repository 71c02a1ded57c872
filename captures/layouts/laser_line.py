"""Layout of the captures of a laser-line camera: frames in which a sheet of light crosses every row."""

from __future__ import annotations

from ..quantities import CAPTURE, COORDINATES, Quantity, Stage
from .layout import Layout
from .variables import BOOL, COUNTS, MAP, REAL, camera_extras, coord, data, per_frame, truth

__all__ = ["LAYOUT"]

_LASER_LINE = (
    data("counts", "frame row col", COUNTS, "DN", "digital counts of the frames", channel=True),
    *per_frame("frame"),
    coord("laser_on", "frame", BOOL, "1", "whether the laser shone"),
    coord("exposure", "frame", REAL, "s", "exposure of the frame, where it is automatic", required=False),
    coord("gain", "frame", REAL, "1", "gain of the frame over the declared one, where it is automatic", required=False),
    coord("pitch", "frame", REAL, "rad", "pitch of the camera against gravity, as read", required=False),
    coord("roll", "frame", REAL, "rad", "roll of the camera against gravity, as read", required=False),
    coord("pose", "frame pose_element", REAL, "m, rad", "pose of the rig: x, y, z in m, rotation vector in rad"),
    truth("truth_column", "frame row return", REAL, "px", "column of the line's centre"),
    truth("truth_point", "frame row return xyz", REAL, "m", "illuminated point in the camera frame"),
    truth(
        "truth_amplitude", "frame row return", REAL, "electron", "mean photoelectrons of the whole line in the row",
        required=False,
    ),
    truth("truth_width", "frame row return", REAL, "px", "standard deviation of the line across the row", required=False),
    truth(
        "truth_background", "frame", REAL, "electron", "ambient, dark and scattered electrons of a pixel",
        required=False, also=(("frame", "row", "col"),),
    ),
    truth("truth_direct", "frame row col", MAP, "electron", "expected light of the line, reflected once", required=False),
    truth("truth_scattered", "frame row col", MAP, "electron", "expected light that the medium scattered", required=False),
    truth("truth_ambient", "frame row col", MAP, "electron", "ambient and dark electrons", required=False),
    truth(
        "truth_standard_error", "frame row col", REAL, "electron", "standard error of the path-traced light", required=False
    ),
    truth("truth_slope", "survey", REAL, "1", "slope of the surface's power spectrum along profiles", required=False),
    truth("truth_level", "survey", REAL, "dB", "its density at 10 cycles/m, relative to 1 m³", required=False),
    *camera_extras("frame row col"),
)  # fmt: skip

_COLUMN = Quantity("column", "px", ("frame", "row", "return"), "column of the line's centre")
_POINT = Quantity(
    "point", "m", ("frame", "row", "return", "xyz"), "illuminated point in the camera frame", (1e3, "mm"),
    components=("xyz",), noun="point",
)  # fmt: skip
_LEVEL_POINT = Quantity(
    "level_point", "m", ("frame", "row", "return", "xyz"), "illuminated point in the gravity frame, y down", (1e3, "mm"),
    components=("xyz",), noun="point",
)  # fmt: skip
#: One number for all frames of a capture.
_SLOPE = Quantity("slope", "1", ("survey",), "slope of the power spectrum, S ~ f^-slope", noun="survey")
_LEVEL = Quantity(
    "level", "dB", ("survey",), "density of the power spectrum at 10 cycles/m, relative to 1 m³", noun="survey"
)

#: What a calibration answers (`estimators/laser_line/described.py`).
_NODE = Quantity(
    "node", "m", ("lattice", "xyz"), "point of the sheet at a lattice of pixels", (1e3, "mm"), components=("xyz",),
    noun="node",
)  # fmt: skip
_FOCAL = Quantity("focal_length", "m", ("survey",), "focal length", (1e3, "mm"), positive=True, noun="survey")
_PRINCIPAL = Quantity(
    "principal_point", "px", ("survey", "axis"), "row and column of the optical axis", components=("axis",),
    noun="survey",
)  # fmt: skip
_STAND_OFF = Quantity("stand_off", "m", ("survey",), "entrance pupil to window", (1e3, "mm"), noun="survey")
_ANGLE = Quantity(
    "plane_angle", "rad", ("survey", "axis"), "elevation and azimuth of the sheet's normal", (1e3, "mrad"),
    components=("axis",), noun="survey",
)  # fmt: skip
_OFFSET = Quantity(
    "plane_offset",
    "m",
    ("survey",),
    "distance of the sheet's plane from the entrance pupil",
    (1e3, "mm"),
    noun="survey",
)

LAYOUT = Layout(
    name="laser_line",
    variables=_LASER_LINE,
    data="counts",
    element=("frame", "row"),
    noun="row",
    stages=(
        Stage("line", "line", "laser_line", (CAPTURE,), (_COLUMN,)),
        Stage("triangulation", "triangulation", "laser_line", ("column", "rig"), (_POINT,)),
        Stage("gravity", "gravity", "laser_line", ("point", "rig", COORDINATES), (_LEVEL_POINT,)),
        Stage(
            "calibration",
            "calibration",
            "laser_line",
            (CAPTURE,),
            (_NODE, _FOCAL, _PRINCIPAL, _STAND_OFF, _ANGLE, _OFFSET),
        ),
        Stage("spectrum", "spectrum", "laser_line", ("point", "rig"), (_SLOPE, _LEVEL)),
    ),
    finite=("time",),
    padded={"return": 6},
)
