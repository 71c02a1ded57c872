"""Twins that the generator renders as a whole, of recordings whose scene is named: what is common to all modalities.

The scene has the twin's rig, and its light is scaled by one factor to that of the recording's first half. Every draw is a capture
of its own, with the rig's uncertain values, another chip of the same make, and noise drawn anew; its second half is measured as
the recording's second half is, read with the twin's rig.
"""

from __future__ import annotations

import math
import warnings
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
import numpy.typing as npt
import xarray as xr

from ...captures.hide import hide_truth
from ...generator.generate import generate
from ...scenes.errors import InputError
from ...scenes.load import load_scene
from ...scenes.overrides import apply_overrides
from ...scenes.scene import Scene
from .clause import Ask, Curve, Evidence
from .uncertain import Uncertain, held_at, perturbed, uncertain_of

__all__ = [
    "Cells", "Frame", "Kit", "RenderedTwin", "check_length", "every_other", "measure_rendered", "noise_bounds", "photon_transfer",
    "pixel_noise", "pooled_bound", "prepared", "residuals",
]  # fmt: skip

Float = npt.NDArray[np.float64]

#: Key of the random numbers of a twin; the draw is their seed.
_KEY = 0x7717
#: Rounding leaves so much variance, DN².
_ROUNDING = 1.0 / 12.0
#: Fewest draws whose scatter weighs residuals.
_LEAST_DRAWS = 4


@dataclass(frozen=True, eq=False)
class Cells:
    """Mean counts above the background, DN, (group, cell); each group's light is fitted by one factor. `frames`: that each is
    a mean of."""

    mean: Float
    frames: int


@dataclass(frozen=True, eq=False)
class Frame:
    """What the twin says of the judged half: a draw without errors of the rig (`nominal`, with its truth), and its half."""

    nominal: xr.Dataset
    half: xr.Dataset


@dataclass(frozen=True)
class Kit:
    """What a modality adds.

    Main arguments:
        main: name of the recorded variable. level: path of the value that the light is proportional to.
        half: (capture, 0 or 1) -> half of it. light: (half, frame) -> its light above the background, on any scale.
        statistics: (half without truth, frame) -> statistics by name, and the cells whose residuals are judged.
        bounds: (half of the recording, frame) -> least standard errors by the name of a statistic. why_not: statistic -> why it
        cannot be measured. curve: (cells of the recording, of the twin's mean, and the scatter of a draw) -> charts.
    """

    main: str
    level: str
    half: Callable[[xr.Dataset, int], xr.Dataset]
    light: Callable[[xr.Dataset, Frame], float]
    statistics: Callable[[xr.Dataset, Frame], tuple[dict[str, float], Cells]]
    bounds: Callable[[xr.Dataset, Frame], dict[str, float]]
    why_not: Mapping[str, str]
    curve: Callable[[Float, Float, Float], Mapping[str, Curve]] = field(default=lambda real, twin, sigma: {})


@dataclass(frozen=True, eq=False)
class RenderedTwin:
    """A scene with the twin's rig, its light matched; `uncertain`: what is drawn anew."""

    scene: Scene
    uncertain: Uncertain
    level: str
    fidelity: Any

    def draw(self, seed: int, *, nominal: bool = False) -> xr.Dataset:
        """A capture with its truth; `nominal`: of the rig's values as they are."""
        data = self.scene.model_dump(mode="json")
        rng = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(_KEY,)))
        changes = {} if nominal else perturbed(data, self.uncertain, self.level, rng)
        if not nominal and "fixed_pattern_seed" in data["rig"]["detector"]:
            changes["rig.detector.fixed_pattern_seed"] = seed
        scene = load_scene(apply_overrides(data, changes)) if changes else self.scene
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            return generate(scene, seed=seed, capture_key=_KEY, fidelity=self.fidelity)


