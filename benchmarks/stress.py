"""Stress axes: a name and a level become changes of a scene.

An axis is one of those named here, or any path of the scene that holds a number (`rig.detector.read_noise_e`). Every
named axis says how its levels change the scene as plain overrides, so that what breaks an estimator can be written down
and repeated with `--set`. Levels of 1 on an axis that multiplies, and of 0 on one that adds, leave the scene as it is.
"""

from __future__ import annotations

import difflib
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from ..scenes.declare import group_index, phase_index
from ..scenes.errors import InputError
from ..scenes.load import load_scene
from ..scenes.overrides import apply_overrides
from ..scenes.scene import Scene

__all__ = ["AXES", "Axis", "axis_overrides", "axis_unit", "list_axes", "stressed"]

Overrides = dict[str, Any]


@dataclass(frozen=True)
class Axis:
    """A named stress.

    Main arguments:
        name, unit: as tables show them; unit "1" for ratios. what: one line for people.
        overrides: (scene, level) -> {path: value}. Raises InputError where the scene has nothing to change.
        neutral: the level that leaves a scene as it is, None where that depends on the scene.
    """

    name: str
    unit: str
    what: str
    overrides: Callable[[Scene, float], Overrides]
    neutral: float | None = None


def _kind(scene: Scene) -> str:
    return str(scene.rig.kind)


def _path(scene: Scene, axis: str, paths: Mapping[str, str]) -> str:
    """The path that an axis means on this kind of rig."""
    if _kind(scene) not in paths:
        raise _does_not_fit(scene, axis, f"scenes of kind {', '.join(sorted(paths))}")
    return paths[_kind(scene)]


def _does_not_fit(scene: Scene, axis: str, allowed: str) -> InputError:
    return InputError(f"The stress {axis!r} does not apply to this scene.", where=scene.name, allowed=allowed)


def _get(scene: Scene, path: str) -> Any:
    node: Any = scene.model_dump(mode="json")
    for part in path.split("."):
        node = node[int(part)] if isinstance(node, list) else node.get(part) if isinstance(node, dict) else None
    return node


def _multiply(axis: str, paths: Mapping[str, str]) -> Callable[[Scene, float], Overrides]:
    def change(scene: Scene, level: float) -> Overrides:
        path = _path(scene, axis, paths)
        value = _get(scene, path)
        if not isinstance(value, int | float):
            raise _does_not_fit(scene, axis, f"scenes with a number at {path}")
        return {path: value * level}

    return change


def _set(axis: str, paths: Mapping[str, str]) -> Callable[[Scene, float], Overrides]:
    return lambda scene, level: {_path(scene, axis, paths): level}


def _add(axis: str, paths: Mapping[str, str]) -> Callable[[Scene, float], Overrides]:
    def change(scene: Scene, level: float) -> Overrides:
        path = _path(scene, axis, paths)
        return {path: _get(scene, path) + level}

    return change


def _incidence(scene: Scene, level: float) -> Overrides:
    found = [i for i, item in enumerate(scene.target) if hasattr(item.shape, "tilt_y_deg")]
    if not found:
        raise _does_not_fit(scene, "incidence", "scenes with a rectangle or a height grid")
    return {f"target.{i}.shape.tilt_y_deg": level for i in found}


def _distance(scene: Scene, level: float) -> Overrides:
    changes: Overrides = {}
    for i, item in enumerate(scene.target):
        x, y, z = item.shape.center_m
        changes[f"target.{i}.shape.center_m"] = [x, y, z + level]
    return changes


def _delay_step(scene: Scene, level: float) -> Overrides:
    """The step times `level`, over the same span."""
    base, count = {"gated": ("rig.delays", "count"), "waveform": ("rig.record", "samples")}.get(_kind(scene), ("", ""))
    if not base:
        raise _does_not_fit(scene, "delay-step", "scenes of kind gated, waveform")
    step, number = _get(scene, f"{base}.step_s"), _get(scene, f"{base}.{count}")
    least = 1 if _kind(scene) == "gated" else 4
    return {f"{base}.step_s": step * level, f"{base}.{count}": max(least, 1 + int((number - 1) / level + 1e-9))}


