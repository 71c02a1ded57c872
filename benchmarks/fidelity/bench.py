"""What the measurement of rungs needs of a modality: its random scenes, and how one of them is measured."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from ...scenes.records import record_of
from ...scenes.scene import Scene
from ..judges import judge_of

__all__ = ["Bench", "bench_of"]


@dataclass(frozen=True)
class Bench:
    """Main arguments:
    family: (seed, number of scenes, folder for meshes) -> scenes.
    measure: (scene, seed) -> rows of fidelity.csv, and a record of the scene's references.
    """

    family: Callable[[int, int, Path], list[Scene]]
    measure: Callable[[Scene, int], tuple[list[dict[str, Any]], dict[str, Any]]]


def bench_of(modality: str) -> Bench:
    """The measurement of a modality's rungs. Raises InputError for a modality without one."""
    place = judge_of(modality).rungs
    table = {modality: place} if place else {}
    bench: Bench = record_of(
        table,
        modality,
        "There is no family of random scenes on which the rungs of this modality are measured.",
        "modality",
    )
    return bench
