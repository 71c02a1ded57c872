"""The look of a capture of any modality: of each variable the plane with most light."""

from __future__ import annotations

import numpy as np
import xarray as xr

from ...captures.exports.planes import planes_of
from ...captures.layouts import layout_of
from .panel import Curve, Curves, Image, chosen, image, mean_channel, unit_of

__all__ = ["plane_panel", "planes_look"]

_MOST = 4


def planes_look(capture: xr.Dataset, element: int | None) -> list[Image | Curves]:
    """The measured variable, and the first truths of the quantities that are estimated."""
    layout = layout_of(capture.attrs.get("modality"))
    names = [layout.data, *(f"truth_{quantity.name}" for quantity in layout.quantities)]
    shown = [name for name in names if name in capture.variables and capture[name].ndim][:_MOST]
    return [plane_panel(capture, name, element if name == layout.data else None) for name in shown]


def plane_panel(capture: xr.Dataset, name: str, element: int | None = None) -> Image | Curves:
    """A plane of a variable: the one of that number, or the one with most light; a curve where it is a single column."""
    variable = mean_channel(capture[name])
    planes = planes_of(name, list(map(str, variable.dims)), np.asarray(variable.values))
    number = chosen(element, planes.values, planes.over[0] if planes.over else "plane")
    title, unit = planes.labels()[number], unit_of(capture[name])
    values = planes.values[number]
    if min(values.shape) > 1:
        return image(title, values, unit, x=planes.dims[-1], y=planes.dims[0])
    level = values.reshape(-1)
    return Curves(title, (Curve(name, np.arange(level.size, dtype=float), level),), planes.dims[0], f"{name}, {unit}")
