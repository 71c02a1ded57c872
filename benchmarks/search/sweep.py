"""Sweep the stresses of a suite: failure maps, refined at the edge of breakdown, and breakdown.csv."""

from __future__ import annotations

import json
import math
import time
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Any

from ...scenes.errors import InputError
from ...scenes.scene import Scene
from ..folders.files import write_json
from ..folders.journal import Journal, without_nan
from ..folders.kinds import SWEEP
from ..folders.progress import Progress, silent
from ..folders.record import TABLES_VERSION, machine, now, versions
from ..folders.workplace import output_folder, workplace
from ..judges.mismatch import wrongly_declared
from ..report.breakdown import curve_name, save_maps
from ..runner.estimator_labels import Chosen, check_estimators
from ..runner.jail import jailed
from ..scores.tables import write_tables
from ..statistics.skips import not_applicable, skips_of
from ..suites.spec import Split, Stress, check_split
from ..suites.stress import axis_unit, stressed, takes_whole_numbers
from ..suites.suite import CELL_NONE, Cell, Loaded, capture_key, cells_of, check_rungs, load_suite
from .bench import Bench, trials_of
from .breakdown import VARIANTS, breakdown_row, calm_level, change_in_bounds, map_rows, write_breakdown
from .failure_map import EdgeMap, Point, check_levels, refine_axis, refine_grid
from .failure_rate import Trial

__all__ = ["SweepResult", "sweep_suite"]


@dataclass
class SweepResult:
    """Result of a sweep: its folder, the rows of breakdown.csv and failure_map.csv, the pictures and the page."""

    out: Path
    rows: list[dict[str, Any]]
    maps: list[dict[str, Any]]
    pictures: list[Path]
    report: Path | None
    wall_s: float
    failures: list[dict[str, str]] = field(default_factory=list)
    skipped: list[dict[str, Any]] = field(default_factory=list)


def sweep_suite(
    suite: str | Path | Mapping[str, Any],
    out: str | Path | None = None,
    *,
    overrides: Mapping[str, Any] | None = None,
    split: Split = "test",
    budget: int = 16,
    depth: int = 2,
    resume: bool = False,
    overwrite: bool = False,
    report: bool = True,
    progress: Progress = silent,
    command: Sequence[str] = (),
) -> SweepResult:
    """Measure where the estimators of a suite break down along each of its stresses; write the tables and pictures.

    Every condition of the suite is swept. The captures at a level equal those of `run_suite` at that level.

    Main arguments:
        suite: name, path or plain data of a suite with at least one stress. out: the output folder.
    Other arguments:
        overrides: see `load_suite`. split: the seeds to use. budget: largest number of measured levels per estimator and
            axis. depth: number of times a cell of a two-dimensional grid is halved.
        resume: whether to continue an interrupted sweep. overwrite: whether to replace an earlier sweep in `out`. It is
            replaced when the new one, in `out`/unfinished until then, is complete.
        report: whether to write the page. progress, command: as for `run_suite`.

    Raises:
        InputError: the input is invalid, the suite has no stress, or its levels cannot be swept; raised before anything is
            measured.
    """
    start = time.perf_counter()
    loaded = load_suite(suite, overrides)
    check_split(split)
    if not loaded.suite.stresses:
        raise InputError(
            "The suite has no stress to sweep.",
            where="stresses",
            allowed='stresses = [{ axis = "photons", values = [1.0, 0.1, 0.01] }]',
        )
    if not 2 <= budget <= 1000 or not 0 <= depth <= 8:
        raise InputError("The sweep is too small or too large.", where="budget, depth", value=(budget, depth),
                         allowed="budget 2 … 1000, depth 0 … 8")  # fmt: skip
    chosen = check_estimators(loaded.suite.estimators, beside=suite)
    _check_levels(loaded, split)
    folder = output_folder(out, loaded.suite.suite, resume=resume, overwrite=overwrite)
    settings: dict[str, Any] = {"verb": SWEEP.verb, "split": split, "budget": budget, "depth": depth}
    sweep = _Sweep(loaded, chosen, split, budget, depth, progress)

    def check(held: Path) -> None:
        Journal.check(held, loaded.hash, **settings)

    with workplace(folder, SWEEP, resume=resume, overwrite=overwrite, check=check) as work:
        sweep.journal = Journal(work, loaded.hash, **settings)
        result = _sweep_in(
            work, sweep, settings | {"overrides": dict(overrides or {}), "command": list(command)}, report
        )
    pictures = [folder / path.relative_to(work) for path in result.pictures]
    page = folder / result.report.name if result.report is not None else None
    return replace(result, out=folder, pictures=pictures, report=page, wall_s=time.perf_counter() - start)


