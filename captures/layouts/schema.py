"""The contract of a capture: for each modality its variables with dims, dtypes, units and meaning. Data, no behaviour.

A capture in memory is one `xarray.Dataset` without a `capture` dimension; a store always has it in front. Changing a
table on this page bumps `SCHEMA_VERSION`, and files of another version are refused.
"""

from __future__ import annotations

from dataclasses import dataclass

__all__ = [
    "ATTRIBUTES",
    "FIXED_SIZES",
    "JSON_ATTRIBUTES",
    "MODALITIES",
    "SCHEMA_VERSION",
    "TRUTH_KINDS",
    "Variable",
    "modality_schema",
]

SCHEMA_VERSION = 1

TRUTH_KINDS = ("none", "rendered", "surveyed", "reference-instrument", "reference-algorithm")

JSON_ATTRIBUTES = ("rig", "truth_scene", "provenance", "fidelity", "truth_materials")
"""Attributes that hold a JSON text. `truth_materials` lists the names of the codes in `truth_material`."""

ATTRIBUTES = {
    "schema_version": "version of this contract",
    "modality": "one of the modalities of this page",
    "truth_kind": "where the truth comes from",
    "rig": "JSON: the instrument as declared, all that a laboratory would know",
    "truth_scene": "JSON: the scene that was really used",
    "truth_materials": "JSON: names of the codes in truth_material",
    "capture_key": "the capture's key in the tree of random streams",
    "seed": "the seed of the random streams",
    "provenance": "JSON: versions, CPU features and arguments to regenerate",
    "fidelity": "JSON: rung, effects modelled and neglected with their predicted size",
    "averaged": "True where counts are float32 means of several exposures",
}

FIXED_SIZES = {"xyz": 3, "axis": 2, "pose_element": 6}
"""Sizes that do not depend on the instrument. `pose_element`: x, y, z in m, then a rotation vector in rad."""


@dataclass(frozen=True)
class Variable:
    """One variable of a capture.

    Main arguments:
        name, dims: name and dimensions, without `capture`.
        dtypes: allowed dtypes; the first is what other numbers are turned into.
        units: allowed units; the first is the usual one. "1" is dimensionless.
        long_name: what it is, for people.
    Other arguments:
        role: "data", "coord" or "truth".
        required: whether each capture has it (truth of a recorded capture is then filled with NaN).
        channel: whether a last dimension `channel` may follow.
        also: other allowed dims.
    """

    name: str
    dims: tuple[str, ...]
    dtypes: tuple[str, ...]
    units: tuple[str, ...]
    long_name: str
    role: str = "data"
    required: bool = True
    channel: bool = False
    also: tuple[tuple[str, ...], ...] = ()

    @property
    def allowed_dims(self) -> tuple[tuple[str, ...], ...]:
        """Each tuple of dims that the variable may have."""
        plain = (self.dims, *self.also)
        return (*plain, *((*dims, "channel") for dims in plain)) if self.channel else plain


_COUNTS = ("uint16", "float32")
_REAL = ("float64", "float32")
_MAP = ("float32", "float64")
_INT = ("int32", "int16", "int64", "uint8", "uint16", "uint32")
_BOOL = ("bool",)


def _data(name: str, dims: str, dtypes: tuple[str, ...], units: str, long_name: str, **kw: object) -> Variable:
    return Variable(name, tuple(dims.split()), dtypes, tuple(units.split("|")), long_name, **kw)  # type: ignore[arg-type]


def _coord(name: str, dims: str, dtypes: tuple[str, ...], units: str, long_name: str, **kw: object) -> Variable:
    return _data(name, dims, dtypes, units, long_name, role="coord", **kw)


def _truth(name: str, dims: str, dtypes: tuple[str, ...], units: str, long_name: str, **kw: object) -> Variable:
    return _data(name, dims, dtypes, units, long_name, role="truth", **kw)


