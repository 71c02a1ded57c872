"""Run a suite: generate → store → estimate → score → report. One capture is in memory at a time."""

from __future__ import annotations

import time
import warnings
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from .ahead import Ahead
from .folders.files import write_json
from .folders.journal import Journal
from .folders.kinds import RUN
from .folders.progress import Progress, silent
from .folders.record import TABLES_VERSION, machine, now, versions
from .folders.workplace import output_folder, workplace
from .measure import Measuring
from .report.above_bound import bound_warnings
from .runner.costs import slow_starts, write_costs
from .runner.estimator_labels import check_estimators
from .runner.forked import Prepared
from .runner.jail import NO_JAIL, isolation, jailed
from .runner.result_cache import ResultCache
from .runner.spool import Entry, Spool
from .scores.error_tiles import write_tiles
from .scores.inputs import write_inputs
from .scores.resolution import resolution_warnings, write_resolution
from .scores.slips import slip_warnings
from .scores.tables import sort_rows, write_tables
from .statistics.skips import skips_of
from .suites.declared import declared_note
from .suites.sealed import Key
from .suites.spec import Split, check_split
from .suites.suite import Cell, cells_of, check_rungs, load_suite

__all__ = ["RunResult", "run_suite"]

#: Captures are written for the child processes up to this total size; then all estimators run on them.
_SPOOL_BYTES = 2 * 2**30


@dataclass
class RunResult:
    """Result of a run: its folder, the rows of its table, the warnings, and the path of the page.

    `rungs`: those that each scene was generated with (`Rungs.rows`); `advice`: what to type where a dearer one would matter, or "".
    """

    out: Path
    rows: list[dict[str, Any]]
    warnings: list[str]
    failures: list[dict[str, str]]
    report: Path | None
    wall_s: float
    stages: dict[str, float] = field(default_factory=dict)
    rungs: list[dict[str, Any]] = field(default_factory=list)
    advice: str = ""


def run_suite(
    suite: str | Path | Mapping[str, Any],
    out: str | Path | None = None,
    *,
    overrides: Mapping[str, Any] | None = None,
    split: Split = "test",
    sealed: Key | None = None,
    resume: bool = False,
    overwrite: bool = False,
    report: bool = True,
    cache: bool = False,
    progress: Progress = silent,
    command: list[str] | None = None,
) -> RunResult:
    """Run a suite and write its folder: captures/, the tables, run.json, pictures/ and report.html.

    Main arguments:
        suite: name, path or plain data. out: the output folder, by default ./beambench-runs/<suite>-<time>.
    Other arguments:
        overrides: {path: value}; see `load_suite`. split: the seeds to score on. sealed: a key whose seeds take their place.
        resume: whether to continue an interrupted run of the same suite. overwrite: whether to replace an earlier run. It is
            replaced when the new one, in `out`/unfinished until then, is complete.
        cache: whether to reuse results, with their times, that an earlier run measured on this machine, and store new ones.
        report: whether to write the page. progress: called at every step. command: the command line, for run.json.

    An estimator that fails has a row with its status, and the run continues. Raises InputError for invalid input, before
    anything is generated.
    """
    start = time.perf_counter()
    loaded = load_suite(suite, overrides)
    check_split(split)
    chosen = check_estimators(loaded.suite.estimators, beside=suite)
    cells = cells_of(loaded, split, sealed)
    check_rungs(cells, loaded.suite.rtol)
    folder = output_folder(out, loaded.suite.suite, resume=resume, overwrite=overwrite)
    settings: dict[str, Any] = {"verb": RUN.verb, "split": split, "sealed": sealed.name if sealed else ""}

    def check(held: Path) -> None:
        Journal.check(held, loaded.hash, **settings)

    with workplace(folder, RUN, resume=resume, overwrite=overwrite, check=check) as work:
        journal = Journal(work, loaded.hash, **settings)
        run = Measuring(loaded, chosen, work, journal, progress, cells, ResultCache() if cache else None)
        run.rungs.suite = str(suite) if isinstance(suite, str | Path) else loaded.suite.suite
        result = _run_in(
            work, run, cells, settings | {"overrides": dict(overrides or {}), "command": command or []}, report
        )
    page = folder / result.report.name if result.report is not None else None
    return replace(result, out=folder, report=page, wall_s=time.perf_counter() - start)


def _run_in(folder: Path, run: Measuring, cells: list[Cell], settings: dict[str, Any], report: bool) -> RunResult:
    """Run all cells, and write the folder."""
    loaded, progress = run.loaded, run.progress
    began = now()
    with (
        Spool() as spool,
        Prepared([one.label for one in run.chosen]) as run.prepared,
        Ahead([one.label for one in run.chosen]) as run.ahead,
        warnings.catch_warnings(record=True) as caught,
    ):
        warnings.simplefilter("default")
        batch: list[Entry] = []
        for index, cell in enumerate(cells):
            progress("generate", index, len(cells), cell.scene_name)
            batch.append(run.spool_cell(spool, index, cell))
            if sum(entry.bytes for entry in batch) > _SPOOL_BYTES:
                run.estimate(spool, batch)
                batch = []
        progress("generate", len(cells), len(cells), "")
        run.estimate(spool, batch)
    run.warnings = list(dict.fromkeys(f"{item.category.__name__}: {item.message}" for item in caught))
    rows = sort_rows(run.rows)
    tick = time.perf_counter()
    write_tables(folder, rows, run.tiles, jail=jailed())
    run.warnings += bound_warnings(folder) + [f"TimeWarning: {sentence}" for sentence in slow_starts(run.costs)]
    run.warnings += [] if jailed() else [f"IsolationWarning: {NO_JAIL}"]
    run.warnings += [f"ResolutionWarning: {sentence}" for sentence in resolution_warnings(run.resolution)]
    run.warnings += [f"SlipWarning: {sentence}" for sentence in slip_warnings(run.slips)]
    run.warnings += [f"DeclaredWarning: {note}" for _, scene in loaded.scenes if (note := declared_note(scene))]
    write_costs(folder, run.costs)
    write_resolution(folder, run.resolution)
    write_tiles(folder, run.tiles)
    write_inputs(folder, run.inputs)
    run.stages["tables"] = time.perf_counter() - tick
    record = {
        "suite": loaded.suite.suite, "title": loaded.suite.title, "version": loaded.suite.version, "hash": loaded.hash,
        "seeds": list(dict.fromkeys(cell.seed for cell in cells)), "captures": len(cells),
        "conditions": list(loaded.suite.conditions), "estimators": list(loaded.suite.estimators),
        "started": began, "finished": now(), **settings,
        "stages_s": run.rounded_stages(),
        "tables_version": TABLES_VERSION, "machine": machine(), "versions": versions(), "isolation": isolation(),
        "warnings": run.warnings, "failures": run.failures,
        "rungs": run.rungs.rows(), "advice": run.rungs.advice(), "skipped": skips_of(rows),
        "answers_from_cache": run.cache.hits if run.cache is not None else 0,
    }  # fmt: skip
    write_json(folder / "run.json", record)
    page = None
    if report:
        from .report.page import write_report

        progress("report", 0, 1, "report.html")
        tick = time.perf_counter()
        page = write_report(folder)
        run.stages["report"] = time.perf_counter() - tick
        write_json(folder / "run.json", record | {"stages_s": run.rounded_stages()})
        progress("report", 1, 1, page.name)
    return RunResult(
        folder, rows, run.warnings, run.failures, page, 0.0, run.stages, run.rungs.rows(), run.rungs.advice()
    )
