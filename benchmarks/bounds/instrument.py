"""The inputs of the bounds of every modality: the true scene, the width of a response, the scales of failure.

Bounds are computed from the true scene, not from the declared rig. A recorded capture has no true scene, and so no bound; its
scales of failure and prior follow from the declared rig (`unbounded`).
"""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
import numpy.typing as npt
import xarray as xr

from ...optics.correlation import response as correlation
from ...scenes.errors import InputError
from ...scenes.scene import Scene
from ...scenes.validate import validate_spec
from ..scores.truth import Bound

__all__ = ["bounded", "response_centroid_s", "response_std_s", "samples_variance_s2", "true_scene", "unbounded"]

Float = npt.NDArray[np.float64]


def true_scene(capture: xr.Dataset) -> Scene:
    """The scene that the capture was generated from. Raises InputError if the capture does not state it."""
    text = capture.attrs.get("truth_scene")
    if not isinstance(text, str):
        raise InputError("The capture does not state its true scene.", where="attribute truth_scene")
    return validate_spec(Scene, json.loads(text), "truth_scene")


def bounded(capture: xr.Dataset, *truth: str) -> bool:
    """Whether a capture holds the inputs of its bound: the true scene, and the variables `truth`."""
    return isinstance(capture.attrs.get("truth_scene"), str) and all(name in capture for name in truth)


def _declared(capture: xr.Dataset) -> dict[str, Any]:
    """The declared rig. Raises InputError if it is not a table of values."""
    text = capture.attrs.get("rig")
    try:
        rig = json.loads(text) if isinstance(text, str) else None
    except ValueError:
        rig = None
    if not isinstance(rig, dict):
        raise InputError("The capture does not declare its instrument.", where="attribute rig", value=text)
    return rig


def unbounded(
    capture: xr.Dataset, scales: Callable[[dict[str, Any]], tuple[float, float]], *, truth: str = "truth_range"
) -> Bound:
    """The `Bound` of a capture without one: kind "none", NaN for every element.

    Main arguments:
        scales: declared rig -> (scale, window) in the unit of the quantity.
    Other arguments:
        truth: variable that holds the truth of the quantity, whose shape the bound has.

    Raises InputError if the declared rig lacks a required value.
    """
    rig = _declared(capture)
    try:
        scale, window = scales(rig)
    except (KeyError, IndexError, TypeError, ValueError) as error:
        raise InputError(
            "The declared rig does not state the scale of failure.", where="attribute rig",
            value=f"{type(error).__name__}: {error}",
            next_step="declare pulse, gates and medium as `beambench generate` does",
        ) from error  # fmt: skip
    if not (math.isfinite(scale) and scale > 0 and math.isfinite(window) and window > 0):
        raise InputError(
            "The declared rig has no scale of failure.", where="attribute rig", value=(scale, window),
            allowed="a response and a range window above 0 m",
        )  # fmt: skip
    return Bound(np.full(capture[truth].shape, np.nan), "none", scale, window)


def response_std_s(tables: list[correlation.Table]) -> float:
    """σ_R: the largest standard deviation of R(u) as a density, over the gates, s."""
    widths = []
    for table in tables:
        u = table.start_s + table.step_s * np.arange(table.value.size)
        weight = table.value / table.value.sum()
        mean = float((weight * u).sum())
        widths.append(math.sqrt(float((weight * (u - mean) ** 2).sum())))
    return max(widths)


def samples_variance_s2(samples: Mapping[str, Any]) -> float:
    """Variance [s²] of a declared waveform as a density: uniform samples with linear interpolation, which adds step²/6."""
    value, step = np.asarray(samples["value"], np.float64), float(samples["step_s"])
    t = step * np.arange(value.size)
    mean = float((value * t).sum() / value.sum())
    return float((value * (t - mean) ** 2).sum() / value.sum()) + step**2 / 6.0


def response_centroid_s(table: correlation.Table) -> float:
    """The mean of R(u) as a density, s."""
    u = table.start_s + table.step_s * np.arange(table.value.size)
    return float((table.value * u).sum() / table.value.sum())
