"""What the draws of a suite say of a quantity: the spread of its values from seed to seed."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace

import xarray as xr

from ...captures.layouts import layout_of
from ..scores.truth import Bound
from ..suites.spec import Draw
from ..suites.stress import axis_unit

__all__ = ["with_draws"]


def with_draws(bounds: Mapping[str, Bound], capture: xr.Dataset, draws: Sequence[Draw]) -> dict[str, Bound]:
    """The bounds, with the standard deviation of the draws whose levels are in the unit of the quantity.

    A level that is uniform from low to high has the variance (high − low)²/12, and several add up. A draw of another unit, as an
    angle, spreads the values too, but no number for that is known before; quantities of several components are left out.
    """
    found = dict(bounds)
    for quantity in layout_of(capture.attrs.get("modality")).quantities:
        spread = [(draw.high - draw.low) ** 2 / 12.0 for draw in draws if axis_unit(draw.axis) == quantity.unit]
        if spread and quantity.name in found and not quantity.components:
            found[quantity.name] = replace(found[quantity.name], drawn=math.sqrt(sum(spread)))
    return found
