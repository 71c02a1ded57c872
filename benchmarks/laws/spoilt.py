"""Captures in which some samples are no data: each estimator must do without them, or refuse the element.

A spoilt capture is a function maker -> (what is spoilt, capture), or None where it does not apply. The light and its noise
are those of the clean capture, so that an answer differs from the clean one by what the samples would have told, and no more.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping
from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from .maker import Maker

if TYPE_CHECKING:
    import xarray as xr

__all__ = ["SPOILT"]

Array = npt.NDArray[Any]

#: Far below any offset, in DN.
_NEGATIVE = -1000.0


def _clipped(maker: Maker, number: int) -> xr.Dataset | None:
    """The detector's full well, as declared and in the data, at the `number`-th brightest sample of the median element."""
    rig = json.loads(maker.clean().attrs["rig"])
    part = maker.laws.converter(rig)
    if part is None:
        return None
    held: list[int] = []

    def clip(data: Array) -> Array:
        held.append(int(np.median(np.sort(data, axis=0)[-number])))
        return np.asarray(np.minimum(data, data.dtype.type(held[0])))

    capture = maker.changed(clip)
    # A sample counts as clipped from 4 standard deviations of the read noise below the full well on; .25 DN for rounding.
    light = (held[0] - 0.25 - part["offset_dn"]) / part["gain_dn_per_e"]
    part["full_well_e"] = light + 4 * part["read_noise_e"]
    return capture.assign_attrs(rig=json.dumps(rig))


def _filled(maker: Maker, value: float, before: int) -> xr.Dataset | None:
    """`value` in the sample that lies by `before` before the brightest one of each element."""
    kind = "" if value == 0 else maker.float_type
    if (value == 0 and maker.laws.converter(maker.rig) is None) or (value != 0 and not kind):
        return None

    def fill(data: Array) -> Array:
        at = np.maximum(data.argmax(axis=0) - before, 0)
        data = data.astype(kind or data.dtype)
        data[at, np.arange(data.shape[1])] = value
        return data

    return maker.changed(fill)


#: name -> the capture. A count of 0 lies far below the offset where there is a converter; of single photons it is a datum.
SPOILT: Mapping[str, Callable[[Maker], xr.Dataset | None]] = {
    "1 clipped sample": partial(_clipped, number=1),
    "3 clipped samples": partial(_clipped, number=3),
    "5 clipped samples": partial(_clipped, number=5),
    "a missing sample": partial(_filled, value=np.nan, before=0),
    "a dead sample": partial(_filled, value=0.0, before=1),
    "a negative sample": partial(_filled, value=_NEGATIVE, before=1),
}
