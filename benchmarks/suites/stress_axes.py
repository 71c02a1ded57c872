"""The named stress axes: how each changes a scene, as plain overrides."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from ...optics.water.phase_forms import TabulatedPhase
from ...scenes.errors import InputError
from ...scenes.materials import Lambert, Phong
from ...scenes.medium_index import group_index, phase_index
from ...scenes.rigs import RIGS, rig_kind
from ...scenes.rigs.roles import Role, Steps
from ...scenes.scene import Scene, TargetObject

__all__ = ["AXES", "Axis", "Overrides"]

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


def _role(scene: Scene, axis: str, role: str) -> Role:
    """What the scene's kind of rig says of a role. Raises InputError where it has none."""
    roles = rig_kind(scene.modality).roles
    if role not in roles:
        fitting = [name for name in RIGS if role in rig_kind(name).roles]
        raise _does_not_fit(scene, axis, f"scenes with a rig of kind {', '.join(fitting)}")
    return roles[role]


def _path(scene: Scene, axis: str, role: str) -> str:
    """The path of a role that is one value of the scene."""
    path = _role(scene, axis, role)
    assert isinstance(path, str), role
    return path


def _does_not_fit(scene: Scene, axis: str, allowed: str) -> InputError:
    return InputError(f"The stress {axis!r} does not apply to this scene.", where=scene.name, allowed=allowed)


def _get(scene: Scene, path: str) -> Any:
    node: Any = scene.model_dump(mode="json")
    for part in path.split("."):
        node = node[int(part)] if isinstance(node, list) else node.get(part) if isinstance(node, dict) else None
    return node


def _multiply(axis: str, role: str) -> Callable[[Scene, float], Overrides]:
    def change(scene: Scene, level: float) -> Overrides:
        path = _path(scene, axis, role)
        value = _get(scene, path)
        if not isinstance(value, int | float):
            raise _does_not_fit(scene, axis, f"scenes with a number at {path}")
        return {path: value * level}

    return change


def _set(axis: str, role: str) -> Callable[[Scene, float], Overrides]:
    return lambda scene, level: {_path(scene, axis, role): level}


def _set_present(axis: str, role: str) -> Callable[[Scene, float], Overrides]:
    """Set a value that belongs to an option of the rig, which the scene must have."""

    def change(scene: Scene, level: float) -> Overrides:
        path = _path(scene, axis, role)
        if _get(scene, path) is None:
            raise _does_not_fit(scene, axis, f"scenes that give {path.rpartition('.')[0]}")
        return {path: level}

    return change


def _add(axis: str, role: str) -> Callable[[Scene, float], Overrides]:
    def change(scene: Scene, level: float) -> Overrides:
        path = _path(scene, axis, role)
        return {path: _get(scene, path) + level}

    return change


def _objects(scene: Scene, axis: str) -> tuple[TargetObject, ...]:
    """The objects of the target. Raises InputError where there are none."""
    if not scene.target:
        raise _does_not_fit(scene, axis, "scenes with an object in the target")
    return scene.target


def _incidence(scene: Scene, level: float) -> Overrides:
    found = [i for i, item in enumerate(scene.target) if hasattr(item.shape, "tilt_y_deg")]
    if not found:
        raise _does_not_fit(scene, "incidence", "scenes with a rectangle or a height grid")
    return {f"target.{i}.shape.tilt_y_deg": level for i in found}


def _distance(scene: Scene, level: float) -> Overrides:
    changes: Overrides = {}
    for i, item in enumerate(_objects(scene, "distance")):
        x, y, z = item.shape.center_m
        changes[f"target.{i}.shape.center_m"] = [x, y, z + level]
    return changes


def _delay_step(scene: Scene, level: float) -> Overrides:
    """The step times `level`, over the same span."""
    steps = _role(scene, "delay-step", "sampling")
    assert isinstance(steps, Steps)
    number = 1 + int((_get(scene, steps.count) - 1) / level + 1e-9)
    return {steps.step: _get(scene, steps.step) * level, steps.count: max(steps.least, number)}


