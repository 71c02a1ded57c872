"""What the bounds read of a generated gated capture: its true scene, responses, noise, delays and paths.

Bounds are those of the scene as it truly is, not as it is declared. A capture that was recorded has no such scene: it has
no bound either, and the scales of failure and prior come from the rig as declared (`unbounded`).
"""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
import numpy.typing as npt
import xarray as xr

from ...optics.constants import C_M_PER_S
from ...optics.correlation import response as correlation
from ...optics.correlation import waveforms
from ...optics.likelihood.model import NoiseModel
from ...scenes.errors import InputError
from ...scenes.rigs.gated import GatedRig
from ...scenes.sampling import optics_gate, optics_pulse, response_table
from ...scenes.scene import Scene
from ...scenes.validate import validate_spec
from ..scores.truth import Bound

__all__ = [
    "bounded", "gate_offsets", "gated_responses", "halo_of", "light_path", "noise_model", "path_delay",
    "response_centroid_s", "response_std_s", "samples_variance_s2", "true_delay", "true_scene", "unbounded",
]  # fmt: skip

Float = npt.NDArray[np.float64]


def true_scene(capture: xr.Dataset) -> Scene:
    """The scene that the capture was really generated from. Raises InputError where the capture does not tell."""
    text = capture.attrs.get("truth_scene")
    if not isinstance(text, str):
        raise InputError("The capture does not tell its true scene.", where="attribute truth_scene")
    return validate_spec(Scene, json.loads(text), "truth_scene")


def bounded(capture: xr.Dataset, *truth: str) -> bool:
    """Whether a capture tells what its bound is made of: the true scene, and the truth named."""
    return isinstance(capture.attrs.get("truth_scene"), str) and all(name in capture for name in truth)


def _declared(capture: xr.Dataset) -> dict[str, Any]:
    """The rig as declared. Raises InputError where it is no table of values."""
    text = capture.attrs.get("rig")
    try:
        rig = json.loads(text) if isinstance(text, str) else None
    except ValueError:
        rig = None
    if not isinstance(rig, dict):
        raise InputError("The capture does not declare its instrument.", where="attribute rig", value=text)
    return rig


def unbounded(capture: xr.Dataset, scales: Callable[[dict[str, Any]], tuple[float, float]]) -> Bound:
    """The `Bound` of a capture that asserts none: kind "none", NaN for every element.

    Main arguments:
        scales: declared rig -> (scale, window). Raises InputError where the rig declares less than that takes.
    """
    rig = _declared(capture)
    try:
        scale, window = scales(rig)
    except (KeyError, IndexError, TypeError, ValueError) as error:
        raise InputError(
            "The declared rig does not tell the scale of failure.", where="attribute rig",
            value=f"{type(error).__name__}: {error}",
            next_step="declare pulse, gates and medium as `beambench generate` does",
        ) from error  # fmt: skip
    if not (math.isfinite(scale) and scale > 0 and math.isfinite(window) and window > 0):
        raise InputError(
            "The declared rig has no scale of failure.", where="attribute rig", value=(scale, window),
            allowed="a response and a range window above 0 m",
        )  # fmt: skip
    return Bound(np.full(capture["truth_range"].shape, np.nan), "none", scale, window)


def gated_responses(rig: GatedRig, rtol: float) -> list[correlation.Table]:
    """R(u) of every gate from its closed form, jitter per shot included; `rtol` of R's peak."""
    pulse = optics_pulse(rig.laser.pulse)
    if rig.laser.jitter_shot_s > 0:
        pulse = waveforms.broadened(pulse, rig.laser.jitter_shot_s)
    return [response_table(pulse, optics_gate(gate), rtol, f"rig.gates.{i}") for i, gate in enumerate(rig.gates)]


def response_std_s(tables: list[correlation.Table]) -> float:
    """σ_R: the largest standard deviation of R(u), as a density, over the gates."""
    widths = []
    for table in tables:
        u = table.start_s + table.step_s * np.arange(table.value.size)
        weight = table.value / table.value.sum()
        mean = float((weight * u).sum())
        widths.append(math.sqrt(float((weight * (u - mean) ** 2).sum())))
    return max(widths)


