"""Break an estimator on generated captures: the search of `breaker` with real scenes, and what it leaves on disk."""

from __future__ import annotations

import math
import time
import warnings
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from ...scenes.errors import InputError
from ...scenes.load import load_scene
from ...scenes.rigs import RIGS, rig_kind
from ...scenes.scene import Scene
from ..folders.files import write_json, write_text
from ..folders.kinds import BREAK
from ..folders.progress import Progress, silent
from ..folders.record import TABLES_VERSION, machine, now, versions
from ..runner.estimator_labels import Chosen, check_estimators
from ..scores.tables import to_csv
from ..statistics.skips import not_applicable, skip_reason
from ..suites.spec import Limits
from ..suites.stress import stressed
from ..suites.suite import CELL_NONE, Cell, capture_key
from .bench import Bench
from .breaker import search_and_shrink, suite_text
from .space import Candidate, dimensions_of

__all__ = ["NEIGHBOURS", "SCENES", "BreakResult", "Plan", "break_estimator", "plan_break"]

#: Who an estimator is measured against where nobody is named: one of each family.
NEIGHBOURS = {
    "gated": ("poisson-ml", "weighted-average[background=outside]", "parabola"),
    "waveform": ("waveform-ml", "waveform-average", "waveform-constant-fraction"),
    "amcw": ("amcw-ml", "amcw-phase", "amcw-decade"),
}
#: Scenes of the library that are searched where none is named, the plainest first.
SCENES = {
    "gated": ("flat-wall", "tilted-wall", "sphere"),
    "waveform": ("photodetector-5m", "counter"),
    "amcw": ("amcw",),
}

_COLUMNS = ("scene", "levels", "badness")


@dataclass(frozen=True)
class BreakResult:
    """What a search left.

    `found`: whether the estimator fails against its neighbours somewhere. `ratio`: its full RMSE over the best there
    (a crash counts as ten times). `spec`: the suite file that repeats the find, None without one. `levels`, `scene`:
    the find, or the worst that was seen. `rows`: the scores at the find, of the estimator and its neighbours.
    """

    out: Path
    found: bool
    ratio: float
    scene: str
    levels: dict[str, float]
    spec: Path | None
    rows: list[dict[str, Any]]
    judged: int
    wall_s: float


class _Judge:
    """Badness of a candidate: log10 of the estimator's full RMSE over the best that anybody reaches."""

    def __init__(self, bench: Bench, label: str, scenes: Mapping[str, Scene], log: Path, seed: int) -> None:
        self.bench, self.label, self.scenes = bench, label, scenes
        self.impossible = 0
        self._log, self._seed = log, seed
        write_text(log, to_csv([], _COLUMNS))

    def cell(self, candidate: Candidate, seed: int) -> tuple[Cell, dict[str, Any]]:
        """The cell as `beambench run` makes it from the written spec, and the overrides."""
        scene, overrides = stressed(self.scenes[candidate.scene], candidate.levels)
        nan, key = math.nan, capture_key(scene.name, CELL_NONE, math.nan)
        return Cell(scene.name, scene, CELL_NONE, nan, CELL_NONE, nan, seed, key), overrides

    def answers(self, candidate: Candidate, seed: int) -> dict[str, dict[str, Any]]:
        """Score row by label."""
        cell, _ = self.cell(candidate, seed)
        with warnings.catch_warnings():
            warnings.simplefilter(
                "ignore"
            )  # of scenes outside the gates and the like: the search goes there on purpose
            (answers,) = self.bench.answer([cell])
        return {label: answer.row for label, answer in answers.items()}

    def __call__(self, candidate: Candidate, seed: int) -> float:
        badness = self._judged(candidate, seed)
        if seed == self._seed:  # as it goes, so that an interrupted search leaves what it judged
            with open(self._log, "a", encoding="utf-8") as file:
                file.write(_table([(candidate, badness)]).partition("\n")[2])
        return badness

    def _judged(self, candidate: Candidate, seed: int) -> float:
        try:
            rows = self.answers(candidate, seed)
        except InputError:  # levels that no scene can have together, or no element with a truth
            self.impossible += 1
            return -math.inf
        mine = rows[self.label]
        if not_applicable(mine["status"]):
            raise InputError(
                "The estimator cannot be judged here.", where=self.label, value=skip_reason(mine["status"])
            )
        applicable = [row for label, row in rows.items() if label != self.label and not not_applicable(row["status"])]
        best = min((row["rmse_full"] for row in applicable), default=math.inf)
        best = max(min(best, mine["rmse_full"]), 1e-12)
        # A local bound keeps a lucky neighbour from making all others look bad. Bounds near the threshold hold rare
        # outliers that captures of this size do not show: there the neighbours alone are the measure.
        bounds = [row["bound"] for row in rows.values() if row["bound"] > 0 and row["bound_kind"] in ("exact", "quasi")]
        reference = max([best, *bounds[:1]])
        badness = math.log10(mine["rmse_full"] / reference) if mine["rmse_full"] > 0 else -math.inf
        return badness + (1.0 if mine["status"] != "ok" else 0.0)


