"""The inputs of the bounds of every modality: the true scene, the width of a response, the scales of failure.

Bounds are computed from the true scene, not from the declared rig. A recorded capture has no true scene, and so no bound; its
scales of failure and prior follow from the declared rig (`unbounded`).
"""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
import numpy.typing as npt
import xarray as xr

from ...estimators.rig import DeclaredRig, Samples, read_rig
from ...optics.correlation import response as correlation
from ...scenes.errors import InputError
from ...scenes.json_keys import read_json
from ...scenes.scene import Scene
from ...scenes.validate import validate_spec
from ..scores.truth import Bound

__all__ = [
    "bounded", "moves", "response_centroid_s", "response_std_s", "samples_variance_s2", "true_scene", "true_time",
    "unbounded",
]  # fmt: skip

Float = npt.NDArray[np.float64]


def true_scene(capture: xr.Dataset) -> Scene:
    """The scene that the capture was generated from. Raises InputError if the capture does not state it."""
    text = capture.attrs.get("truth_scene")
    if not isinstance(text, str):
        raise InputError("The capture does not state its true scene.", where="attribute truth_scene")
    return validate_spec(Scene, read_json(text), "truth_scene")


def bounded(capture: xr.Dataset, *truth: str) -> bool:
    """Whether a capture holds the inputs of its bound: the true scene, and the variables `truth`."""
    return isinstance(capture.attrs.get("truth_scene"), str) and all(name in capture for name in truth)


def true_time(capture: xr.Dataset, name: str, t0_s: float) -> Float:
    """A coordinate of times [s] with the true zero of time t0_s in place of the declared one.

    Raises InputError for a declared rig that lacks its zero of time, or states it as unknown.
    """
    return np.asarray(capture[name].values, np.float64) - read_rig(capture).number("t0_s") + t0_s


def moves(shift_m: float, sigma: Float) -> bool:
    """Whether a common shift of rms `shift_m`, which a bound `sigma` (element) does not hold, exceeds a tenth of any of it: .5 %
    of the error. Where no bound is finite any shift does."""
    least = float(np.min(sigma, where=np.isfinite(sigma), initial=np.inf))
    return shift_m > (0.1 * least if np.isfinite(least) else 0.0)


def unbounded(
    capture: xr.Dataset, scales: Callable[[DeclaredRig], tuple[float, float]], *, truth: str = "truth_range"
) -> Bound:
    """The `Bound` of a capture without one: kind "none", NaN for every element.

    Main arguments:
        scales: declared rig -> (scale, window) in the unit of the quantity.
    Other arguments:
        truth: variable that holds the truth of the quantity, whose shape the bound has.

    Raises InputError if the declared rig lacks a required value, or states it as unknown.
    """
    try:
        scale, window = scales(read_rig(capture))
    except InputError as error:
        raise InputError(
            f"The declared rig does not state the scale of failure: {error.what}", where=error.where, value=error.value,
            allowed=error.allowed, next_step="declare pulse, gates and medium as `beambench generate` does",
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


def samples_variance_s2(samples: Samples) -> float:
    """Variance [s²] of a declared waveform as a density: uniform samples with linear interpolation, which adds step²/6."""
    _, step, value = samples
    t = step * np.arange(value.size)
    mean = float((value * t).sum() / value.sum())
    return float((value * (t - mean) ** 2).sum() / value.sum()) + step**2 / 6.0


def response_centroid_s(table: correlation.Table) -> float:
    """The mean of R(u) as a density, s."""
    u = table.start_s + table.step_s * np.arange(table.value.size)
    return float((table.value * u).sum() / table.value.sum())
