"""The scene of a twin: what its rig looked at, or a wall in its place, with the rig's values and their uncertainty."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr

from ...optics.constants import C_M_PER_S
from ...scenes.errors import InputError
from ...scenes.load import load_scene
from ...scenes.overrides import apply_overrides
from ...scenes.rigs.gated import gated_rig
from ...scenes.scene import Scene
from .uncertain import held_at

__all__ = ["Uncertain", "perturbed", "stretched", "twin_scene", "uncertain_of"]

#: Tables of the rig whose times are stretched together.
_SHAPES = ("rig.laser.pulse", "rig.gates.0")
_GAIN, _EXCESS = "rig.detector.gain_dn_per_e", "rig.detector.intensifier.excess_noise_factor"


def stretched(shape: Mapping[str, Any], factor: float) -> dict[str, Any]:
    """A pulse or gate whose times (all keys in s) are longer by a factor."""
    return {key: value * factor if key.endswith("_s") else value for key, value in shape.items()}


def twin_scene(
    capture: xr.Dataset,
    scene: str | Path | Mapping[str, Any] | None,
    values: Mapping[str, Any],
    delays_s: np.ndarray[Any, Any],
) -> Scene:
    """The scene that the generator renders.

    Main arguments:
        capture: the recording. scene: what it shows; None: a wall, whose light is replaced by the map that is fitted to the
        recording. values: {path: value} of the twin's rig, over the scene's rig or, without a scene, over the recording's
        declared one. delays_s: what the delay generator was set to, (delay).

    Raises:
        InputError: a scene of another kind; a declared rig that lacks what the generator needs.
    """
    rows, cols = (int(capture.sizes[dim]) for dim in ("row", "col"))
    data: Any = _walled(capture) if scene is None else scene
    loaded = load_scene(data)
    gated_rig(loaded)
    held = apply_overrides(loaded.model_dump(mode="json"), dict(values))
    held["rig"]["delays"] = {
        "kind": "listed",
        "values_s": [float(one) for one in delays_s],
        "repeats": 1,
        "laser_off": 1,
    }
    held["declared"] = {}
    found = load_scene(held)
    camera = gated_rig(found).camera
    if (camera.rows, camera.cols) != (rows, cols):
        raise InputError(
            "The scene's camera is not that of the recording.",
            where="scene: rig.camera",
            value=f"{camera.rows} × {camera.cols} pixels",
            allowed=f"{rows} × {cols}",
            next_step=f"set rig.camera.rows={rows} and rig.camera.cols={cols} in the scene or the rig file",
        )
    return found


def _walled(capture: xr.Dataset) -> dict[str, Any]:
    """A scene from the declared rig: pulse and gate as its samples, a wall in the middle of the window."""
    rig = json.loads(str(capture.attrs["rig"]))
    try:
        return _scene_of(rig, capture)
    except (KeyError, TypeError, IndexError) as error:
        raise InputError(
            "The declared rig of the recording does not hold all that the generator needs.",
            where="attribute rig",
            value=str(error),
            next_step="name a scene with the recording's rig: --scene FILE",
        ) from error


def _scene_of(rig: Mapping[str, Any], capture: xr.Dataset) -> dict[str, Any]:
    camera, laser, medium = dict(rig["camera"]), rig["laser"], rig["medium"]
    for name in ("principal_row_px", "principal_col_px"):
        camera.pop(name, None)
    group = float(medium["group_index"])
    distance = 0.5 * C_M_PER_S / group * float(np.median(capture["delay"].values))
    size = 40.0 * distance
    shape = {
        "kind": "rectangle",
        "center_m": [0.0, 0.0, distance],
        "width_m": size,
        "height_m": size,
        "tilt_x_deg": 0.0,
        "tilt_y_deg": 0.0,
    }
    return {
        "schema_version": 1,
        "name": "recording",
        "title": "The recording's rig before a wall",
        "target": [{"name": "wall", "shape": shape, "material": {"kind": "lambert", "albedo": 0.5}}],
        "medium": {
            "name": "medium",
            "index": {"kind": "explicit", "phase": float(medium.get("phase_index", group)), "group": group},
            "absorption_per_m": 0.0,
            "scattering_per_m": 0.0,
        },
        "rig": {
            "kind": rig["kind"],
            "camera": camera,
            "pulses_per_slice": rig["pulses_per_slice"],
            "detector": _detector(rig),
            "ambient_e_per_s": rig.get("ambient_e_per_s", 0.0),
            "t0_s": rig.get("t0_s") or 0.0,
            "gate_map": rig.get("gate_offset_s"),
            "laser": {
                "wavelength_m": laser["wavelength_m"],
                "pulse_energy_j": laser["pulse_energy_j"],
                "pulse": {"kind": "sampled", "step_s": rig["pulse"]["step_s"], "value": rig["pulse"]["value"]},
                "illumination": {name: laser[name] for name in ("profile", "half_angle_rad", "offset_rad")},
                "position_m": laser["position_m"],
                "energy_fluctuation": laser.get("energy_fluctuation", 0.0),
                "jitter_shot_s": laser["jitter_shot_s"],
                "jitter_frame_s": laser.get("jitter_frame_s", 0.0),
            },
            "gates": [{"kind": "sampled", **gate} for gate in rig["gates"]],
            "delays": {"kind": "listed", "values_s": [0.0, 1e-9]},
        },
    }


def _detector(rig: Mapping[str, Any]) -> dict[str, Any]:
    return {"fixed_pattern_seed": 1, **rig["detector"]}


@dataclass(frozen=True)
class Uncertain:
    """Standard errors of a rig's values: `shapes` {table: relative stretch}, `values` {path: 1 σ}."""

    shapes: Mapping[str, float]
    values: Mapping[str, float]