def _check_levels(loaded: Loaded, split: Split) -> None:
    """Raise InputError for levels that neither rise nor fall throughout, or that a scene or its rung cannot have."""
    for stress in loaded.suite.stresses:
        check_levels(stress.values, stress.axis)
        if stress.axis2 is not None:
            check_levels(stress.values2, stress.axis2)
        for _, scene in loaded.under(stress):
            for level in stress.values:
                stressed(scene, [(stress.axis, level)])
            for level in stress.values2 if stress.axis2 is not None else ():
                stressed(scene, [(stress.axis, stress.values[0]), (stress.axis2 or "", level)])
    check_rungs(cells_of(loaded, split), loaded.suite.rtol)


def _sweep_in(folder: Path, sweep: _Sweep, settings: dict[str, Any], report: bool) -> SweepResult:
    """Measure all stresses, and write the folder."""
    start, began = time.perf_counter(), now()
    loaded, spec, chosen = sweep.loaded, sweep.loaded.suite, sweep.all
    captures = 0
    for condition in spec.conditions:
        with Bench(
            chosen, spec.limits, suite=spec.suite, rtol=spec.rtol, failure_at=spec.failure_at, condition=condition,
            declare=_declare(loaded, condition),
        ) as bench:  # fmt: skip
            sweep.under(bench)
        captures += bench.captures_made
    write_breakdown(folder, sweep.rows, sweep.maps)
    write_tables(folder, sweep.scores, jail=jailed())
    record = {
        "suite": spec.suite, "title": spec.title, "version": spec.version, "hash": loaded.hash,
        "seeds": list(getattr(spec.seeds, settings["split"])), "captures": captures, "conditions": list(spec.conditions),
        "estimators": list(spec.estimators), **settings,
        "started": began, "finished": now(), "wall_s": round(time.perf_counter() - start, 3),
        "tables_version": TABLES_VERSION, "machine": machine(), "versions": versions(),
        "failures": sweep.failures, "skipped": skips_of(sweep.scores),
    }  # fmt: skip
    write_json(folder / "run.json", record)
    pictures = save_maps(folder, sweep.maps, sweep.rows, sweep.cells)
    page = None
    if report:
        from ..report.page import write_report

        page = write_report(folder)
    return SweepResult(folder, sweep.rows, sweep.maps, pictures, page, 0.0, sweep.failures, skips_of(sweep.scores))


def _declare(loaded: Loaded, condition: str) -> Any:
    """The function that changes a capture under a condition; None if it stays unchanged."""
    if condition == "matched":
        return None
    if condition == "mismatched":
        mismatch = loaded.suite.mismatch
        return lambda cell, hidden: wrongly_declared(cell.scene, mismatch, hidden)
    from ..judges.calibrate import Calibrations

    calibration = loaded.suite.calibration
    assert calibration is not None
    calibrations = Calibrations(calibration)
    return lambda cell, hidden: hidden.assign_attrs(rig=calibrations.declared(cell, str(hidden.attrs["rig"])))


