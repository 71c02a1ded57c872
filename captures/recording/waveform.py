"""A series of waveforms: one trace of an oscilloscope per shot."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Annotated, Any, Literal

import numpy as np
import xarray as xr
from pydantic import Field

from ...scenes.base import Spec
from ...scenes.errors import InputError
from ...scenes.quantities import MomentTime
from ...scenes.scene import Scene
from .recipe import Built, Recipe, Slot, Taken, mean_of

__all__ = ["RECIPE", "WaveformSeries"]


class WaveformSeries(Spec):
    """`shots` shots of `averages` traces each, of `samples` samples in `units`.

    `zero_s`: time of the oscilloscope at which the pulse's centroid leaves; subtracted, so that 0 is the pulse.
    """

    shots: Annotated[int, Field(ge=1, le=65536)]
    averages: Annotated[int, Field(ge=1, le=65536)]
    samples: Annotated[int, Field(ge=4, le=10**7)]
    zero_s: MomentTime
    units: Literal["V", "A", "DN", "electron"]


def _slots(scan: WaveformSeries, scene: Scene) -> list[Slot]:
    return [Slot("scan", shot, {"scope": {"shot": shot}}) for shot in range(scan.shots) for _ in range(scan.averages)]


def _build(scan: WaveformSeries, scene: Scene, taken: Taken, declared: Mapping[str, Any]) -> Built:
    scale = taken.fixed.get("scope", {})
    if not {"start_s", "step_s"} <= set(scale):
        raise InputError("The oscilloscope gives no time axis.", where="scope", allowed="start_s, step_s read back")
    groups = taken.of_group()
    signal = mean_of(taken, groups)
    time_s = scale["start_s"] + scale["step_s"] * np.arange(scan.samples) - scan.zero_s
    valid = np.array([bool(taken.valid[group].all()) for group in groups])
    data = {"signal": xr.DataArray(signal, dims=("shot", "sample"), attrs={"units": scan.units})}
    return Built(data, {"time": time_s, "valid": valid})


RECIPE = Recipe(
    "waveform", WaveformSeries, ("scope",), _slots, lambda scan, scene: {}, lambda scan, scene: (scan.samples,), _build,
    dtype="float64",
)  # fmt: skip
