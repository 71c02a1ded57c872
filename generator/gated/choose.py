"""The choice between rungs: model no more than a scene needs.

Each rung's error for this scene and rig is predicted before rendering: zero in closed form where nothing can be left out,
else by a pilot, the full rung at low resolution with the same field of view. The error is that of the fidelity rule,
ε² = Σ(X − R₁)(X − R₂)/ΣR₁R₂, with two independent halves of the pilot as R₁ and R₂: the pilot's own noise drops out, and
paths are added until the interval of every cheaper rung's error lies on one side of the limit.
"""

from __future__ import annotations

import numpy as np

from ...scenes.errors import InputError
from ...scenes.rigs.gated import gated_rig
from ...scenes.scene import Scene
from ..choice import Choice, Rtol, Rung, chosen
from ..effect import interreflection
from .direct import render_direct
from .error import relative_noise
from .finite_size import finite_size, is_finite
from .full import SAMPLING
from .pilot import Pilot, Traced, cheap_stacks, pilot_scene

__all__ = ["choose"]

#: Rungs below the full one, from the cheapest.
_CHEAPER: tuple[Rung, ...] = ("direct", "scatter")
#: A rung whose interval still holds the limit when the paths are used up passes below this share of it.
_MARGIN = 0.85
#: Bias of the answer that passes where the limit is the noise, the share of it that a prediction may take, and the share of the
#: noise that sampling may: the answer of one pixel takes all slices' errors together.
_TASK_LIMIT = 0.1
_TASK_MARGIN = 0.8
_NOISE_SHARE = 0.06


def choose(scene: Scene, rtol: Rtol, seed: int, capture_key: int) -> Choice:
    """The cheapest rung whose predicted error is below `rtol`; where none is, the one with the smallest.

    Main arguments:
        scene: what is rendered.
        rtol: a fraction of the stack (rms), or "noise": below one standard deviation of the detector's noise (rms), and a task
            error below a tenth of the bound.
        seed, capture_key: name the pilot's random numbers.

    Raises:
        InputError: as the full rung does; a medium that scatters needs a phase function; a rig that only the direct rung
            models and that needs more.
    """
    size, basis = interreflection(scene)
    finite, how = _finite(scene)
    if scene.medium.scattering_per_m == 0 and size == 0.0 and finite > 0.0:
        return _by_size(scene, rtol, finite, how)
    if scene.medium.scattering_per_m == 0 and size == 0.0:
        if isinstance(rtol, float):
            return chosen("direct", {"direct": 0.0}, rtol, rtol, basis, {"interreflection": 0.0}, {})
        light = cheap_stacks(pilot_scene(scene))["direct"].astype(float)
        area = gated_rig(pilot_scene(scene)).camera.pixel_pitch_m / gated_rig(scene).camera.pixel_pitch_m
        limit = relative_noise(scene, light / area**2)
        return chosen(
            "direct", {"direct": 0.0}, limit, _NOISE_SHARE * limit, basis, {"interreflection": 0.0}, {"direct": 0.0}
        )
    pilot = Pilot(scene, seed, capture_key, finite)
    traced, limit = _enough(pilot, rtol)
    noise = rtol == "noise"
    sampled = max(_NOISE_SHARE * limit, 5e-4) if noise else limit
    predicted = {name: error for name, (error, _, _) in traced.errors.items()}
    # The full rung is traced until its error meets the limit, or its paths are used up.
    predicted["full"] = max(SAMPLING * sampled, traced.full)
    passing = [name for name in _CHEAPER if name in traced.errors and _passes(traced, name, limit, noise)]
    rung: Rung = passing[0] if passing else "full"
    if not passing and predicted["full"] > limit:
        # Where the tracer cannot reach the limit either, the rung nearest to it is taken.
        rung = min((*_CHEAPER, "full"), key=lambda name: predicted.get(name, np.inf))
    _only_direct(scene, rung, predicted, limit)
    sizes = _sizes(pilot, traced, size, 0.3 * limit)
    used = f"pilot of {pilot.shape[0]}×{pilot.shape[1]} pixels, {traced.paths} paths each"
    used += f"; {how}" if finite else ""
    return chosen(rung, predicted, limit, sampled, used, sizes, traced.task if noise else {})


