"""The stack of slices: what the delay generator was set to, what is drawn per slice, and the expected photoelectrons."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...optics.correlation import waveforms
from ...scenes.rigs.gated import gated_rig
from ...scenes.sampling import optics_gate
from ...scenes.scene import Scene
from ..random import Stage, generator, jitter_of_mean
from ..rays.returns import render_stack
from .direct import DirectScene
from .gates import gate_offset_image, gate_tables
from .motion import moving_stack

__all__ = ["ambient_electrons", "expected_electrons", "slice_coordinates", "slice_settings"]


def slice_coordinates(scene: Scene) -> dict[str, Any]:
    """Per-slice coordinates; `setting` is what the delay generator was set to, `actual` the optical delay."""
    rig = gated_rig(scene)
    spec = rig.delays
    ramp = np.repeat(spec.settings_s, spec.repeats)
    gates = len(rig.gates)
    lit = np.tile(ramp, gates)
    gate = np.repeat(np.arange(gates), len(ramp))
    setting = np.concatenate([lit, np.full(spec.laser_off, spec.start_s)])
    gate = np.concatenate([gate, np.zeros(spec.laser_off, dtype=int)])
    total = len(setting)
    return {
        "setting": setting,
        "actual": setting + rig.t0_s,
        "gate": gate.astype(np.int32),
        "pulses": np.full(total, rig.pulses_per_slice, dtype=np.int32),
        "laser_on": np.arange(total) < len(lit),
        "time": np.arange(total) * rig.detector.exposure_s,
        "valid": np.ones(total, dtype=bool),
    }


def slice_settings(
    scene: Scene, coords: dict[str, Any], seed: int, key: int
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """True optical delay [s] and relative pulse energy (0: laser off) of every slice.

    Pulse energy fluctuates per slice (mean of the slice's pulses), and the delay jitters: per slice, and by the mean of its
    pulses, which scatters by 1/√M of what single ones do. All are drawn here, because they are common to all pixels. The
    draws are named, so that every caller gets the same.
    """
    rig = gated_rig(scene)
    laser = rig.laser
    slices = len(coords["actual"])
    energy = np.ones(slices)
    if laser.energy_fluctuation:
        draw = generator(seed, key, Stage.ENERGY).standard_normal(slices)
        energy = np.maximum(1 + laser.energy_fluctuation * draw, 0.0)
    delay = coords["actual"].copy()
    if laser.jitter_frame_s:
        delay += laser.jitter_frame_s * generator(seed, key, Stage.JITTER).standard_normal(slices)
    if laser.jitter_shot_s:
        scatter = jitter_of_mean(laser.jitter_shot_s, rig.pulses_per_slice)
        delay += scatter * generator(seed, key, Stage.PULSES).standard_normal(slices)
    return delay, energy * coords["laser_on"]


def expected_electrons(
    scene: Scene, direct: DirectScene, coords: dict[str, Any], seed: int, key: int, rtol: float = 3e-3
) -> tuple[NDArray[np.float32], NDArray[np.float64]]:
    """Expected photoelectrons (slices, rows, cols) of signal plus ambient light, and the ambient share per slice.

    Where the rig moves, every slice is traced anew to `rtol`, and `direct` is not used.
    """
    rig = gated_rig(scene)
    rows, cols = rig.camera.rows, rig.camera.cols
    slices = len(coords["actual"])
    delay, scale = slice_settings(scene, coords, seed, key)
    light = np.empty((slices, rows, cols), dtype=np.float32)
    offset = gate_offset_image(scene)
    background = ambient_electrons(scene, coords)
    tables = gate_tables(scene)
    if rig.motion_m_per_s is not None:
        flat = light.reshape(slices, -1)
        moving_stack(scene, coords["time"], coords["gate"], tables, delay, scale, offset, rtol, flat)
        tables = []
    for number, table in enumerate(tables):
        own = np.flatnonzero(coords["gate"] == number)
        if len(own) == slices:
            render_stack(direct.returns, table, delay, scale, offset, light.reshape(slices, -1))
        else:
            part = np.empty((len(own), rows * cols), dtype=np.float32)
            render_stack(direct.returns, table, delay[own], scale[own], offset, part)
            light[own] = part.reshape(-1, rows, cols)
    light += background.astype(np.float32)[:, None, None]
    return light, background


def ambient_electrons(scene: Scene, coords: dict[str, Any]) -> NDArray[np.float64]:
    """Photoelectrons of ambient light in a pixel, per slice."""
    rig = gated_rig(scene)
    areas = np.array([waveforms.gate_area(optics_gate(gate)) for gate in rig.gates])
    return np.asarray(rig.ambient_e_per_s * areas[coords["gate"]] * coords["pulses"])