def uncertain_of(scene: Scene, sigmas: Mapping[str, float]) -> Uncertain:
    """Sort standard errors {path: 1 σ} by what they are of; a time of a pulse or gate is that of its whole shape.

    Raises:
        InputError: a path that leads to no number of the rig.
    """
    data = {"rig": scene.model_dump(mode="json")["rig"]}
    shapes: dict[str, float] = {}
    values: dict[str, float] = {}
    for path, sigma in sigmas.items():
        node = held_at(data, path)
        shape = next((one for one in _SHAPES if path.startswith(f"{one}.")), None)
        if isinstance(node, bool) or not isinstance(node, int | float) or (shape is not None and not node):
            raise InputError(
                "An uncertainty is of no number of the rig.",
                where=f"uncertainty: {path}",
                value=node,
                allowed="the path of a number",
            )
        if shape is None:
            values[path] = sigma
        elif path.endswith("_s"):
            shapes[shape] = max(shapes.get(shape, 0.0), sigma / abs(float(node)))
    return Uncertain(shapes, values)


def perturbed(scene: Scene, uncertain: Uncertain, rng: np.random.Generator) -> Scene:
    """The scene with its uncertain values drawn anew.

    The standard error of a gain is that at a fixed excess noise factor: photon transfer measures gain × F², so that a greater
    F² comes with a smaller gain. Read noise and DSNU are measured in DN: what is drawn for the gain changes them inversely.
    """
    data = scene.model_dump(mode="json")
    changes: dict[str, Any] = {}
    for path, sigma in uncertain.values.items():
        changes[path] = held_at(data, path) + sigma * float(rng.standard_normal())
    if _EXCESS in changes:
        changes[_EXCESS] = max(changes[_EXCESS], 1.0)
        gain = changes.get(_GAIN, held_at(data, _GAIN))
        changes[_GAIN] = gain * held_at(data, _EXCESS) / changes[_EXCESS]
    relative = changes.get(_GAIN, held_at(data, _GAIN)) / held_at(data, _GAIN)
    for path in ("rig.detector.read_noise_e", "rig.detector.dsnu_e"):
        changes[path] = changes.get(path, held_at(data, path)) / relative
    for path in (
        "rig.detector.read_noise_e",
        "rig.detector.prnu",
        "rig.detector.dsnu_e",
        "rig.laser.energy_fluctuation",
    ):
        if path in changes:
            changes[path] = max(changes[path], 0.0)
    for path, sigma in uncertain.shapes.items():
        changes[path] = stretched(held_at(data, path), 1.0 + sigma * float(rng.standard_normal()))
    return load_scene(apply_overrides(data, changes)) if changes else scene
