"""The inputs of the bounds of a range-gated stack: responses, noise, delays and paths of the true rig."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
import xarray as xr

from ...optics.constants import C_M_PER_S
from ...optics.correlation import response as correlation
from ...optics.correlation import waveforms
from ...optics.likelihood.model import NoiseModel
from ...scenes.rigs.camera_noise import camera_noise
from ...scenes.rigs.gated import GatedRig
from ...scenes.sampling import optics_gate, optics_pulse, response_table
from .instrument import true_time

__all__ = [
    "gate_offsets", "gated_responses", "halo_of", "light_path", "noise_model", "path_delay", "true_delay",
]  # fmt: skip

Float = npt.NDArray[np.float64]


def gated_responses(rig: GatedRig, rtol: float) -> list[correlation.Table]:
    """R(u) of every gate from its closed form, including jitter per shot; `rtol`: error relative to the peak of R."""
    pulse = optics_pulse(rig.laser.pulse)
    if rig.laser.jitter_shot_s > 0:
        pulse = waveforms.broadened(pulse, rig.laser.jitter_shot_s)
    return [response_table(pulse, optics_gate(gate), rtol, f"rig.gates.{i}") for i, gate in enumerate(rig.gates)]


def noise_model(rig: GatedRig) -> NoiseModel:
    """The likelihood of one sample. Dark electrons are part of the mean μ, except behind an intensifier."""
    return camera_noise(rig.detector)


def light_path(truth: Float, rig: GatedRig) -> tuple[Float, Float]:
    """Path from the laser to the target to the camera, m, and its derivative with respect to the range `truth`, (row, col)."""
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
    """True delays (slice), s: the coordinate `delay`, with the true t0 in place of the declared one."""
    return true_time(capture, "delay", rig.t0_s)


def gate_offsets(rig: GatedRig, shape: tuple[int, int]) -> Float:
    """Additional delay of each pixel's gate, s, (row, col)."""
    if rig.gate_map is None:
        return np.broadcast_to(np.float64(0.0), shape)
    from ...optics.correlation.gate_maps import gate_offset_map

    return np.asarray(gate_offset_map(*shape, rig.gate_map.iris_s, rig.gate_map.skew_s), np.float64)


def halo_of(capture: xr.Dataset) -> Float:
    """Target light scattered into each pixel, photoelectrons at an open gate, (row, col); zero without `truth_halo`."""
    if "truth_halo" in capture:
        return np.nan_to_num(np.asarray(capture["truth_halo"].values, np.float64))
    return np.zeros(capture["truth_range"].shape)
