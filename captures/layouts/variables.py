"""Short functions that describe the variables of a layout."""

from __future__ import annotations

from .schema import Variable

__all__ = ["BOOL", "COUNTS", "INT", "MAP", "REAL", "camera_extras", "coord", "data", "per_frame", "truth"]

COUNTS = ("uint16", "float32")
REAL = ("float64", "float32")
MAP = ("float32", "float64")
INT = ("int32", "int16", "int64", "uint8", "uint16", "uint32")
BOOL = ("bool",)


def data(name: str, dims: str, dtypes: tuple[str, ...], units: str, long_name: str, **kw: object) -> Variable:
    """A measured variable; spaces separate `dims`, and bars separate `units`."""
    return Variable(name, tuple(dims.split()), dtypes, tuple(units.split("|")), long_name, **kw)  # type: ignore[arg-type]


def coord(name: str, dims: str, dtypes: tuple[str, ...], units: str, long_name: str, **kw: object) -> Variable:
    """A coordinate."""
    return data(name, dims, dtypes, units, long_name, role="coord", **kw)


def truth(name: str, dims: str, dtypes: tuple[str, ...], units: str, long_name: str, **kw: object) -> Variable:
    """A variable of the truth, which estimators never read."""
    return data(name, dims, dtypes, units, long_name, role="truth", **kw)


def per_frame(frame: str) -> tuple[Variable, ...]:
    """Coordinates along the dimension `frame`, which is "frame" or "slice"."""
    return (
        coord("time", frame, REAL, "s", f"start of the {frame}, on the capture's own clock"),
        coord("valid", frame, BOOL, "1", f"whether the {frame} was recorded soundly"),
    )


def camera_extras(expectation_dims: str) -> tuple[Variable, ...]:
    """Optional variables of a camera; `expectation_dims` are the dimensions of its counts."""
    return (
        data("dark", "row col", MAP, "DN", "mean dark image", required=False, channel=True),
        data("flat", "row col", MAP, "1", "relative response of the pixels", required=False, channel=True),
        truth(
            "truth_electrons",
            expectation_dims,
            MAP,
            "electron",
            "noise-free expectation",
            required=False,
            channel=True,
        ),
    )