def samples_variance_s2(samples: Mapping[str, Any]) -> float:
    """Variance [s²] of a declared waveform as a density: samples a step apart, straight lines between them (step²/6)."""
    value, step = np.asarray(samples["value"], np.float64), float(samples["step_s"])
    t = step * np.arange(value.size)
    mean = float((value * t).sum() / value.sum())
    return float((value * (t - mean) ** 2).sum() / value.sum()) + step**2 / 6.0


def response_centroid_s(table: correlation.Table) -> float:
    """The mean of R(u), as a density."""
    u = table.start_s + table.step_s * np.arange(table.value.size)
    return float((table.value * u).sum() / table.value.sum())


def noise_model(rig: GatedRig) -> NoiseModel:
    """The likelihood of one sample. Dark electrons are part of the mean μ, unless a tube comes before them."""
    detector, tube = rig.detector, rig.detector.intensifier
    dark = detector.dark_current_e_per_s * detector.exposure_s
    return NoiseModel(
        read_noise_e=detector.read_noise_e,
        gain_dn_per_e=detector.gain_dn_per_e,
        offset_dn=detector.offset_dn,
        adc_max_dn=2**detector.adc_bits - 1,
        full_well_e=detector.full_well_e,
        excess_noise_factor=1.0 if tube is None else tube.excess_noise_factor,
        intensifier_gain=1.0 if tube is None else tube.gain,
        dark_e=0.0 if tube is None else dark,
    )


def light_path(truth: Float, rig: GatedRig) -> tuple[Float, Float]:
    """Path there and back, m, and its derivative by the range, for every pixel (row, col) of radial range `truth`."""
    position = np.asarray(rig.laser.position_m, np.float64)
    if not position.any():
        return 2.0 * truth, np.full(truth.shape, 2.0)
    camera = rig.camera
    x = (np.arange(camera.cols) - (camera.cols - 1) / 2) * camera.pixel_pitch_m / camera.focal_length_m
    y = (np.arange(camera.rows) - (camera.rows - 1) / 2) * camera.pixel_pitch_m / camera.focal_length_m
    norm = np.sqrt(1.0 + x[None, :] ** 2 + y[:, None] ** 2)
    ray = np.stack(np.broadcast_arrays(x[None, :] / norm, y[:, None] / norm, 1.0 / norm), axis=-1)
    from_laser = truth[..., None] * ray - position
    distance = np.sqrt((from_laser**2).sum(axis=-1))
    return truth + distance, 1.0 + (ray * from_laser).sum(axis=-1) / distance


def path_delay(truth: Float, rig: GatedRig, group_index: float) -> tuple[Float, Float]:
    """`light_path` as time [s], and its derivative [s/m]."""
    path, slope = light_path(truth, rig)
    return path * (group_index / C_M_PER_S), slope * (group_index / C_M_PER_S)


def true_delay(capture: xr.Dataset, rig: GatedRig) -> Float:
    """Delays (slice) as the light knows them: `delay` holds the declared t0."""
    declared = float(json.loads(capture.attrs["rig"])["t0_s"])
    return np.asarray(capture["delay"].values, np.float64) - declared + rig.t0_s


def gate_offsets(rig: GatedRig, shape: tuple[int, int]) -> Float:
    """How much later a pixel's gate opens, s, (row, col)."""
    if rig.gate_map is None:
        return np.broadcast_to(np.float64(0.0), shape)
    from ...optics.correlation.gate_maps import gate_offset_map

    return np.asarray(gate_offset_map(*shape, rig.gate_map.iris_s, rig.gate_map.skew_s), np.float64)


def halo_of(capture: xr.Dataset) -> Float:
    """Target light (row, col) that reaches a pixel scattered, in photoelectrons at an open gate; zero where none is told."""
    if "truth_halo" in capture:
        return np.nan_to_num(np.asarray(capture["truth_halo"].values, np.float64))
    return np.zeros(capture["truth_range"].shape)
