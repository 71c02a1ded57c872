"""The named stress axes, each of which changes a scene by plain overrides."""

from __future__ import annotations

import math
from dataclasses import dataclass

from ...optics.water.phase_forms import TabulatedPhase
from ...scenes.errors import InputError
from ...scenes.medium_index import group_index, phase_index
from ...scenes.scene import Scene
from .changes import (
    Change,
    DoesNotApply,
    Overrides,
    add,
    declare,
    held,
    multiply,
    objects,
    path_of,
    set_present,
    set_to,
    steps_of,
)

__all__ = ["AXES", "Axis"]


@dataclass(frozen=True)
class Axis:
    """A named stress.

    Main arguments:
        name, unit: name and unit in tables; unit "1" for ratios. what: description in one line.
        change: (scene, level) -> {path: value}. Raises DoesNotApply if the scene has nothing to change.
        neutral: the level that leaves a scene unchanged; None if it depends on the scene.
    """

    name: str
    unit: str
    what: str
    change: Change
    neutral: float | None = None

    def overrides(self, scene: Scene, level: float) -> Overrides:
        """The changes of a scene at a level, {path: value}. Raises InputError if the scene has nothing to change."""
        try:
            return self.change(scene, level)
        except DoesNotApply as error:
            raise InputError(
                f"The stress {self.name!r} does not apply to this scene.", where=scene.name, allowed=error.allowed
            ) from error


def _incidence(scene: Scene, level: float) -> Overrides:
    flat = [i for i, item in enumerate(scene.target) if hasattr(item.shape, "tilt_y_deg")]
    if not flat:
        raise DoesNotApply("scenes with a rectangle or a height grid")
    return {f"target.{i}.shape.tilt_y_deg": level for i in flat}


def _turn(scene: Scene, level: float) -> Overrides:
    """Turn flat objects about the vertical by `level` more than they are."""
    tilts = {i: getattr(item.shape, "tilt_y_deg", None) for i, item in enumerate(scene.target)}
    flat = {i: tilt for i, tilt in tilts.items() if tilt is not None}
    if not flat:
        raise DoesNotApply("scenes with a rectangle or a height grid")
    return {f"target.{i}.shape.tilt_y_deg": tilt + level for i, tilt in flat.items()}


def _distance(scene: Scene, level: float) -> Overrides:
    changes: Overrides = {}
    for i, item in enumerate(objects(scene)):
        x, y, z = item.shape.center_m
        changes[f"target.{i}.shape.center_m"] = [x, y, z + level]
    return changes


def _delay_step(scene: Scene, level: float) -> Overrides:
    """Multiply the step by `level`, over the same span."""
    steps = steps_of(scene, "sampling")
    if held(scene, steps.step) is None or held(scene, steps.count) is None:
        raise DoesNotApply(f"scenes with even samples in time ({steps.step})")
    number = 1 + int((held(scene, steps.count) - 1) / level + 1e-9)
    return {steps.step: held(scene, steps.step) * level, steps.count: max(steps.least, number)}


def _wrong_index(scene: Scene, level: float) -> Overrides:
    wavelength = scene.rig.wavelength_m
    group = group_index(scene.medium, wavelength) * (1.0 + level)
    index = {"kind": "explicit", "phase": phase_index(scene.medium, wavelength), "group": group}
    return declare(scene, "medium.index", index)


def _wrong_phase_index(scene: Scene, level: float) -> Overrides:
    """Declare a phase index, which bends rays, that is wrong; the group index stays."""
    wavelength = scene.rig.wavelength_m
    phase = phase_index(scene.medium, wavelength) * (1.0 + level)
    index = {"kind": "explicit", "phase": phase, "group": group_index(scene.medium, wavelength)}
    return declare(scene, "medium.index", index)


def _wrong_stand_off(scene: Scene, level: float) -> Overrides:
    path = path_of(scene, "stand-off")
    value = held(scene, path)
    if value is None:
        raise DoesNotApply(f"scenes that give {path}")
    return declare(scene, path, value + level)