def _declare(scene: Scene, path: str, value: Any) -> Overrides:
    """`declared` is one table whose keys are paths: it is replaced as a whole, with what it held before."""
    kept = {key: held for key, held in scene.declared.items() if not (key == path or key.startswith(path + "."))}
    return {"declared": {**kept, path: value}}


def _wrong_index(scene: Scene, level: float) -> Overrides:
    wavelength = scene.rig.laser.wavelength_m
    group = group_index(scene.medium, wavelength) * (1.0 + level)
    index = {"kind": "explicit", "phase": phase_index(scene.medium, wavelength), "group": group}
    return _declare(scene, "medium.index", index)


def _wrong_t0(scene: Scene, level: float) -> Overrides:
    return _declare(scene, "t0_s", scene.rig.t0_s + level)


def _wrong_pulse(scene: Scene, level: float) -> Overrides:
    pulse = getattr(scene.rig.laser, "pulse", None)
    for name in ("fwhm_s", "width_s"):
        if hasattr(pulse, name):
            return _declare(scene, f"laser.pulse.{name}", getattr(pulse, name) * (1.0 + level))
    raise _does_not_fit(scene, "wrong-pulse", "scenes whose pulse has one width (gaussian, rectangular, exponential)")


_LASER = {"gated": "rig.laser.pulse_energy_j", "waveform": "rig.laser.pulse_energy_j", "amcw": "rig.laser.power_w"}
_AMBIENT = dict.fromkeys(("gated", "waveform", "amcw"), "rig.ambient_e_per_s")
_READ = {
    "gated": "rig.detector.read_noise_e",
    "waveform": "rig.detector.readout.read_noise_e",
    "amcw": "rig.detector.read_noise_e",
}
_GAIN = {
    "gated": "rig.detector.gain_dn_per_e",
    "waveform": "rig.detector.readout.gain_dn_per_e",
    "amcw": "rig.detector.gain_dn_per_e",
}
_FLUCTUATION = {
    "gated": "rig.laser.energy_fluctuation",
    "waveform": "rig.laser.energy_fluctuation",
    "amcw": "rig.laser.power_fluctuation",
}
_JITTER = {"gated": "rig.laser.jitter_frame_s", "waveform": "rig.laser.jitter_shot_s"}
_SHOT_JITTER = {"gated": "rig.laser.jitter_shot_s", "waveform": "rig.laser.jitter_pulse_s"}
_START = {"gated": "rig.delays.start_s", "waveform": "rig.record.start_s"}
_WIDTH = {"gated": "rig.laser.pulse.fwhm_s", "waveform": "rig.laser.pulse.fwhm_s"}
_ABSORPTION = dict.fromkeys(("gated", "waveform", "amcw"), "medium.absorption_per_m")

#: The named axes.
AXES: dict[str, Axis] = {
    axis.name: axis
    for axis in (
        Axis("photons", "1", "signal photons, as a multiple of the scene's", _multiply("photons", _LASER), 1.0),
        Axis("background", "e/s", "ambient light per pixel with the gate open", _set("background", _AMBIENT)),
        Axis("incidence", "deg", "tilt of every flat object about the vertical", _incidence, 0.0),
        Axis("distance", "m", "how much farther all objects are, the window unmoved", _distance, 0.0),
        Axis("delay-step", "1", "delay step as a multiple of the scene's, over the same span", _delay_step, 1.0),
        Axis("window-start", "s", "how much later the delay scan starts", _add("window-start", _START), 0.0),
        Axis("pulse-width", "1", "pulse width as a multiple of the scene's", _multiply("pulse-width", _WIDTH), 1.0),
        Axis("jitter", "s", "timing jitter from slice to slice, rms", _set("jitter", _JITTER)),
        Axis("shot-jitter", "s", "timing jitter from pulse to pulse, rms", _set("shot-jitter", _SHOT_JITTER)),
        Axis("fluctuation", "1", "laser energy fluctuation, relative rms", _set("fluctuation", _FLUCTUATION)),
        Axis("read-noise", "e", "read noise, rms", _set("read-noise", _READ)),
        Axis("gain", "1", "gain in DN/e as a multiple of the scene's", _multiply("gain", _GAIN), 1.0),
        Axis("absorption", "1/m", "absorption of the medium", _set("absorption", _ABSORPTION)),
        Axis("wrong-index", "1", "relative error of the declared group index", _wrong_index, 0.0),
        Axis("wrong-t0", "s", "error of the declared time zero", _wrong_t0, 0.0),
        Axis("wrong-pulse", "1", "relative error of the declared pulse width", _wrong_pulse, 0.0),
    )
}

