"""Design of a Shack-Hartmann sensor: pitch and focal length of its lenslets, behind the same pupil and before the same camera.

Every design is generated and read by `READER`; what is counted is the rms error of the phase over the pupil. The bound of
`bounds.wavefront` is no guide here: it is that of the reconstructed modes alone and of every lenslet, so that a wide pitch looked
twice as good as it was behind strong turbulence, whose other modes alias. A longer focal length moves spots farther per slope and
widens them: the guard is the share of spots that would stay within half a pitch of their place, beyond which they are another
lenslet's, if slopes were half as great again. A wider pitch gathers more light per spot and has fewer of them.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from typing import Any

import numpy as np
import xarray as xr

from ...scenes.errors import InputError
from ...scenes.load import load_scene
from ...scenes.rigs.wavefront import wavefront_rig
from ...scenes.scene import Scene
from ..suites.stress import axis_overrides
from .kind import Ask, Curve, Designs, Knob, Option, Steps

__all__ = ["DESIGNS", "READER"]

#: What reads the designs.
READER = "spot-ml+slope-cell+zernike-map"

#: Multiples of pitch and focal length from which a design is chosen by default.
_WIDER, _LONGER = (0.75, 1.0, 1.5, 2.0), (0.5, 1.0, 1.5, 2.0, 3.0)
#: Share of spots that must stay in their cell, and the factor by which slopes are taken greater: for other turbulence of this kind.
_OWN, _MARGIN = 0.999, 1.5
#: Captures by which a design is judged: the phase of a few frames tells more of their turbulence than of the sensor.
_CAPTURES = 4


def _knobs(scene: Scene) -> Sequence[Knob]:
    lenslets = wavefront_rig(scene).lenslets
    return (
        Knob("pitch", "m", "pitch of the lenslets", tuple(lenslets.pitch_m * one for one in _WIDER)),
        Knob("focal-length", "m", "their focal length", tuple(lenslets.focal_length_m * one for one in _LONGER)),
    )


def _placed(scene: Scene, pitch_m: float, focal_length_m: float) -> dict[str, Any]:
    """Overrides: as many lenslets of this pitch as cover what the array covers now."""
    lenslets = wavefront_rig(scene).lenslets
    across = max(math.floor(lenslets.across * lenslets.pitch_m / pitch_m + 1e-9), 1)
    return {
        "rig.lenslets.preset": None, "rig.lenslets.pitch_m": pitch_m, "rig.lenslets.focal_length_m": focal_length_m,
        "rig.lenslets.across": across,
    }  # fmt: skip


def _seen(scene: Scene, ask: Ask, overrides: dict[str, Any]) -> tuple[float, float]:
    """(rms error of the phase that is read [rad], share of spots in their cells)."""
    from ...generator.generate import generate

    held = load_scene(scene, overrides)
    lenslets = wavefront_rig(held).lenslets
    errors, shares = [], []
    for seed in range(ask.seed, ask.seed + _CAPTURES):
        capture = generate(held, seed=seed, fidelity=ask.fidelity)
        slope = np.asarray(capture["truth_slope"].values, np.float64)
        moved = _MARGIN * np.abs(slope[np.isfinite(slope).all(axis=2)]) * lenslets.focal_length_m
        shares.append(float((moved <= 0.5 * lenslets.pitch_m).all(axis=1).mean()) if moved.size else 0.0)
        errors.append(_error(capture))
    return math.sqrt(sum(one**2 for one in errors) / len(errors)), min(shares)


def _error(capture: xr.Dataset) -> float:
    """Rms error of the phase that is read [rad], without piston; infinite where a frame has no answer."""
    from ...captures.hide import hide_truth
    from ...estimators import run_estimator

    found = run_estimator(READER, hide_truth(capture))
    error = np.where(found["valid_phase"].values, found["phase"].values, np.nan) - capture["truth_phase"].values
    if not np.isfinite(error).any(axis=(1, 2)).all():
        return math.inf
    error = error - np.nanmean(error, axis=(1, 2), keepdims=True)
    return float(np.sqrt(np.nanmean(error**2)))


def _options(scene: Scene, ask: Ask) -> tuple[list[Option], Curve]:
    light = load_scene(scene, axis_overrides(scene, "photons", ask.budget)) if ask.budget != 1.0 else scene
    lenslets = wavefront_rig(scene).lenslets
    bound, share = _seen(light, ask, {})
    own = {"pitch": lenslets.pitch_m, "focal-length": lenslets.focal_length_m}
    found = [Option("the scene's own", own, {}, bound, share)]
    asked = list(itertools.product(ask.values["pitch"], ask.values["focal-length"]))
    step = Steps(ask.progress, len(asked))
    for pitch, focal in asked:
        overrides = _placed(scene, pitch, focal)
        settings, name = {"pitch": pitch, "focal-length": focal}, f"pitch {1e6 * pitch:.4g} um, f {1e3 * focal:.4g} mm"
        step(name)
        try:
            bound, share = _seen(light, ask, overrides)
        except InputError as error:
            found.append(Option(name, settings, overrides, math.inf, 0.0, error.what))
            continue
        why = "" if share >= _OWN else "spots leave their cells"
        found.append(Option(name, settings, overrides, bound, share, why))
    return found, _curve(found, lenslets.pitch_m)


def _curve(found: Sequence[Option], pitch_m: float) -> Curve:
    """The bound of every focal length at the scene's own pitch, or the nearest one."""
    pitches = sorted({one.settings["pitch"] for one in found[1:]}, key=lambda one: abs(one - pitch_m))
    line = sorted(
        (one.settings["focal-length"], one.bound) for one in found[1:]
        if one.settings["pitch"] == pitches[0] and math.isfinite(one.bound)
    )  # fmt: skip
    x, y = (np.array([pair[k] for pair in line]) for k in (0, 1))
    return Curve(1e3 * x, y, f"focal length [mm], pitch {1e6 * pitches[0]:.4g} um", "rms error of the phase [rad]")


DESIGNS = Designs(
    knobs=_knobs, options=_options, quantity="phase", shown=(1.0, "rad"),
    guard="share of spots within half a pitch of their place, slopes times 1.5: .999 or more",
)  # fmt: skip