@dataclass(frozen=True)
class Plan:
    """A search that can be made: its arguments, checked, and what they name."""

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
    """Check a search before anything is written; arguments as for `break_estimator`.

    Raises:
        InputError: unknown estimator, scene or override, no neighbour, a negative seed, or a budget that is no number of
            candidates.
    """
    (target,) = check_estimators([name])
    if isinstance(seed, bool) or not isinstance(seed, int) or seed < 0:
        raise InputError("A seed is a whole number, not negative.", where="seed", value=seed, allowed="0, 1, 2, …")
    if not (1 <= budget <= 100_000 and factor > 1 and 2 <= side <= 1024):
        raise InputError(
            "The search cannot be made like this.",
            where="budget, factor, side",
            value=(budget, factor, side),
            allowed="budget 1 … 100000, factor over 1, side 2 … 1024",
        )
    scenes = tuple(scenes or SCENES[_modality(target.name)])
    modalities = {load_scene(scene).modality for scene in scenes}
    if len(modalities) != 1:
        raise InputError("One search is over scenes of one kind.", where="scenes", value=sorted(modalities))
    modality = modalities.pop()
    others = [one for one in check_estimators(neighbours or NEIGHBOURS[modality]) if one.label != target.label]
    if not others:
        raise InputError("An estimator is judged against others.", where="neighbours", value=list(neighbours))
    base = {**rig_kind(modality).resize(side), **(overrides or {})}
    loaded = {scene: load_scene(scene, base) for scene in scenes}
    return Plan(target, others, scenes, loaded, base, dict(overrides or {}), side, factor, budget, seed)


def break_estimator(
    name: str | Plan,
    out: Path,
    *,
    time_limit_s: float = 30.0,
    progress: Progress = silent,
    command: Sequence[str] = (),
    **arguments: Any,
) -> BreakResult:
    """Search for a scene in which an estimator fails against its neighbours, and write it into `out`.

    Main arguments:
        name: the estimator's label, or a plan that was checked before. out: a folder that exists.
    Other arguments:
        neighbours: labels to compare with; `NEIGHBOURS` by default. scenes: names or paths, the plainest first; `SCENES`
        by default. overrides: of every scene.
        side: rows and columns of the captures (side² shots): small, since a find needs no resolution. factor, budget, seed: see
        `search_and_shrink`. time_limit_s: per capture and estimator.

    search.csv is written as the search goes: what is interrupted leaves what it judged.

    Raises:
        InputError: as `plan_break`.
    """
    start, began = time.perf_counter(), now()
    plan = plan_break(name, **arguments) if isinstance(name, str) else name
    target, others, seed = plan.target, plan.others, plan.seed
    space = dimensions_of(list(plan.loaded.values()))
    with Bench(
        [target, *others], Limits(time_s=time_limit_s, memory_bytes=2**31), suite=f"break-{target.name}"
    ) as bench:
        judge = _Judge(bench, target.label, plan.loaded, out / "search.csv", seed)
        search = search_and_shrink(
            judge, list(plan.scenes), space, factor=plan.factor, budget=plan.budget, seed=seed, progress=progress
        )
        candidate, badness = (search.find.candidate, search.find.badness) if search.find else search.worst
        rows = list(judge.answers(candidate, seed).values())
        changes = judge.cell(candidate, seed)[1]
        made = bench.captures_made
    spec = None
    if search.find is not None:
        spec = out / f"break-{target.name}.toml"
        labels = [target.label, *(one.label for one in others)]
        text = suite_text(
            spec.stem,
            _note(target.label, candidate, rows),
            candidate.scene,
            {**plan.base, **changes},
            labels,
            seed,
            spec.name,
        )
        write_text(spec, text)
    write_text(out / "search.csv", _table(search.seen))
    record = {
        "verb": BREAK.verb, "estimator": target.label, "neighbours": [one.label for one in others],
        "scenes": list(plan.scenes), "overrides": plan.overrides, "side": plan.side, "factor": plan.factor,
        "budget": plan.budget, "seed": seed,
        "judged": search.judged, "captures": made, "impossible": judge.impossible, "found": search.find is not None,
        "scene": candidate.scene, "levels": dict(candidate.levels), "command": list(command), "started": began,
        "finished": now(), "tables_version": TABLES_VERSION, "machine": machine(), "versions": versions(),
    }  # fmt: skip
    write_json(out / "run.json", record)
    wall = time.perf_counter() - start
    return BreakResult(
        out, search.find is not None, 10.0**badness, candidate.scene, dict(candidate.levels), spec, rows,
        search.judged, wall,
    )  # fmt: skip


def _modality(name: str) -> str:
    """The modality that a built-in reads. A plug-in's code is never imported here: where no scenes are named, those of the
    first kind of rig are searched."""
    from ...estimators import BUILTIN
    from ...estimators.registry import get_estimator

    return get_estimator(name).modality if name in BUILTIN else next(iter(RIGS))


def _note(label: str, candidate: Candidate, rows: Sequence[Mapping[str, Any]]) -> str:
    """One line for people: who fails how badly, and where."""
    where = ", ".join(f"{axis} = {level:g}" for axis, level in candidate.levels) or "as written"
    mine, others = rows[0], [row for row in rows[1:] if not not_applicable(row["status"])] or rows[:1]
    best = min(others, key=lambda row: row["rmse_full"])
    status = "" if mine["status"] == "ok" else f" ({str(mine['status'])[:60]})"
    return (
        f"{label}: RMSE {mine['rmse_full']:.3g} m{status}, {best['estimator']} {best['rmse_full']:.3g} m, "
        f"bound {mine['bound'] if mine['bound'] > 0 else best['bound']:.3g} m; {where}"
    )


def _table(seen: Sequence[tuple[Candidate, float]]) -> str:
    """search.csv: every candidate with its badness, in the order of the search; impossible ones are left empty."""
    rows = [
        {
            "scene": candidate.scene,
            "levels": " ".join(f"{axis}={level:g}" for axis, level in candidate.levels),
            "badness": badness if math.isfinite(badness) else math.nan,
        }
        for candidate, badness in seen
    ]
    return to_csv(rows, _COLUMNS)