def _declare(scene: Scene, path: str, value: Any) -> Overrides:
    """`declared` is one table whose keys are paths: it is replaced as a whole, with what it held before."""
    kept = {key: held for key, held in scene.declared.items() if not (key == path or key.startswith(path + "."))}
    return {"declared": {**kept, path: value}}


def _wrong_index(scene: Scene, level: float) -> Overrides:
    wavelength = scene.rig.wavelength_m
    group = group_index(scene.medium, wavelength) * (1.0 + level)
    index = {"kind": "explicit", "phase": phase_index(scene.medium, wavelength), "group": group}
    return _declare(scene, "medium.index", index)


def _wrong_t0(scene: Scene, level: float) -> Overrides:
    return _declare(scene, "t0_s", scene.rig.t0_s + level)


#: Names under which a pulse or gate may hold its one width.
_WIDTHS = ("fwhm_s", "width_s")


def _of_rig(path: str) -> str:
    """A scene's path of the rig as `declared` names it."""
    return path.removeprefix("rig.")


def _wrong_pulse(scene: Scene, level: float) -> Overrides:
    path = _path(scene, "wrong-pulse", "pulse")
    pulse = _get(scene, path)
    for name in _WIDTHS:
        if name in pulse:
            return _declare(scene, f"{_of_rig(path)}.{name}", pulse[name] * (1.0 + level))
    raise _does_not_fit(scene, "wrong-pulse", "scenes whose pulse has one width (gaussian, rectangular, exponential)")


def _wrong_gate(scene: Scene, level: float) -> Overrides:
    path = _path(scene, "wrong-gate", "gates")
    changes: Overrides = {}
    for number, gate in enumerate(_get(scene, path)):
        name = next((name for name in _WIDTHS if name in gate), None)
        if name is None:
            raise _does_not_fit(scene, "wrong-gate", "gates of one width (all but sampled ones)")
        changes[f"{_of_rig(path)}.{number}.{name}"] = gate[name] * (1.0 + level)
    kept = {key: held for key, held in scene.declared.items() if key not in changes}
    return {"declared": {**kept, **changes}}


def _attenuation_lengths(scene: Scene, level: float) -> Overrides:
    """a and b scaled together, so that c·z = level at the farthest object; the phase function is kept."""
    medium = scene.medium
    if medium.attenuation_per_m == 0.0:
        raise _does_not_fit(scene, "attenuation-lengths", "scenes in a medium that attenuates")
    farthest = max(item.shape.center_m[2] for item in _objects(scene, "attenuation-lengths"))
    factor = level / (medium.attenuation_per_m * farthest)
    data = medium.model_dump(mode="json")
    data.pop("water_type", None)
    data["absorption_per_m"] = medium.absorption_per_m * factor
    data["scattering_per_m"] = medium.scattering_per_m * factor
    phase = medium.phase
    if "phase_function" not in data and phase is not None:
        if not isinstance(phase, TabulatedPhase):
            raise _does_not_fit(scene, "attenuation-lengths", "waters with a tabulated or given phase function")
        data["phase_function"] = {
            "kind": "tabulated", "angle_rad": list(phase.angle_rad), "value": list(phase.value),
            "forward_slope": phase.forward_slope,
        }  # fmt: skip
    return {"medium": data}


#: Exponent of the lobe that diffuse matter gets: half its light within 12 degrees of the mirror direction.
_LOBE = 30.0


def _specular(scene: Scene, level: float) -> Overrides:
    """The share `level` of every object's albedo goes into a Phong lobe; the albedo stays."""
    changes: Overrides = {}
    for number, item in enumerate(_objects(scene, "specular")):
        material = item.material
        if isinstance(material, Lambert):
            albedo, exponent = material.albedo, _LOBE
        elif isinstance(material, Phong):
            albedo, exponent = material.diffuse_albedo + material.specular_albedo, material.exponent
        else:
            raise _does_not_fit(scene, "specular", "scenes of Lambert or Phong matter")
        changes[f"target.{number}.material"] = {
            "kind": "phong", "diffuse_albedo": albedo * (1.0 - level), "specular_albedo": albedo * level,
            "exponent": exponent,
        }  # fmt: skip
    return changes


