"""Break an estimator on generated captures: the search of `breaker` over scenes, and the files that it writes."""

from __future__ import annotations

import math
import time
import warnings
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from ...scenes.errors import InputError
from ...scenes.scene import Scene
from ..folders.files import write_json, write_text
from ..folders.kinds import BREAK
from ..folders.progress import Progress, silent
from ..folders.record import TABLES_VERSION, machine, now, versions
from ..scores.tables import to_csv
from ..statistics.skips import not_applicable, skip_reason
from ..suites.spec import Limits
from ..suites.stress import stressed
from ..suites.suite import CELL_NONE, Cell, capture_key
from .bench import Bench
from .break_plan import Plan, plan_break
from .breaker import search_and_shrink, suite_text
from .space import Candidate, dimensions_of

__all__ = ["BreakResult", "Plan", "break_estimator", "plan_break"]

_COLUMNS = ("scene", "levels", "badness")


@dataclass(frozen=True)
class BreakResult:
    """The outcome of a search.

    Main arguments:
        out: folder with search.csv, run.json and, after a find, the suite file.
        found: whether the estimator fails against its neighbours somewhere.
        ratio: its full RMSE over the best one's there; a crash counts as ten times.
        scene, levels: of the find, or of the worst candidate where there is no find.
        spec: the suite file that repeats the find, None without one.
        rows: the scores there, of the estimator and its neighbours.
        judged: number of captures judged. wall_s: time taken.
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
    """Badness of a candidate: log10 of the estimator's full RMSE over the best of all estimators, or the local bound."""

    def __init__(self, bench: Bench, label: str, scenes: Mapping[str, Scene], log: Path, seed: int) -> None:
        self.bench, self.label, self.scenes = bench, label, scenes
        self.impossible = 0
        self._log, self._seed = log, seed
        write_text(log, to_csv([], _COLUMNS))

    def cell(self, candidate: Candidate, seed: int) -> tuple[Cell, dict[str, Any]]:
        """The cell as `beambench run` makes it from the written suite, and the overrides."""
        scene, overrides = stressed(self.scenes[candidate.scene], candidate.levels)
        nan, key = math.nan, capture_key(scene.name, CELL_NONE, math.nan)
        return Cell(scene.name, scene, CELL_NONE, nan, CELL_NONE, nan, seed, key), overrides

    def answers(self, candidate: Candidate, seed: int) -> dict[str, dict[str, Any]]:
        """Score row by label."""
        cell, _ = self.cell(candidate, seed)
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # targets outside the gates and the like: the search goes there on purpose
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
        own = rows[self.label]
        if not_applicable(own["status"]):
            raise InputError(
                "The estimator cannot be judged on these scenes.", where=self.label, value=skip_reason(own["status"])
            )
        applicable = [row for label, row in rows.items() if label != self.label and not not_applicable(row["status"])]
        best = min((row["rmse_full"] for row in applicable), default=math.inf)
        best = max(min(best, own["rmse_full"]), 1e-12)
        # A local bound keeps a lucky neighbour from making all others look bad. Bounds near the threshold hold rare
        # outliers that captures of this size do not show: there the neighbours alone are the measure.
        bounds = [row["bound"] for row in rows.values() if row["bound"] > 0 and row["bound_kind"] in ("exact", "quasi")]
        reference = max([best, *bounds[:1]])
        badness = math.log10(own["rmse_full"] / reference) if own["rmse_full"] > 0 else -math.inf
        return badness + (1.0 if own["status"] != "ok" else 0.0)


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
        neighbours, scenes, overrides, side, factor, budget, seed: see `plan_break`.
        time_limit_s: per capture and estimator.

    search.csv grows with the search, so that an interrupted one leaves all that it judged.

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
    spec = _write_find(plan, candidate, rows, changes, out) if search.find else None
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


def _write_find(
    plan: Plan, candidate: Candidate, rows: Sequence[Mapping[str, Any]], changes: Mapping[str, Any], out: Path
) -> Path:
    """Write the suite file that repeats a find; gives its path."""
    spec = out / f"break-{plan.target.name}.toml"
    labels = [plan.target.label, *(one.label for one in plan.others)]
    note = _note(plan.target.label, candidate, rows)
    overrides = {**plan.base, **changes}
    write_text(spec, suite_text(spec.stem, note, candidate.scene, overrides, labels, plan.seed, spec.name))
    return spec


def _note(label: str, candidate: Candidate, rows: Sequence[Mapping[str, Any]]) -> str:
    """One line for people: the estimator's error, the best one's, the bound, and the levels."""
    where = ", ".join(f"{axis} = {level:g}" for axis, level in candidate.levels) or "as written"
    own, others = rows[0], [row for row in rows[1:] if not not_applicable(row["status"])] or rows[:1]
    best = min(others, key=lambda row: row["rmse_full"])
    status = "" if own["status"] == "ok" else f" ({str(own['status'])[:60]})"
    bound, unit = own["bound"] if own["bound"] > 0 else best["bound"], own["unit"]
    return (
        f"{label}: RMSE {own['rmse_full']:.3g} {unit}{status}, {best['estimator']} {best['rmse_full']:.3g} {unit}, "
        f"bound {bound:.3g} {unit}; {where}"
    )


def _table(seen: Sequence[tuple[Candidate, float]]) -> str:
    """search.csv: every candidate with its badness, in the order of the search; empty for an impossible candidate."""
    rows = [
        {
            "scene": candidate.scene,
            "levels": " ".join(f"{axis}={level:g}" for axis, level in candidate.levels),
            "badness": badness if math.isfinite(badness) else math.nan,
        }
        for candidate, badness in seen
    ]
    return to_csv(rows, _COLUMNS)
