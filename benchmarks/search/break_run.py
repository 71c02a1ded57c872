"""Search generated captures for failures of an estimator with `breaker`, and write the files of the search."""

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
from ..judges import JUDGES, judge_of
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
        out: folder with search.csv, run.json and, if a failure was detected, its suite file.
        found: whether a failure was detected, in comparison with the neighbours.
        ratio: full RMSE of the estimator over the smallest one; a crash counts as a factor of ten.
        scene, levels: scene and levels of the failure; without a failure, of the worst candidate.
        spec: the suite file that repeats the failure; None without a failure.
        rows: scores of the estimator and its neighbours on that scene.
        judged: number of captures judged. wall_s: duration of the search, s.
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
    """Badness of a candidate: log10 of the estimator's full RMSE over the smallest of all estimators', or over the local bound."""

    def __init__(self, bench: Bench, label: str, scenes: Mapping[str, Scene], log: Path, seed: int) -> None:
        self.bench, self.label, self.scenes = bench, label, scenes
        self.impossible = 0
        self._log, self._seed = log, seed
        write_text(log, to_csv([], _COLUMNS))

    def cell(self, candidate: Candidate, seed: int) -> tuple[Cell, dict[str, Any]]:
        """The cell as `beambench run` makes it from the written suite file, and the overrides."""
        scene, overrides = stressed(self.scenes[candidate.scene], candidate.levels)
        nan, key = math.nan, capture_key(scene.name, CELL_NONE, math.nan)
        return Cell(scene.name, scene, CELL_NONE, nan, CELL_NONE, nan, seed, key), overrides

    def answers(self, candidate: Candidate, seed: int) -> dict[str, dict[str, Any]]:
        """The score rows, by label."""
        cell, _ = self.cell(candidate, seed)
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # e.g. targets outside the gates, which the search tries on purpose
            (answers,) = self.bench.answer([cell])
        return {label: answer.row for label, answer in answers.items()}

    def __call__(self, candidate: Candidate, seed: int) -> float:
        badness = self._judged(candidate, seed)
        if seed == self._seed:  # row by row, so that an interrupted search leaves what it has judged
            with open(self._log, "a", encoding="utf-8") as file:
                file.write(_table([(candidate, badness)]).partition("\n")[2])
        return badness

    def _judged(self, candidate: Candidate, seed: int) -> float:
        try:
            rows = self.answers(candidate, seed)
        except InputError:  # the levels contradict each other, or no element has truth
            self.impossible += 1
            return -math.inf
        own = rows[self.label]
        if not_applicable(own["status"]):
            raise InputError(
                "The estimator cannot be judged on these scenes.", where=self.label, value=skip_reason(own["status"]),
                allowed="scenes whose captures it reads",
                next_step="name one: " + " or ".join(f"--scenes {judge_of(name).scenes[0]}" for name in JUDGES),
            )  # fmt: skip
        applicable = [row for label, row in rows.items() if label != self.label and not not_applicable(row["status"])]
        best = min((row["rmse_full"] for row in applicable), default=math.inf)
        best = max(min(best, own["rmse_full"]), 1e-12)
        # With the local bound, one lucky neighbour does not make all others look bad. Bounds near the threshold include rare
        # outliers that captures of this size do not show: there only the neighbours are compared.
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
    """Search for a scene in which an estimator fails but its neighbours do not, and write it into `out`.

    Main arguments:
        name: the label of the estimator, or a checked plan. out: an existing folder.
    Other arguments:
        neighbours, scenes, overrides, side, factor, budget, seed: see `plan_break`.
        time_limit_s: time limit per capture and estimator, s.

    search.csv is written row by row, so that an interrupted search leaves what it has judged.

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
    """Write the suite file that repeats a failure, and return its path."""
    spec = out / f"break-{plan.target.name}.toml"
    labels = [plan.target.label, *(one.label for one in plan.others)]
    note = _note(plan.target.label, candidate, rows)
    overrides = {**plan.base, **changes}
    write_text(spec, suite_text(spec.stem, note, candidate.scene, overrides, labels, plan.seed, spec.name))
    return spec


def _note(label: str, candidate: Candidate, rows: Sequence[Mapping[str, Any]]) -> str:
    """Summary in one line: the estimator's error, the smallest one, the bound, and the levels."""
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
    """The rows of search.csv: every candidate with its badness, in the order of the search; empty for an impossible one."""
    rows = [
        {
            "scene": candidate.scene,
            "levels": " ".join(f"{axis}={level:g}" for axis, level in candidate.levels),
            "badness": badness if math.isfinite(badness) else math.nan,
        }
        for candidate, badness in seen
    ]
    return to_csv(rows, _COLUMNS)
