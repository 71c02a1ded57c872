"""The speed of a run's estimators, and of the renderer, against another version of the code."""

from __future__ import annotations

import secrets
import tempfile
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from ...scenes.errors import InputError
from .check import Check, abstained
from .paired import Effects
from .reference import CannotBuild, build_reference
from .sides import Failed, Paired, Plan, Side, Timer, any_core, interleaved, open_all
from .speed import Timed, with_retry
from .targets import targets_of

if TYPE_CHECKING:
    import pandas as pd

__all__ = ["speed_against"]


def speed_against(
    folder: Path, table: pd.DataFrame, against: str, project: Path, effects: Effects, others: Sequence[Check],
    *, plan: Plan, render: bool, tell: Callable[[str], None],
) -> list[Timed]:  # fmt: skip
    """The checks of speed.

    Main arguments:
        folder, table: of the run. against, project: see `build_reference`. others: the gate's other checks.
    Other arguments:
        plan: how long is measured. render: also time the generation of the scenes. tell: receives lines of progress.

    Raises:
        InputError: the run has no captures, or the reference does not exist.
    """
    with tempfile.TemporaryDirectory(prefix="beambench-gate-") as name:
        scratch = Path(name)
        named = targets_of(folder, table, scratch / "captures", render=render)
        tell(f"reference: installing {against}")
        try:
            reference = build_reference(against, project, scratch)
        except CannotBuild as error:
            return [Timed(abstained("speed", "all", f"the reference cannot be installed: {error}"))]
        return _timed(dict(enumerate(named)), list(named.values()), reference, effects, others, plan, tell)


def _timed(
    subjects: dict[int, str], targets: list[dict[str, Any]], reference: Path, effects: Effects, others: Sequence[Check],
    plan: Plan, tell: Callable[[str], None],
) -> list[Timed]:  # fmt: skip
    rng = np.random.default_rng(secrets.randbits(64))

    def start() -> list[Timer]:
        path, core = [str(reference)], any_core(rng)
        return [Side(path, core=core), Side(path, core=core), Side(core=core)]

    tell("reference: both versions compile and answer once")
    opened = open_all(start, dict(enumerate(targets)))
    found: list[Timed] = []
    usable: dict[int, Mapping[str, Any]] = {}
    for number, answer in opened.items():
        if isinstance(answer, str):
            found.append(Timed(abstained("speed", subjects[number], answer)))
        elif _holds(answer, reference):
            usable[number] = targets[number]
    if not usable and not found:
        reason = "the reference holds no code that the run timed: the other package's code is that of both sides"
        found.append(Timed(abstained("speed", "all", reason)))

    def measure(numbers: Sequence[int]) -> dict[int, Paired]:
        return interleaved(
            start, {number: usable[number] for number in numbers}, plan, rng,
            tell=lambda done: tell(f"speed: start {done} of {plan.starts}"),
        )  # fmt: skip

    if usable:
        try:
            timed = with_retry({number: subjects[number] for number in usable}, effects.speed, measure, others=others)
            found += timed.values()
        except Failed as error:
            found += [Timed(abstained("speed", subjects[number], f"a process failed: {error}")) for number in usable]
    return found


def _holds(answers: Sequence[Mapping[str, Any]], reference: Path) -> bool:
    """Whether A and A' took code of this target from the reference, and B did not. Code of other packages is not compared."""
    root = reference.resolve()
    inside = [any(Path(str(home)).resolve().is_relative_to(root) for home in answer["homes"]) for answer in answers]
    if inside[2]:
        raise InputError("The present version was loaded from the reference.", where="--against", value=str(reference))
    return all(inside[:2])