def prepared(capture: xr.Dataset, ask: Ask, kit: Kit) -> tuple[RenderedTwin, Frame]:
    """The twin with its light matched to the first half.

    Raises:
        InputError: no scene, one of another kind, with other frames or pixels than the recording's, or without light.
    """
    modality = str(capture.attrs["modality"])
    if ask.scene is None:
        raise InputError(
            "The twin of such a recording is rendered from a scene: what the rig looked at.", where="--scene", value=None,
            allowed="name or file of a scene with the rig, the target and as many frames as the recording",
            next_step="start from the scene that the recording was planned with: beambench scenes show NAME > mine.toml",
        )  # fmt: skip
    scene = load_scene(ask.scene)
    if scene.modality != modality:
        raise InputError(
            "The scene is of another kind of rig.", where="--scene", value=scene.modality, allowed=modality
        )
    values, sigmas = ({}, {}) if ask.rig is None else (dict(ask.rig.values), dict(ask.rig.sigmas))
    data = apply_overrides(scene.model_dump(mode="json"), values)
    data["declared"] = {}
    twin = RenderedTwin(load_scene(data), uncertain_of(data, sigmas), kit.level, ask.fidelity)
    draft = twin.draw(ask.seed, nominal=True)
    _same_shape(capture, draft, kit)
    frame = Frame(draft, kit.half(draft, 0))
    own, seen = kit.light(kit.half(draft, 0), frame), kit.light(kit.half(_read_with(capture, frame), 0), frame)
    if not (own > 0.0 and seen > 0.0):
        raise InputError(
            "The scene and the recording do not show light in the same places.", where="scene", value=f"{seen:.3g} DN recorded",
            allowed=f"about {own:.3g} DN, as the scene has", next_step="check the target's distance and the rig of the scene",
        )  # fmt: skip
    data = apply_overrides(data, {kit.level: float(held_at(data, kit.level)) * seen / own})
    twin = replace(twin, scene=load_scene(data))
    nominal = twin.draw(ask.seed, nominal=True)
    return twin, Frame(nominal, kit.half(nominal, 1))


def _same_shape(capture: xr.Dataset, draft: xr.Dataset, kit: Kit) -> None:
    real, own = (dict(one[kit.main].sizes) for one in (capture, draft))
    lit = [int(np.asarray(one["laser_on"].values, bool).sum()) for one in (capture, draft) if "laser_on" in one.coords]
    if real != own or len(set(lit)) > 1:
        told = f"{real}" + (f", {lit[0]} with the laser on" if lit else "")
        raise InputError(
            "The scene does not have the frames of the recording.", where=f"scene: {kit.main}",
            value=f"{own}" + (f", {lit[-1]} with the laser on" if lit else ""), allowed=told,
            next_step="set rig.camera, rig.frames or rig.record of the scene to what was recorded",
        )  # fmt: skip


def _read_with(capture: xr.Dataset, frame: Frame) -> xr.Dataset:
    """The recording, read with the twin's rig."""
    return hide_truth(capture).assign_attrs(rig=frame.nominal.attrs["rig"])


def measure_rendered(capture: xr.Dataset, ask: Ask, kit: Kit) -> Evidence:
    """Match the twin's light to one half, and measure the other and the draws alike. Raises InputError as `prepared`."""
    twin, frame = prepared(capture, ask, kit)
    half = kit.half(_read_with(capture, frame), 1)
    real, cells = kit.statistics(half, frame)
    drawn: list[dict[str, float]] = []
    held: list[Cells] = []
    for number in range(ask.draws):
        made = kit.half(_read_with(twin.draw(ask.seed + 1 + number), frame), 1)
        statistics, own = kit.statistics(made, frame)
        drawn.append(statistics)
        held.append(own)
    stack = np.stack([one.mean for one in held])
    real |= residuals(cells, stack[:-1])
    for number, one in enumerate(drawn):
        one |= residuals(held[number], np.delete(stack, number, axis=0))
    why = {name: text for name, text in kit.why_not.items() if not math.isfinite(real.get(name, math.nan))}
    curves = kit.curve(cells.mean, stack.mean(axis=0), stack.std(axis=0, ddof=1))
    return Evidence(real, drawn, kit.bounds(half, frame), why, curves, _about(capture, half, ask, kit, twin))


