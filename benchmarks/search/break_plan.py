"""Check the arguments of a search for failures of an estimator; add the modality's default neighbours and scenes."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from ...estimators.listing import modality_read
from ...scenes.errors import InputError
from ...scenes.load import load_scene
from ...scenes.rigs import rig_kind
from ...scenes.scene import Scene
from ..judges import judge_of
from ..runner.confined import plugin_row
from ..runner.estimator_labels import Chosen, check_estimators

__all__ = ["Plan", "plan_break"]


@dataclass(frozen=True)
class Plan:
    """The checked arguments of a search.

    Main arguments:
        target: the estimator. others: its neighbours. scenes: names or paths. loaded: the scenes, reduced in size.
        base: overrides of every scene, including those that reduce its size. overrides: the overrides as given.
        side, factor, budget, seed: see `plan_break`.
    """

    target: Chosen
    others: list[Chosen]
    scenes: tuple[str, ...]
    loaded: dict[str, Scene]
    base: dict[str, Any]
    overrides: dict[str, Any]
    side: int
    factor: float
    budget: int
    seed: int


def plan_break(
    name: str,
    *,
    neighbours: Sequence[str] = (),
    scenes: Sequence[str] = (),
    overrides: Mapping[str, Any] | None = None,
    side: int = 24,
    factor: float = 3.0,
    budget: int = 300,
    seed: int = 0,
) -> Plan:
    """Check a search before anything is written.

    Main arguments:
        name: the estimator's label.
        neighbours: labels of estimators to compare with; by default those of the modality's judge.
        scenes: names or paths, the simplest first; by default those of the modality's judge. overrides: for every scene.
    Other arguments:
        side: a capture has side² elements; a search needs no resolution, so that few are enough.
        factor, budget, seed: see `search_and_shrink`.

    Raises:
        InputError: an estimator, scene or override is unknown, there is no neighbour, the scenes have different modalities, or
            a number is out of range.
    """
    (target,) = check_estimators([name])
    if isinstance(seed, bool) or not isinstance(seed, int) or seed < 0:
        raise InputError("A seed must be a whole number of at least 0.", where="seed", value=seed, allowed="0, 1, 2, …")
    if not (1 <= budget <= 100_000 and factor > 1 and 2 <= side <= 1024):
        raise InputError(
            "A number of the search is out of range.",
            where="budget, factor, side",
            value=(budget, factor, side),
            allowed="budget 1 … 100000, factor over 1, side 2 … 1024",
        )
    scenes = tuple(scenes or judge_of(modality_read(target.name, plugin_row)).scenes)
    modalities = {load_scene(scene).modality for scene in scenes}
    if len(modalities) != 1:
        raise InputError(
            "All scenes of a search must be of the same modality.", where="scenes", value=sorted(modalities)
        )
    modality = modalities.pop()
    others = [one for one in check_estimators(neighbours or judge_of(modality).neighbours) if one.label != target.label]
    if not others:
        raise InputError(
            "A search needs at least one neighbour, other than the estimator itself.",
            where="neighbours",
            value=list(neighbours),
        )
    base = {**rig_kind(modality).resize(side), **(overrides or {})}
    loaded = {scene: load_scene(scene, base) for scene in scenes}
    return Plan(target, others, scenes, loaded, base, dict(overrides or {}), side, factor, budget, seed)