#: Units by the end of a path's last name; the longest that fits counts.
_UNITS = {
    "_e_per_s": "e/s", "_per_m": "1/m", "_dn_per_e": "DN/e", "_s": "s", "_m": "m", "_deg": "deg", "_rad": "rad",
    "_j": "J", "_w": "W", "_hz": "Hz", "_e": "e", "_dn": "DN", "_px": "px", "_c": "degC", "_psu": "psu", "_pa": "Pa",
    "_bits": "bit",
}  # fmt: skip


def list_axes() -> list[Axis]:
    """The named axes, by name."""
    return [AXES[name] for name in sorted(AXES)]


def axis_unit(axis: str) -> str:
    """The unit of an axis' levels: "1" for ratios and counts."""
    if axis in AXES:
        return AXES[axis].unit
    last = axis.rpartition(".")[2]
    fits = [end for end in _UNITS if last.endswith(end)]
    return _UNITS[max(fits, key=len)] if fits else "1"


def axis_overrides(scene: Scene, axis: str, level: float) -> Overrides:
    """What a level of an axis changes in the scene: {path: value}.

    Raises:
        InputError: neither a named axis nor a path of a number, or the scene has nothing that the axis changes.
    """
    if axis in AXES:
        return AXES[axis].overrides(scene, level)
    if "." not in axis:
        near = difflib.get_close_matches(axis, sorted(AXES), n=3)
        raise InputError(
            "There is no such stress.",
            where="axis",
            value=axis,
            allowed="a path such as rig.detector.read_noise_e, or one of: " + ", ".join(sorted(AXES)),
            next_step=f"did you mean {' or '.join(near)}?" if near else "",
        )
    held = _held(scene, axis)
    if isinstance(held, bool) or not isinstance(held, int | float | type(None)):
        raise InputError("A stress needs a path of a number.", where=axis, value=held)
    # Whole numbers stay whole: a path such as `pulses_per_slice` takes no fractions.
    return {axis: int(level) if isinstance(held, int) and float(level).is_integer() else level}


def _held(scene: Scene, path: str) -> Any:
    """The value at a path, None where the path's last key is new (validation then tells whether it may be)."""
    data = scene.model_dump(mode="json")
    head, _, last = path.rpartition(".")
    apply_overrides(data, {path: None})  # a path that leads nowhere is told with near matches
    node: Any = data
    for part in filter(None, head.split(".")):
        if isinstance(node, list):
            node = next((x for x in node if isinstance(x, dict) and x.get("name") == part), None) or node[int(part)]
        else:
            node = node[part]
    if isinstance(node, list):
        return node[int(last)]
    return node.get(last)


def stressed(scene: Scene, levels: Sequence[tuple[str, float]]) -> tuple[Scene, Overrides]:
    """The scene under several axes at once, applied in order, and all that was changed as one set of overrides.

    Raises:
        InputError: an axis that is unknown or does not fit, or a level that the scene's spec does not allow.
    """
    total: Overrides = {}
    for axis, level in levels:
        changes = axis_overrides(scene, axis, level)
        try:
            scene = load_scene(scene, changes)
        except InputError as error:
            raise InputError(
                f"The stress {axis!r} at {level:g} does not fit the scene {scene.name!r}: {error.what}",
                where=error.where,
                value=error.value,
                allowed=error.allowed,
                next_step=error.next_step,
            ) from error
        total.update(changes)
    return scene, total
