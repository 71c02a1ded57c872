"""Panels: images with lines over them, and curves; and what the looks of all modalities have in common."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
import xarray as xr

from ...scenes.errors import InputError
from ..report.pictures import DIVERGING, SEQUENTIAL

__all__ = [
    "FIRST", "GREY", "LONGEST", "TRUE", "Curve", "Curves", "Image", "brightest", "chosen", "curve_colour", "image",
    "mean_channel", "signed", "true_ranges", "unit_of",
]  # fmt: skip

Array = npt.NDArray[np.float64]

#: Colours of Okabe and Ito (2008), which the colour-blind tell apart: measured and true; further curves.
FIRST, TRUE = "#0072B2", "#D55E00"
#: For images under many lines.
GREY = ("#000000", "#ffffff")
#: Images whose sides differ by more than this fill their place: true to scale, they would be strips.
LONGEST = 4.0
_COLOURS = (FIRST, "#009E73", "#CC79A7", "#E69F00")
#: Share of the values that the scale of an image leaves out at either end: one hot pixel would make the rest dark.
_BEYOND = 0.002


@dataclass(frozen=True, eq=False)
class Curve:
    """A line through (x, y); NaN ends a stroke. Over an image, x and y are columns and rows. Curves of one name are one entry of
    the legend. `dots`: with a dot on every sample; not `strokes`: dots alone."""

    name: str
    x: Array
    y: Array
    colour: str = FIRST
    dots: bool = False
    strokes: bool = True


@dataclass(frozen=True, eq=False)
class Image:
    """An image (row, col) on the scale low … high in `unit`, NaN where there is nothing; `x`, `y`: what columns and rows are."""

    title: str
    values: Array
    unit: str
    low: float
    high: float
    anchors: tuple[str, ...] = SEQUENTIAL
    x: str = "column"
    y: str = "row"
    lines: tuple[Curve, ...] = ()


@dataclass(frozen=True, eq=False)
class Curves:
    """Curves over one pair of axes, which are named with their units."""

    title: str
    lines: tuple[Curve, ...]
    x: str
    y: str


def image(title: str, values: npt.ArrayLike, unit: str, *, like: npt.ArrayLike | None = None, x: str = "column",
          y: str = "row", lines: Sequence[Curve] = (), anchors: tuple[str, ...] = SEQUENTIAL) -> Image:  # fmt: skip
    """An image from the darkest to the brightest value but for the last thousandths; `like`: values whose scale is taken."""
    given = np.asarray(values, np.float64)
    low, high = _limits(given if like is None else np.asarray(like, np.float64))
    return Image(title, given, unit, low, high, anchors, x=x, y=y, lines=tuple(lines))


def signed(title: str, values: npt.ArrayLike, unit: str, *, x: str = "column", y: str = "row") -> Image:
    """An image of values of both signs: the scale is the same to both sides of zero."""
    given = np.asarray(values, np.float64)
    top = max(map(abs, _limits(given)))
    return Image(title, given, unit, -top, top, DIVERGING, x, y)


def _limits(values: Array) -> tuple[float, float]:
    finite = values[np.isfinite(values)]
    if not finite.size:
        return 0.0, 1.0
    low, high = map(float, np.quantile(finite, (_BEYOND, 1.0 - _BEYOND)))
    return (low, high) if high > low else (low, low + max(abs(low) * 1e-6, 1e-12))


def mean_channel(variable: xr.DataArray) -> xr.DataArray:
    """The values as float64, colour channels averaged."""
    values = variable.astype(np.float64)
    return values.mean("channel") if "channel" in values.dims else values


def brightest(values: Array) -> int:
    """The number of the plane, along the first axis, with most light."""
    return int(np.argmax(np.nansum(values.reshape(len(values), -1), axis=1)))


def chosen(element: int | None, values: Array, noun: str) -> int:
    """The number of the element that is shown: the given one, or the one with most light. Raises InputError for one too many."""
    if element is None:
        return brightest(values)
    if not 0 <= element < len(values):
        raise InputError(
            f"The capture has no such {noun}.", where="element", value=element, allowed=f"0 … {len(values) - 1}",
            next_step="leave it out to see the brightest",
        )  # fmt: skip
    return element


def true_ranges(capture: xr.Dataset) -> list[Image | Curves]:
    """The true range of every shot, nothing where it is unknown."""
    if "truth_range" not in capture.variables or not np.isfinite(capture["truth_range"].values).any():
        return []
    truth = capture["truth_range"].values.astype(np.float64)
    line = Curve("true range", np.arange(truth.size, dtype=float), truth, dots=True)
    return [Curves("true range", (line,), "shot", "range, m")]


def curve_colour(number: int) -> str:
    """The colour of a curve by its number."""
    return _COLOURS[number % len(_COLOURS)]


def unit_of(variable: xr.DataArray) -> str:
    """The unit of a variable."""
    return str(variable.attrs.get("units", ""))