def _per_frame(frame: str) -> tuple[Variable, ...]:
    return (
        _coord("time", frame, _REAL, "s", f"start of the {frame}, on the capture's own clock"),
        _coord("valid", frame, _BOOL, "1", f"whether the {frame} was recorded soundly"),
    )


def _camera_extras(expectation_dims: str) -> tuple[Variable, ...]:
    return (
        _data("dark", "row col", _MAP, "DN", "mean dark image", required=False, channel=True),
        _data("flat", "row col", _MAP, "1", "relative response of the pixels", required=False, channel=True),
        _truth(
            "truth_electrons",
            expectation_dims,
            _MAP,
            "electron",
            "noise-free expectation",
            required=False,
            channel=True,
        ),
    )


#: Shares of the lamp's light, kept apart on request: their sum is all of it.
_LIGHT = {
    "direct": "one surface",
    "interreflection": "several surfaces",
    "single": "scattered once by the medium, no surface",
    "multiple": "scattered, and not once alone",
}

_GATED = (
    _data("counts", "slice row col", _COUNTS, "DN", "digital counts of the slices", channel=True),
    _coord("delay", "slice", _REAL, "s", "gate's opening half-height edge minus the pulse centroid, at the camera"),
    _coord("gate", "slice", _INT, "1", "index into the rig's gates"),
    _coord("pulses", "slice", _INT, "1", "laser pulses accumulated in the slice"),
    _coord("laser_on", "slice", _BOOL, "1", "whether the laser fired"),
    *_per_frame("slice"),
    _truth("truth_range", "row col", _REAL, "m", "radial range along the pixel-centre ray"),
    _truth("truth_depth", "row col", _REAL, "m", "orthogonal distance along the optical axis"),
    _truth("truth_incidence", "row col", _REAL, "rad", "angle between the surface normal and the ray"),
    _truth("truth_normal", "row col xyz", _MAP, "1", "unit surface normal in the camera frame"),
    _truth("truth_albedo", "row col", _MAP, "1", "hemispherical albedo at normal incidence"),
    _truth("truth_material", "row col", _INT, "1", "code of the material; −1 where there is none"),
    _truth("truth_mixed", "row col", _BOOL, "1", "whether the pixel's sub-samples span over 5 % of R's width"),
    _truth("truth_first", "row col", _REAL, "m", "range of the nearest sub-sample"),
    _truth("truth_last", "row col", _REAL, "m", "range of the farthest sub-sample"),
    _truth(
        "truth_amplitude", "row col", _REAL, "electron", "photoelectrons at an open gate of transmission 1",
        required=False, channel=True,
    ),
    _truth(
        "truth_background", "slice row col", _REAL, "electron", "ambient and dark electrons of the slice",
        required=False, channel=True, also=(("slice",), ("row", "col")),
    ),
    _truth(
        "truth_halo", "row col", _REAL, "electron",
        "target light scattered into the pixel, beside truth_amplitude, at an open gate; part of truth_background",
        required=False,
    ),
    _truth(
        "truth_standard_error", "row col", _REAL, "electron", "standard error of the path-traced light, at an open gate",
        required=False,
    ),
    *(
        _truth(f"truth_{name}", "slice row col", _MAP, "electron", f"expected light: {told}", required=False)
        for name, told in _LIGHT.items()
    ),
    *_camera_extras("slice row col"),
)  # fmt: skip