class _Sweep:
    """The state of one sweep."""

    def __init__(
        self, loaded: Loaded, chosen: list[Chosen], split: Split, budget: int, depth: int, progress: Progress
    ) -> None:
        self.journal: Journal
        self.loaded, self.all, self.progress = loaded, chosen, progress
        self.chosen = chosen
        #: The labels as the suite writes them, by those with sorted keys.
        self._written = {one.label: label for one, label in zip(chosen, loaded.suite.estimators, strict=True)}
        self.budget, self.depth = budget, depth
        self.seeds: tuple[int, ...] = getattr(loaded.suite.seeds, split)
        if not self.seeds:
            raise InputError(f"The suite has no {split} seeds.", where="seeds", next_step="add them to the suite file")
        self.rows: list[dict[str, Any]] = []
        self.maps: list[dict[str, Any]] = []
        self.scores: list[dict[str, Any]] = []
        self.failures: list[dict[str, str]] = []
        self.cells: dict[tuple[str, str, str], list[tuple[float, float, float, float]]] = {}

    def _cells(self, scene_name: str, scene: Scene, stress: Stress | None, point: Point) -> list[Cell]:
        nan = math.nan
        axis = stress.axis if stress is not None else CELL_NONE
        axis2 = stress.axis2 or CELL_NONE if stress is not None else CELL_NONE
        level, level2 = (*point, nan, nan)[:2]
        levels = [pair for pair in ((axis, level), (axis2, level2)) if pair[0] != CELL_NONE]
        changed = stressed(scene, levels)[0]
        key = capture_key(scene_name, axis, level, axis2, level2)
        rung = self.loaded.fidelity(scene_name)
        return [Cell(scene_name, changed, axis, level, axis2, level2, seed, key, rung) for seed in self.seeds]

    def under(self, bench: Bench) -> None:
        """Sweep all stresses under the condition of a bench."""
        self.bench, self.chosen = bench, self.all
        self.base()
        for stress in self.loaded.suite.stresses:
            self.along(stress)

    def _journal_key(self, label: str, *place: object) -> tuple[str, ...]:
        return (self.bench.condition, json.dumps(self.seeds), label, *map(str, place))

    def base(self) -> None:
        """Score the unchanged scenes, with times, so that the page shows speed and accuracy too. Estimators that apply to
        none of them are left out of the sweep."""
        apply: set[str] = set()
        for number, (name, scene) in enumerate(self.loaded.scenes):
            self.progress("as written", number, len(self.loaded.scenes), name)
            rows: dict[str, list[dict[str, Any]]] = {}
            readers = [one for one in self.chosen if self._reads(one.label, name)]
            for one in readers:
                if (kept := self.journal.done.get(self._journal_key(one.label, "as written", name))) is not None:
                    rows[one.label] = kept
            wanted = [one.label for one in readers if one.label not in rows]
            answers = self.bench.answer(self._cells(name, scene, None, ()), wanted, timed=True) if wanted else []
            for label in wanted:
                rows[label] = [row for found in answers for row in found[label].rows]
                self.journal.add(self._journal_key(label, "as written", name), rows[label])
            for one in readers:
                self.scores += rows[one.label]
                if any(not not_applicable(row["status"]) for row in rows[one.label]):
                    apply.add(one.label)
        self.chosen = [one for one in self.chosen if one.label in apply]
        self.progress("as written", len(self.loaded.scenes), len(self.loaded.scenes), "")

    def _reads(self, label: str, name: str) -> bool:
        """Whether an estimator reads a scene under the condition of the bench."""
        return self.loaded.reads(self._written[label], name) and self.bench.condition in self.loaded.conditions(name)

    def along(self, stress: Stress) -> None:
        """Measure the failure map of every estimator along one stress."""
        under = self.loaded.under(stress)
        chosen = [one for one in self.chosen if any(self._reads(one.label, name) for name, _ in under)]
        store: dict[tuple[str, Point], list[Trial]] = {}
        first: list[Point] = [(x, y) for x in stress.values for y in stress.values2]
        first = first or [(x,) for x in stress.values]
        for number, point in enumerate(first):  # all estimators read a capture while it is on disk
            self.progress(stress.axis, number, len(first), f"level {point[0]:g}")
            self._measure(store, stress, point, [one.label for one in chosen])
        for number, one in enumerate(chosen):
            self.progress(f"{stress.axis} edge", number, len(chosen), one.label)

            def evaluate(points: Sequence[Point], label: str = one.label) -> dict[Point, list[Trial]]:
                for point in points:
                    self._measure(store, stress, point, [label])
                return {point: store[label, point] for point in points}

            if stress.axis2 is None:
                found = refine_axis(
                    evaluate,
                    stress.values,
                    budget=self.budget,
                    axis=stress.axis,
                    whole=self._whole(stress, stress.axis),
                )
                self.rows.append(self._row(stress, one, found))
            else:
                found = refine_grid(
                    evaluate, stress.values, stress.values2, depth=self.depth, axis=stress.axis, axis2=stress.axis2,
                    whole=(self._whole(stress, stress.axis), self._whole(stress, stress.axis2)),
                )  # fmt: skip
                self.cells[curve_name(one.label, self.bench.condition), stress.axis, stress.axis2] = found.cells
            self.maps += map_rows(self._key(stress, one), found)
        self.progress(f"{stress.axis} edge", len(chosen), len(chosen), "")

    def _whole(self, stress: Stress, axis: str) -> bool:
        return any(takes_whole_numbers(scene, axis) for _, scene in self.loaded.under(stress))

    def _measure(
        self, store: dict[tuple[str, Point], list[Trial]], stress: Stress, point: Point, labels: Sequence[str]
    ) -> None:
        keys = {label: self._journal_key(label, stress.axis, stress.axis2, point) for label in labels}
        for label in labels:
            if (label, point) not in store and (kept := self.journal.done.get(keys[label])) is not None:
                store[label, point] = [Trial(**trial) for trial in self.journal.beside[keys[label]]["trials"]]
                self.scores += kept
        wanted = [label for label in labels if (label, point) not in store]
        if not wanted:
            return
        rows: dict[str, list[dict[str, Any]]] = {label: [] for label in wanted}
        for label in wanted:
            store[label, point] = []
        for name, scene in self.loaded.under(stress):
            readers = [label for label in wanted if self._reads(label, name)]
            answers = self.bench.answer(self._cells(name, scene, stress, point), readers)
            for label in readers:
                measured = [found[label] for found in answers]
                store[label, point] += trials_of(name, self.seeds, measured)
                for answer in measured:
                    rows[label] += answer.rows
                    if answer.status != "ok":
                        place = f"{name}, {stress.axis} = {point[0]:g}"
                        failure = {"estimator": label, "scene": place, "condition": self.bench.condition}
                        self.failures.append({**failure, "message": answer.status})
        for label in wanted:
            self.scores += rows[label]
            self.journal.add(keys[label], rows[label], trials=[asdict(trial) for trial in store[label, point]])

    def _first(self, stress: Stress, one: Chosen) -> tuple[str, Scene]:
        """The first scene under a stress that an estimator reads."""
        return next(found for found in self.loaded.under(stress) if self._reads(one.label, found[0]))

    def _key(self, stress: Stress, one: Chosen) -> dict[str, str]:
        return {
            "modality": str(self._first(stress, one)[1].rig.kind), "suite": self.loaded.suite.suite,
            "estimator": one.label, "axis": stress.axis, "unit": axis_unit(stress.axis),
            "axis2": stress.axis2 or CELL_NONE, "unit2": axis_unit(stress.axis2) if stress.axis2 else "",
            "condition": self.bench.condition,
        }  # fmt: skip

    def _row(self, stress: Stress, one: Chosen, found: EdgeMap) -> dict[str, Any]:
        single = gain = math.nan
        level = calm_level(stress.values, found)
        key = self._journal_key(one.label, stress.axis, "stability", level)
        if key in self.journal.done:
            beside = self.journal.beside[key]
            single, gain = (math.nan if beside[name] is None else beside[name] for name in ("single", "gain"))
        elif level is not None:
            name, scene = self._first(stress, one)
            cell = self._cells(name, scene, stress, (level,))[0]
            outcomes, truth, bound = self.bench.variants(cell, one.label, VARIANTS)
            single = change_in_bounds(outcomes["float32"], outcomes["float64"], truth, bound)
            gain = change_in_bounds(outcomes["as-is"], outcomes["one-more"], truth, bound)
            self.journal.add(key, [], **without_nan({"single": single, "gain": gain}))
        return breakdown_row(self._key(stress, one), stress.values, found, float32_vs_64=single, gain_1dn=gain)
