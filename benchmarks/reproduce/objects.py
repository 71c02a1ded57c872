"""Captures of Objects 1 and 2 by our generator, read by our estimators: Eq. 19-24, Figures 8 and 9.

The document gives the depths of the objects and which of them is brighter; shape, reflectivity and rig are those of the
library scenes, at 64 × 64 pixels over the same field of view.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from ...estimators import run_estimator
from ...estimators.gated.tools.stack import read_stack
from ...generator.generate import generate
from ...optics.correlation.gates import gate_area
from ...scenes.load import load_scene
from ...scenes.rigs.gated import gated_rig
from ...scenes.sampling import optics_gate
from ...scenes.scene import Scene
from .accuracy import DEPTHS_M
from .table_1 import PUBLISHED

__all__ = [
    "CORNER_RAD", "ObjectPair", "Reading", "depth_of", "fitted_level", "mean_shift", "objects", "printed_average",
    "read",
]  # fmt: skip

Array = NDArray[np.float64]

SEED = 5
#: The camera of the library scenes has 256 × 256 pixels of 13 µm; here the same field has a sixteenth of the pixels.
_SMALL = {
    "rig.camera.rows": 64,
    "rig.camera.cols": 64,
    "rig.camera.pixel_pitch_m": 52e-6,
    # The delays begin and end where R of every surface is below 1e-3: a truncated echo would bias a weighted average.
    "rig.delays.start_s": 27.5e-9,
    "rig.delays.count": 76,
}
#: Angle of the pixel farthest from the axis: φ of Eq. 13 for this camera.
CORNER_RAD = math.atan(math.hypot(31.5, 31.5) * 52e-6 / 8e-3)


@dataclass(frozen=True)
class ObjectPair:
    """Both objects: clean captures, captures with the fitted level in every slice, and that level in electrons."""

    clean: tuple[xr.Dataset, xr.Dataset]
    raised: tuple[xr.Dataset, xr.Dataset]
    level_e: float
    ambient_e_per_s: float


@dataclass(frozen=True)
class Reading:
    """The estimated range (row, col) of one object, m, and the resulting depth."""

    label: str
    range: Array
    depth_m: float


def _scene(number: int, **changes: Any) -> Scene:
    return load_scene(f"object{number}", _SMALL | changes)


@lru_cache(maxsize=1)
def objects() -> ObjectPair:
    """Generate the four captures (once per process). The level is fitted to Object 1 and used for both."""
    clean = tuple(generate(_scene(n), seed=SEED, truth_electrons=True) for n in (1, 2))
    rig = gated_rig(_scene(1))
    level = fitted_level(clean[0], DEPTHS_M[0], PUBLISHED["weighted average"][0] / 100.0)
    open_s = gate_area(optics_gate(rig.gates[0])) * rig.pulses_per_slice
    ambient = rig.ambient_e_per_s + level / open_s
    raised = tuple(generate(_scene(n, **{"rig.ambient_e_per_s": ambient}), seed=SEED) for n in (1, 2))
    return ObjectPair((clean[0], clean[1]), (raised[0], raised[1]), level, ambient)


def _masks(capture: xr.Dataset) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
    """Pixels of the object's front and of the background, without mixed ones."""
    material, mixed = capture["truth_material"].values, capture["truth_mixed"].values
    return (material == 0) & ~mixed, (material == 1) & ~mixed


def depth_of(capture: xr.Dataset, orthogonal_m: Array) -> float:
    """Mean orthogonal distance of the background less that of the object's front, m; NaN pixels are ignored."""
    front, back = _masks(capture)
    return float(np.nanmean(orthogonal_m[back]) - np.nanmean(orthogonal_m[front]))


def _cosine(capture: xr.Dataset) -> Array:
    """Cosine of each pixel's ray to the axis."""
    return np.asarray(capture["truth_depth"].values / capture["truth_range"].values, dtype=np.float64)


def read(capture: xr.Dataset, label: str, *, taken_as_depth: bool = False) -> Reading:
    """Run an estimator. The depth uses range × cosθ of the true ray, or the range itself as orthogonal distance."""
    found = run_estimator(label, capture)
    value = np.where(found["valid"].values, found["range"].values, np.nan).astype(np.float64)
    return Reading(label, value, depth_of(capture, value if taken_as_depth else value * _cosine(capture)))


def printed_average(capture: xr.Dataset, variable: str = "counts") -> Array:
    """Σ I r³/Σ I r² (row, col), m: Eq. 24 without its cancelling factor and its cosine, over all samples, also negative.

    variable: "counts" (less the offset of the detector), or "truth_electrons" less background: the noise-free echo.
    """
    stack = read_stack(capture)
    level = stack.instrument.offset_dn if variable == "counts" else float(capture["truth_background"].values.flat[0])
    intensity = capture[variable].values.astype(np.float64) - level
    r = stack.instrument.m_per_s * stack.centroid_delay_s
    return np.asarray(np.tensordot(r**3, intensity, axes=1) / np.tensordot(r**2, intensity, axes=1))


def fitted_level(capture: xr.Dataset, depth_m: float, error: float) -> float:
    """Electrons in every slice at which a noise-free weighted average compresses the depth by `error`.

    Works on the expected stack: t̂(B) = (ΣtS + B Σt)/(ΣS + K B) per pixel, solved for the mean depth by bisection.
    """
    stack = read_stack(capture)
    expected = capture["truth_electrons"].values.astype(np.float64)
    t = stack.centroid_delay_s
    light, moment = expected.sum(axis=0), np.tensordot(t, expected, axes=1)

    def shrink(level: float) -> float:
        mean = (moment + level * t.sum()) / (light + level * t.size)
        return 1.0 - depth_of(capture, stack.instrument.m_per_s * mean * _cosine(capture)) / depth_m

    low, high = 0.0, float(expected.max())
    for _ in range(60):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if shrink(middle) < error else (low, middle)
    return 0.5 * (low + high)


def mean_shift(capture: xr.Dataset, range_m: Array) -> tuple[float, float]:
    """Mean of range less truth over the background, m, and its standard error."""
    _front, back = _masks(capture)
    error = (range_m - capture["truth_range"].values)[back]
    error = error[np.isfinite(error)]
    return float(error.mean()), float(error.std(ddof=1)) / math.sqrt(error.size)