def _wrong_baseline(scene: Scene, level: float) -> Overrides:
    """Declare the light's source `level` m farther from the camera than it is, in the same direction."""
    path = path_of(scene, "baseline")
    place = held(scene, path)
    length = math.hypot(*place)
    if length == 0.0:
        raise DoesNotApply("scenes whose light stands apart from the camera")
    return declare(scene, path, [value * (1.0 + level / length) for value in place])


#: Scattering coefficient per turbidity, 1/(m NTU): "by a convenient coincidence, about 1" in turbid waters (J. T. O. Kirk, Light
#: and Photosynthesis in Aquatic Ecosystems, ch. 4, on nephelometers). It differs between waters and instruments; none is exact.
_SCATTERING_PER_NTU = 1.0


def _turbidity(scene: Scene, level: float) -> Overrides:
    """Set b to the turbidity times 1/(m NTU); absorption and phase function are unchanged."""
    if scene.medium.phase is None:
        raise DoesNotApply("scenes in a medium that scatters, with its phase function")
    return {"medium": _water(scene, scene.medium.absorption_per_m, _SCATTERING_PER_NTU * level)}


def _wrong_t0(scene: Scene, level: float) -> Overrides:
    return declare(scene, "t0_s", scene.rig.t0_s + level)


#: Names of the width of a pulse or gate that has only one.
_WIDTHS = ("fwhm_s", "width_s")


def _wrong_pulse(scene: Scene, level: float) -> Overrides:
    path = path_of(scene, "pulse")
    pulse = held(scene, path)
    for name in _WIDTHS:
        if name in pulse:
            return declare(scene, f"{path}.{name}", pulse[name] * (1.0 + level))
    raise DoesNotApply("scenes whose pulse has one width (gaussian, rectangular, exponential)")


def _wrong_gate(scene: Scene, level: float) -> Overrides:
    path = path_of(scene, "gates")
    changes: Overrides = {}
    for number, gate in enumerate(held(scene, path)):
        name = next((name for name in _WIDTHS if name in gate), None)
        if name is None:
            raise DoesNotApply("gates of one width (all but sampled ones)")
        changes[f"{path.removeprefix('rig.')}.{number}.{name}"] = gate[name] * (1.0 + level)
    kept = {key: value for key, value in scene.declared.items() if key not in changes}
    return {"declared": kept | changes}


def _wrong_pitch(scene: Scene, level: float) -> Overrides:
    path = path_of(scene, "pitch")
    return declare(scene, path, held(scene, path) * (1.0 + level))


def _attenuation_lengths(scene: Scene, level: float) -> Overrides:
    """Scale a and b together, so that c·z = level at the farthest object; the phase function is unchanged."""
    medium = scene.medium
    if medium.attenuation_per_m == 0.0:
        raise DoesNotApply("scenes in a medium that attenuates")
    farthest = max(item.shape.center_m[2] for item in objects(scene))
    factor = level / (medium.attenuation_per_m * farthest)
    return {"medium": _water(scene, medium.absorption_per_m * factor, medium.scattering_per_m * factor)}


def _water(scene: Scene, absorption_per_m: float, scattering_per_m: float) -> Overrides:
    """The scene's medium with other coefficients and the same phase function."""
    medium = scene.medium
    data = medium.model_dump(mode="json")
    data.pop("water_type", None)
    data["absorption_per_m"] = absorption_per_m
    data["scattering_per_m"] = scattering_per_m
    phase = medium.phase
    if "phase_function" not in data and phase is not None:
        if not isinstance(phase, TabulatedPhase):
            raise DoesNotApply("waters with a tabulated or given phase function")
        data["phase_function"] = {
            "kind": "tabulated", "angle_rad": list(phase.angle_rad), "value": list(phase.value),
            "forward_slope": phase.forward_slope,
        }  # fmt: skip
    return data


def _specular(scene: Scene, level: float) -> Overrides:
    """Move the fraction `level` of every object's albedo into a specular lobe; the albedo is unchanged."""
    if not 0.0 <= level <= 1.0:
        raise DoesNotApply("shares 0 … 1")
    changes: Overrides = {}
    for number, item in enumerate(objects(scene)):
        material = item.material.with_lobe(level)
        if material is None:
            raise DoesNotApply(
                "scenes whose materials all have a form with a specular lobe (such as Lambert and Phong)"
            )
        changes[f"target.{number}.material"] = material.model_dump(mode="json")
    return changes