def _finite(scene: Scene) -> tuple[float, str]:
    """What finite lens and lamp change of the direct light at full resolution, and the basis of that number."""
    return finite_size(scene, render_direct(scene, 1e-2)) if is_finite(scene) else (0.0, "")


def _by_size(scene: Scene, rtol: Rtol, finite: float, how: str) -> Choice:
    """The choice where finite lens and lamp are all that one bounce leaves out."""
    small = pilot_scene(scene)
    light = cheap_stacks(small)["direct"].astype(float)
    area = gated_rig(small).camera.pixel_pitch_m / gated_rig(scene).camera.pixel_pitch_m
    limit = relative_noise(scene, light / area**2) if rtol == "noise" else float(rtol)
    task = {"direct": finite / limit * float(np.sqrt(len(light))), "full": 0.0} if rtol == "noise" else {}
    passes = finite <= _MARGIN * limit and task.get("direct", 0.0) <= _TASK_MARGIN * _TASK_LIMIT
    rung: Rung = "direct" if passes else "full"
    sampled = max(_NOISE_SHARE * limit, 5e-4) if rtol == "noise" else limit
    predicted = {"direct": finite, "full": SAMPLING * sampled}
    _only_direct(scene, rung, predicted, limit)
    return chosen(rung, predicted, limit, sampled, how, {"interreflection": 0.0}, task)


def _enough(pilot: Pilot, rtol: Rtol) -> tuple[Traced, float]:
    """Trace until every rung's error is decided; the last round, and the limit."""
    traced, limit = None, 0.0
    aim = 0.01 if rtol == "noise" else float(rtol)
    for traced in pilot.rounds(0.2 * aim, SAMPLING * aim, rtol == "noise"):
        limit = traced.noise if rtol == "noise" else float(rtol)
        decided = all(high <= limit or low > limit for _, low, high in traced.errors.values())
        if decided and (rtol != "noise" or _task_decided(traced)):
            break
    assert traced is not None
    return traced, limit


def _task_decided(traced: Traced) -> bool:
    """Whether the task error of each rung is on one side of its limit, as uncertain as the rung's error is."""
    limit = _TASK_MARGIN * _TASK_LIMIT
    sides = [
        (traced.task[name] * low, traced.task[name] * high, error * limit)
        for name, (error, low, high) in traced.errors.items()
    ]
    return all(high <= border or low > border for low, high, border in sides)


def _passes(traced: Traced, name: str, limit: float, noise: bool) -> bool:
    error, low, high = traced.errors[name]
    fits = high <= limit or (low <= limit and error <= _MARGIN * limit)
    if not noise:
        return fits
    # Where the paths do not settle it, the upper end of the interval decides: the answer's bias is what the limit is about.
    task = traced.task[name]
    return fits and task <= _TASK_MARGIN * _TASK_LIMIT and task * high <= _TASK_LIMIT * error


def _sizes(pilot: Pilot, traced: Traced, closed_form: float | None, goal: float) -> dict[str, float]:
    """Sizes of effects by the pilot."""
    if pilot.scene.medium.scattering_per_m == 0:
        return {"interreflection": traced.errors["direct"][0]}
    return {"interreflection": 0.0 if closed_form == 0.0 else pilot.interreflection(goal)}


def _only_direct(scene: Scene, rung: str, predicted: dict[str, float], limit: float) -> None:
    """Refuse a rig that moves or has a screen, and needs more than the one rung that models these."""
    rig = gated_rig(scene)
    given = [name for name in ("motion_m_per_s", "screen") if getattr(rig, name) is not None]
    if given and rung != "direct":
        raise InputError(
            f"This is modelled by the direct rung only, whose error of {predicted['direct']:.2g} is above the limit of "
            f"{limit:.2g}.",
            where=f"{scene.name}: rig.{given[0]}", value=rung, next_step='raise rtol, or give fidelity="direct"',
        )  # fmt: skip
