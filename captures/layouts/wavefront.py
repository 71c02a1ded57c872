"""Layout of the captures of a Shack-Hartmann sensor: frames of spots, and the spot field of a flat wavefront."""

from __future__ import annotations

from ..quantities import CAPTURE, COORDINATES, Quantity, Stage
from .layout import Layout
from .variables import COUNTS, REAL, camera_extras, coord, data, per_frame, truth

__all__ = ["LAYOUT"]

_WAVEFRONT = (
    data("counts", "frame row col", COUNTS, "DN", "digital counts of the frames", channel=True),
    data("reference", "row col", ("float32", "uint16", "float64"), "DN", "spot field of a flat wavefront"),
    coord("delay", "frame", REAL, "s", "gate's opening half-height edge minus the pulse centroid, at the camera"),
    *per_frame("frame"),
    truth("truth_field", "frame pupil_row pupil_col", ("complex64", "complex128"), "1", "complex field in the pupil"),
    truth("truth_slope", "frame lenslet axis", REAL, "rad", "intensity-weighted slope: Im ∫u*∇u / (k ∫|u|²)"),
    truth("truth_phase", "frame pupil_row pupil_col", REAL, "rad", "least-squares phase; NaN at branch points"),
    truth("truth_zernike", "frame mode", REAL, "rad", "Zernike coefficients, Noll index from 2, unit rms"),
    truth(
        "truth_flux", "frame lenslet", REAL, "electron", "mean photoelectrons of the whole spot", required=False,
    ),
    truth(
        "truth_background", "frame", REAL, "electron", "ambient, dark and scattered electrons of a pixel", required=False,
    ),
    data("image", "frame image_row image_col", REAL, "electron", "chart seen through the same pupil", required=False),
    truth("truth_image", "image_row image_col", REAL, "1", "the chart, 1 where it is white", required=False),
    truth("truth_r0", "gate", REAL, "m", "Fried parameter at the array; NaN without turbulence", required=False),
    truth("truth_present", "gate", REAL, "1", "1 where there is turbulence, 0 where there is none", required=False),
    truth("truth_source", "layer", REAL, "m", "range of the strongest layer; NaN without turbulence", required=False),
    *camera_extras("frame row col"),
)  # fmt: skip

_SPOT = Quantity("spot", "px", ("frame", "lenslet", "axis"), "position of the spot", components=("axis",), noun="spot")
_SLOPE = Quantity(
    "slope", "rad", ("frame", "lenslet", "axis"), "slope of the wavefront", (1e6, "µrad"), components=("axis",),
    noun="lenslet",
)  # fmt: skip
_ZERNIKE = Quantity(
    "zernike", "rad", ("frame", "mode"), "Zernike coefficient, Noll index from 2, unit rms", noun="coefficient"
)
_PHASE = Quantity("phase", "rad", ("frame", "pupil_row", "pupil_col"), "phase of the wavefront", noun="sample")
#: A gate is a delay that frames have in common, in ascending order.
_R0 = Quantity(
    "r0", "m", ("gate",), "Fried parameter of the wavefront at the array", (1e3, "mm"), positive=True, noun="gate"
)
_PRESENT = Quantity("present", "1", ("gate",), "probability that there is turbulence", noun="gate")
_SOURCE = Quantity("source", "m", ("layer",), "range of the strongest layer", noun="layer")
_IMAGE = Quantity(
    "image", "1", ("frame", "image_row", "image_col"), "chart without blur, 1 where it is white", noun="pixel"
)

LAYOUT = Layout(
    name="wavefront",
    variables=_WAVEFRONT,
    data="counts",
    element=("frame",),
    noun="frame",
    stages=(
        Stage("centroid", "centroid", "wavefront", (CAPTURE,), (_SPOT,)),
        Stage("assignment", "assignment", "wavefront", ("spot", "rig"), (_SLOPE,)),
        Stage("reconstruction", "reconstruction", "wavefront", ("slope", "rig"), (_ZERNIKE, _PHASE)),
        Stage("turbulence", "turbulence", "wavefront", ("slope", "rig", COORDINATES), (_R0, _PRESENT, _SOURCE)),
        Stage("deconvolution", "deconvolution", "wavefront", ("phase", CAPTURE, "rig"), (_IMAGE,)),
    ),
    finite=("delay",),
)
