"""Gated captures from closed forms: slice k of a pixel has the mean α R(2 n_g r/c − t_k) + b photoelectrons."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import numpy.typing as npt
import xarray as xr

from ...captures.build import make_capture
from ...optics.correlation import response as correlation
from ...scenes.declared import declared_rig
from ...scenes.medium_index import group_index
from ...scenes.rigs.gated import gated_rig
from ...scenes.sampling import optics_gate, optics_pulse
from ...scenes.scene import Scene
from ..bounds.gated_instrument import noise_model, path_delay
from .draw import drawn_counts, generator, truth_attributes

__all__ = ["response_area_s", "written_capture"]

Float = npt.NDArray[np.float64]


def written_capture(
    scene: Scene, amplitude: Any, background: float, range_m: Any = 5.0, *, seed: int | None = None, **attrs: Any
) -> xr.Dataset:
    """A gated capture with its truth, for the rig of `scene` and any range and amplitude of each pixel.

    Main arguments:
        amplitude (row, col) or a number: photoelectrons at an open gate. background: photoelectrons per slice, dark
        electrons included. range_m (row, col), m, or a number; NaN: no truth.
    Other arguments:
        seed: of the counts; None leaves them zero, which is enough for bounds: they read truth and coordinates only.
        attrs: more attributes.

    Raises InputError for a scene of another modality.
    """
    rig = gated_rig(scene)
    shape = (rig.camera.rows, rig.camera.cols)
    number = rig.delays.count
    count = number * len(rig.gates)
    delay = np.tile(rig.delays.settings_s, len(rig.gates))
    plane = np.broadcast_to(np.asarray(range_m, np.float64), shape).copy()
    light = np.broadcast_to(np.asarray(amplitude, np.float64), shape).copy()
    counts = np.zeros((count, *shape), np.uint16)
    if seed is not None:
        rng = generator(seed)
        time = path_delay(plane, rig, group_index(scene.medium, rig.laser.wavelength_m))[0]
        pulse, noise = optics_pulse(rig.laser.pulse), noise_model(rig)
        for g, gate in enumerate(rig.gates):
            table = correlation.tabulate(pulse, optics_gate(gate), 1e-6)
            for k in range(g * number, (g + 1) * number):
                echo = light * np.maximum(correlation.lookup(table, time - delay[k] - rig.t0_s), 0.0)
                counts[k] = drawn_counts(np.nan_to_num(echo) + background, noise, rng)
    declared = declared_rig(scene)
    return make_capture(
        "gated",
        data={"counts": counts},
        coords={
            "delay": delay + declared["t0_s"], "gate": np.repeat(np.arange(len(rig.gates)), number),
            "pulses": np.full(count, rig.pulses_per_slice), "laser_on": np.ones(count, bool),
            "time": np.arange(count, dtype=float), "valid": np.ones(count, bool),
        },
        truth={
            "truth_range": plane, "truth_depth": plane, "truth_incidence": plane * 0, "truth_albedo": plane * 0 + 0.5,
            "truth_normal": np.zeros((*shape, 3)), "truth_material": np.zeros(shape, int),
            "truth_mixed": np.zeros(shape, bool), "truth_first": plane, "truth_last": plane,
            "truth_amplitude": light, "truth_background": np.full(count, background),
        },
        attrs=truth_attributes(scene, declared) | attrs,
    )  # fmt: skip


def response_area_s(scene: Scene) -> tuple[float, float]:
    """∫R du [s] and σ_R [s] of the rig's first gate, to turn photoelectrons of a whole echo into an amplitude."""
    rig = gated_rig(scene)
    table = correlation.tabulate(optics_pulse(rig.laser.pulse), optics_gate(rig.gates[0]), 1e-5)
    u = table.start_s + table.step_s * np.arange(table.value.size)
    area = float(np.trapezoid(table.value, dx=table.step_s))
    mean = float(np.trapezoid(table.value * u, dx=table.step_s)) / area
    return area, math.sqrt(float(np.trapezoid(table.value * (u - mean) ** 2, dx=table.step_s)) / area)