def _motion(scene: Scene, level: float) -> Overrides:
    return {path_of(scene, "motion"): [0.0, 0.0, level]}


def _screen(scene: Scene, **changes: float) -> Overrides:
    """Change a value of the scene's screen."""
    path = path_of(scene, "screen")
    screen = held(scene, path)
    if screen is None:
        raise DoesNotApply(f"scenes with a screen ({path})")
    return {path: {**screen, **changes}}


def _screen_coverage(scene: Scene, level: float) -> Overrides:
    return _screen(scene, coverage=level)


def _screen_gap(scene: Scene, level: float) -> Overrides:
    nearest = min(item.shape.center_m[2] for item in objects(scene))
    if not level < nearest or math.isnan(level):
        raise DoesNotApply(f"gaps below {nearest:g} m")
    return _screen(scene, distance_m=nearest - level)


#: The named axes.
AXES: dict[str, Axis] = {
    axis.name: axis
    for axis in (
        Axis("photons", "1", "signal photons, as a multiple of the scene's", multiply("light"), 1.0),
        Axis("background", "e/s", "ambient light per pixel with the gate open", set_to("ambient")),
        Axis("incidence", "deg", "tilt of every flat object about the vertical", _incidence, 0.0),
        Axis("distance", "m", "distance by which all objects are moved away, with the same window", _distance, 0.0),
        Axis("turn", "deg", "angle by which every flat object is turned about the vertical", _turn, 0.0),
        Axis("delay-step", "1", "delay step as a multiple of the scene's, over the same span", _delay_step, 1.0),
        Axis("window-start", "s", "time by which the delay scan starts later", add("start"), 0.0),
        Axis("pulse-width", "1", "pulse width as a multiple of the scene's", multiply("pulse-width"), 1.0),
        Axis("jitter", "s", "timing jitter from slice to slice, rms", set_to("jitter")),
        Axis("shot-jitter", "s", "timing jitter from pulse to pulse, rms", set_to("shot-jitter")),
        Axis("fluctuation", "1", "laser energy fluctuation, relative rms", set_to("fluctuation")),
        Axis("read-noise", "e", "read noise, rms", set_to("read-noise")),
        Axis("gain", "1", "gain in DN/e as a multiple of the scene's", multiply("gain"), 1.0),
        Axis("absorption", "1/m", "absorption of the medium", lambda _, level: {"medium.absorption_per_m": level}),
        Axis("wrong-index", "1", "relative error of the declared group index", _wrong_index, 0.0),
        Axis("wrong-phase-index", "1", "relative error of the declared phase index", _wrong_phase_index, 0.0),
        Axis("wrong-stand-off", "m", "error of the declared stand-off of the camera's window", _wrong_stand_off, 0.0),
        Axis("wrong-baseline", "m", "error of the declared distance of the light's source", _wrong_baseline, 0.0),
        Axis("wrong-t0", "s", "error of the declared time zero", _wrong_t0, 0.0),
        Axis("wrong-pulse", "1", "relative error of the declared pulse width", _wrong_pulse, 0.0),
        Axis("wrong-gate", "1", "relative error of the declared gate width", _wrong_gate, 0.0),
        Axis("wrong-pitch", "1", "relative error of the declared distance of the lenslets", _wrong_pitch, 0.0),
        Axis("attenuation-lengths", "1", "c·z at the farthest object, a and b scaled together", _attenuation_lengths),
        Axis("turbidity", "NTU", "scattering of 1/m per NTU (Kirk), absorption unchanged", _turbidity),
        Axis("specular", "1", "fraction of the albedo in a specular lobe", _specular),
        Axis("full-well", "1", "full well as a multiple of the scene's", multiply("full-well"), 1.0),
        Axis("motion", "m/s", "the platform's approach between slices", _motion),
        Axis("phosphor", "px", "spread of the intensifier's phosphor, 1 σ", set_present("phosphor")),
        Axis(
            "screen-coverage",
            "1",
            "fraction of each pixel covered by a screen in front of the target",
            _screen_coverage,
        ),
        Axis("screen-gap", "m", "distance of the screen from the nearest object", _screen_gap),
    )
}
