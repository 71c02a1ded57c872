"""The named stress axes: how each changes a scene, as plain overrides."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

from ...optics.water.phase_forms import TabulatedPhase
from ...scenes.errors import InputError
from ...scenes.materials import Lambert, Phong
from ...scenes.medium_index import group_index, phase_index
from ...scenes.scene import Scene

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
    wavelength = scene.rig.wavelength_m
    group = group_index(scene.medium, wavelength) * (1.0 + level)
    index = {"kind": "explicit", "phase": phase_index(scene.medium, wavelength), "group": group}
    return _declare(scene, "medium.index", index)


def _wrong_t0(scene: Scene, level: float) -> Overrides:
    return _declare(scene, "t0_s", scene.rig.t0_s + level)


def _wrong_pulse(scene: Scene, level: float) -> Overrides:
    pulse = getattr(getattr(scene.rig, "laser", None), "pulse", None)
    for name in ("fwhm_s", "width_s"):
        if hasattr(pulse, name):
            return _declare(scene, f"laser.pulse.{name}", getattr(pulse, name) * (1.0 + level))
    raise _does_not_fit(scene, "wrong-pulse", "scenes whose pulse has one width (gaussian, rectangular, exponential)")


def _wrong_gate(scene: Scene, level: float) -> Overrides:
    gates = getattr(scene.rig, "gates", ())
    changes: Overrides = {}
    for number, gate in enumerate(gates):
        name = next((name for name in ("fwhm_s", "width_s") if hasattr(gate, name)), None)
        if name is None:
            raise _does_not_fit(scene, "wrong-gate", "gates of one width (all but sampled ones)")
        changes[f"gates.{number}.{name}"] = getattr(gate, name) * (1.0 + level)
    if not changes:
        raise _does_not_fit(scene, "wrong-gate", "scenes of kind gated")
    kept = {key: held for key, held in scene.declared.items() if key not in changes}
    return {"declared": {**kept, **changes}}


def _attenuation_lengths(scene: Scene, level: float) -> Overrides:
    """a and b scaled together, so that c·z = level at the farthest object; the phase function is kept."""
    medium = scene.medium
    if medium.attenuation_per_m == 0.0:
        raise _does_not_fit(scene, "attenuation-lengths", "scenes in a medium that attenuates")
    farthest = max(item.shape.center_m[2] for item in scene.target)
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
    for number, item in enumerate(scene.target):
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
    if _kind(scene) != "gated":
        raise _does_not_fit(scene, "motion", "scenes of kind gated")
    return {"rig.motion_m_per_s": [0.0, 0.0, level]}


def _phosphor(scene: Scene, level: float) -> Overrides:
    if getattr(getattr(scene.rig, "detector", None), "intensifier", None) is None:
        raise _does_not_fit(scene, "phosphor", "scenes with an image intensifier (rig.detector.intensifier)")
    return {"rig.detector.intensifier.phosphor_sigma_px": level}


def _screen(scene: Scene, axis: str) -> Mapping[str, Any]:
    if _get(scene, "rig.screen") is None:
        raise _does_not_fit(scene, axis, "scenes with a screen (rig.screen)")
    return dict(_get(scene, "rig.screen"))


def _screen_coverage(scene: Scene, level: float) -> Overrides:
    return {"rig.screen": {**_screen(scene, "screen-coverage"), "coverage": level}}


def _screen_gap(scene: Scene, level: float) -> Overrides:
    nearest = min(item.shape.center_m[2] for item in scene.target)
    if not level < nearest or math.isnan(level):
        raise _does_not_fit(scene, "screen-gap", f"gaps below {nearest:g} m")
    return {"rig.screen": {**_screen(scene, "screen-gap"), "distance_m": nearest - level}}


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
_WELL = {"gated": "rig.detector.full_well_e"}
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
        Axis("wrong-gate", "1", "relative error of the declared gate width", _wrong_gate, 0.0),
        Axis("attenuation-lengths", "1", "c·z at the farthest object, a and b scaled alike", _attenuation_lengths),
        Axis("specular", "1", "share of the albedo in a mirror-like lobe", _specular),
        Axis("full-well", "1", "full well as a multiple of the scene's", _multiply("full-well", _WELL), 1.0),
        Axis("motion", "m/s", "the platform's approach between slices", _motion),
        Axis("phosphor", "px", "spread of the intensifier's phosphor, 1 σ", _phosphor),
        Axis("screen-coverage", "1", "share of each pixel that a screen before the target covers", _screen_coverage),
        Axis("screen-gap", "m", "how far before the nearest object the screen stands", _screen_gap),
    )
}