_WAVEFORM = (
    _data("signal", "shot sample", ("float32", "float64", "uint16"), "DN|V|A|electron", "photodetector signal"),
    _coord("time", "sample", _REAL, "s", "time of the sample; 0 is the pulse centroid at emission"),
    _coord("pulses", "shot", _INT, "1", "laser pulses averaged in the shot", required=False),
    _coord("laser_on", "shot", _BOOL, "1", "whether the laser fired", required=False),
    _coord("valid", "shot", _BOOL, "1", "whether the shot was recorded soundly", required=False),
    _truth("truth_range", "shot", _REAL, "m", "radial range"),
    _truth("truth_amplitude", "shot", _REAL, "electron", "photoelectrons of the whole echo", required=False),
    _truth(
        "truth_background", "shot sample", _REAL, "electron",
        "ambient and dark electrons of the sample, and what the water scatters back",
        required=False, also=(("shot",),),
    ),
    _truth("truth_electrons", "shot sample", _MAP, "electron", "noise-free expectation", required=False),
)  # fmt: skip

_AMCW = (
    _data("samples", "shot frequency phase", ("float32", "float64", "uint16"), "DN|V|electron", "correlation samples"),
    _coord("frequency", "frequency", _REAL, "Hz", "modulation frequency", required=False),
    _coord("phase", "phase", _REAL, "rad", "phase step of the reference", required=False),
    _coord("laser_on", "shot", _BOOL, "1", "whether the laser shone", required=False),
    _coord("valid", "shot", _BOOL, "1", "whether the shot was recorded soundly", required=False),
    _truth("truth_range", "shot", _REAL, "m", "radial range"),
    _truth("truth_amplitude", "shot", _REAL, "electron", "mean photoelectrons of a sample", required=False),
    _truth(
        "truth_background", "shot frequency phase", _REAL, "electron",
        "ambient and dark electrons of the sample, and what the water scatters back",
        required=False, also=(("shot",),),
    ),
    _truth("truth_electrons", "shot frequency phase", _MAP, "electron", "noise-free expectation", required=False),
)  # fmt: skip

_LASER_LINE = (
    _data("counts", "frame row col", _COUNTS, "DN", "digital counts of the frames", channel=True),
    *_per_frame("frame"),
    _coord("laser_on", "frame", _BOOL, "1", "whether the laser shone"),
    _coord("pose", "frame pose_element", _REAL, "m, rad", "pose of the rig: x, y, z in m, rotation vector in rad"),
    _truth("truth_column", "frame row return", _REAL, "px", "column of the line's centre"),
    _truth("truth_point", "frame row return xyz", _REAL, "m", "illuminated point in the camera frame"),
    *_camera_extras("frame row col"),
)

_WAVEFRONT = (
    _data("counts", "frame row col", _COUNTS, "DN", "digital counts of the frames", channel=True),
    _data("reference", "row col", ("float32", "uint16", "float64"), "DN", "spot field of a flat wavefront"),
    _coord("delay", "frame", _REAL, "s", "gate's opening half-height edge minus the pulse centroid, at the camera"),
    *_per_frame("frame"),
    _truth("truth_field", "frame pupil_row pupil_col", ("complex64", "complex128"), "1", "complex field in the pupil"),
    _truth("truth_slope", "frame lenslet axis", _REAL, "rad", "intensity-weighted slope: Im ∫u*∇u / (k ∫|u|²)"),
    _truth("truth_phase", "frame pupil_row pupil_col", _REAL, "rad", "least-squares phase; NaN at branch points"),
    _truth("truth_zernike", "frame mode", _REAL, "rad", "Zernike coefficients, Noll index from 2, unit rms"),
    *_camera_extras("frame row col"),
)

MODALITIES: dict[str, tuple[Variable, ...]] = {
    "gated": _GATED,
    "waveform": _WAVEFORM,
    "amcw": _AMCW,
    "laser_line": _LASER_LINE,
    "wavefront": _WAVEFRONT,
}


def modality_schema(modality: object) -> dict[str, Variable]:
    """The variables of `modality` by name. Raises InputError for an unknown one."""
    from ...scenes.errors import InputError

    if not isinstance(modality, str) or modality not in MODALITIES:
        raise InputError("unknown modality", where="attribute modality", value=modality, allowed=", ".join(MODALITIES))
    return {variable.name: variable for variable in MODALITIES[modality]}