def _motion(scene: Scene, level: float) -> Overrides:
    return {_path(scene, "motion", "motion"): [0.0, 0.0, level]}


def _screen(scene: Scene, axis: str, **changes: float) -> Overrides:
    """The scene's screen, changed."""
    path = _path(scene, axis, "screen")
    screen = _get(scene, path)
    if screen is None:
        raise _does_not_fit(scene, axis, f"scenes with a screen ({path})")
    return {path: {**screen, **changes}}


def _screen_coverage(scene: Scene, level: float) -> Overrides:
    return _screen(scene, "screen-coverage", coverage=level)


def _screen_gap(scene: Scene, level: float) -> Overrides:
    nearest = min(item.shape.center_m[2] for item in _objects(scene, "screen-gap"))
    if not level < nearest or math.isnan(level):
        raise _does_not_fit(scene, "screen-gap", f"gaps below {nearest:g} m")
    return _screen(scene, "screen-gap", distance_m=nearest - level)


#: The named axes.
AXES: dict[str, Axis] = {
    axis.name: axis
    for axis in (
        Axis("photons", "1", "signal photons, as a multiple of the scene's", _multiply("photons", "light"), 1.0),
        Axis("background", "e/s", "ambient light per pixel with the gate open", _set("background", "ambient")),
        Axis("incidence", "deg", "tilt of every flat object about the vertical", _incidence, 0.0),
        Axis("distance", "m", "how much farther all objects are, the window unmoved", _distance, 0.0),
        Axis("delay-step", "1", "delay step as a multiple of the scene's, over the same span", _delay_step, 1.0),
        Axis("window-start", "s", "how much later the delay scan starts", _add("window-start", "start"), 0.0),
        Axis(
            "pulse-width", "1", "pulse width as a multiple of the scene's", _multiply("pulse-width", "pulse-width"), 1.0
        ),
        Axis("jitter", "s", "timing jitter from slice to slice, rms", _set("jitter", "jitter")),
        Axis("shot-jitter", "s", "timing jitter from pulse to pulse, rms", _set("shot-jitter", "shot-jitter")),
        Axis("fluctuation", "1", "laser energy fluctuation, relative rms", _set("fluctuation", "fluctuation")),
        Axis("read-noise", "e", "read noise, rms", _set("read-noise", "read-noise")),
        Axis("gain", "1", "gain in DN/e as a multiple of the scene's", _multiply("gain", "gain"), 1.0),
        Axis("absorption", "1/m", "absorption of the medium", lambda _, level: {"medium.absorption_per_m": level}),
        Axis("wrong-index", "1", "relative error of the declared group index", _wrong_index, 0.0),
        Axis("wrong-t0", "s", "error of the declared time zero", _wrong_t0, 0.0),
        Axis("wrong-pulse", "1", "relative error of the declared pulse width", _wrong_pulse, 0.0),
        Axis("wrong-gate", "1", "relative error of the declared gate width", _wrong_gate, 0.0),
        Axis("attenuation-lengths", "1", "c·z at the farthest object, a and b scaled alike", _attenuation_lengths),
        Axis("specular", "1", "share of the albedo in a mirror-like lobe", _specular),
        Axis("full-well", "1", "full well as a multiple of the scene's", _multiply("full-well", "full-well"), 1.0),
        Axis("motion", "m/s", "the platform's approach between slices", _motion),
        Axis("phosphor", "px", "spread of the intensifier's phosphor, 1 σ", _set_present("phosphor", "phosphor")),
        Axis("screen-coverage", "1", "share of each pixel that a screen before the target covers", _screen_coverage),
        Axis("screen-gap", "m", "how far before the nearest object the screen stands", _screen_gap),
    )
}