def residuals(cells: Cells, draws: Float) -> dict[str, float]:
    """χ² per degree of freedom of the cells about the mean of draws (draw, group, cell), each group's light fitted by one factor;
    weights are the draws' own scatter."""
    nothing = {"residual": math.nan, "residual-spread": math.nan}
    if len(draws) < _LEAST_DRAWS or cells.mean.size == 0:
        return nothing
    model = draws.mean(axis=0)
    weight = 1.0 / np.maximum(draws.var(axis=0, ddof=1), _ROUNDING / cells.frames)
    light = (weight * model * cells.mean).sum(axis=1) / np.maximum((weight * model**2).sum(axis=1), 1e-300)
    chi2 = (weight * (cells.mean - light[:, None] * model) ** 2).sum(axis=1) / max(cells.mean.shape[1] - 1, 1)
    return {"residual": float(chi2.mean()), "residual-spread": float(np.quantile(chi2, 0.95))}


def pixel_noise(frames: Float) -> tuple[float, float]:
    """(mean, temporal rms) of samples (frame, …), DN; the rms is NaN of one frame."""
    rms = math.sqrt(float(frames.var(axis=0, ddof=1).mean())) if len(frames) > 1 and frames[0].size else math.nan
    return (float(frames.mean()) if frames.size else math.nan), rms


def noise_bounds(frames: Float) -> tuple[float, float]:
    """Least standard errors of the mean and of the temporal rms of samples (frame, sample), by that rms, DN."""
    number, samples = frames.shape
    rms = pixel_noise(frames)[1]
    return rms / math.sqrt(number * samples), rms / math.sqrt(max(2.0 * samples * (number - 1), 1.0))


def photon_transfer(light: Float, rms: float) -> tuple[float, Float]:
    """(variance per mean [DN], relative energy of each frame) of light (frame, …) above the background; `rms` is the dark's.

    What a whole frame shares, the energy of its pulse, is no photon noise.
    """
    mean = light.mean(axis=0)
    energy = light.reshape(len(light), -1).sum(axis=1) / mean.sum()
    rest = (light - energy.reshape(-1, *(1,) * mean.ndim) * mean).var(axis=0, ddof=1)
    return float((mean * (rest - rms**2)).sum() / (mean**2).sum()), energy


def pooled_bound(sigma: npt.ArrayLike) -> float:
    """Root mean square of the finite ones; NaN without any."""
    known = np.asarray(sigma, np.float64)
    known = known[np.isfinite(known)]
    return float(np.sqrt((known**2).mean())) if known.size else math.nan


def check_length(found: int, name: str, allowed: str, *, least: int) -> None:
    """Refuse a recording that two halves of make no sense of. Raises InputError."""
    if found < least:
        raise InputError(
            "The recording is too short to be split into two halves.", where=name, value=int(found), allowed=allowed,
            next_step=f"record more {name}s: one half gives the light, the other is judged",
        )  # fmt: skip


def every_other(capture: xr.Dataset, name: str, number: int, *, least: int) -> xr.Dataset:
    """Half 0 or 1 of a capture along an axis: both span the same time. Raises InputError below `least`, an even number."""
    size = capture.sizes[name]
    check_length(size, name, f"{least} {name}s or more", least=least)
    return capture.isel({name: slice(number, size // 2 * 2, 2)})


def _about(capture: xr.Dataset, half: xr.Dataset, ask: Ask, kit: Kit, twin: RenderedTwin) -> Sequence[str]:
    sizes = " × ".join(f"{size} {name}s" for name, size in capture[kit.main].sizes.items())
    judged = " × ".join(f"{size} {name}s" for name, size in half[kit.main].sizes.items())
    rig = "that of the scene; no value of it is uncertain" if ask.rig is None else (
        f"{ask.rig.source}, with {twin.uncertain.count} uncertain values, which each of {ask.draws} draws of the twin draws anew"
        + (f", {len(twin.uncertain.joint)} of them with their correlations" if twin.uncertain.joint else "")
    )  # fmt: skip
    return [
        f"The recording: {sizes}. Every other frame gives the level of the light (first half); the others are judged ({judged}).",
        f"The twin's rig: {rig}.",
        f"The twin's target: the scene {ask.scene!s}, its light scaled by one factor to the first half.",
    ]
