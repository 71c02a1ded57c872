"""`beambench run`: generate, estimate, score and report a suite."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

if TYPE_CHECKING:
    from ..benchmarks.folders.progress import Progress
    from ..benchmarks.run import RunResult

__all__ = ["run"]


def run(
    suite: str | Path | Mapping[str, Any],
    *,
    overrides: Mapping[str, Any] | None = None,
    estimators: Sequence[str] | None = None,
    split: Literal["dev", "test"] = "test",
    out: str | Path | None = None,
    resume: bool = False,
    overwrite: bool = False,
    report: bool = True,
    cache: bool = False,
    progress: Progress | None = None,
    command: Sequence[str] = (),
) -> RunResult:
    """Run a suite and return what it left: `out` (folder), `rows` (of scores.csv), `report` (page), `failures`.

    Main arguments:
        suite: a name that ships, a path to a .toml or .json file, or plain data.
        overrides: {path: value}, applied before validation; a path of the suite, or one of every scene.
    Other arguments:
        estimators: labels to run instead of the suite's. split: which seeds to score on.
        out: folder; ./beambench-runs/<suite>-<time> by default. resume, overwrite: what to do where it exists.
        cache: take answers that an earlier run measured on this machine, with their times, and keep the new ones.
        report: write report.html. progress: told of every step. command: what was typed, for run.json.

    Raises:
        InputError: bad input, before anything is generated. A failing estimator is a row with its status, no error.
    """
    from ..benchmarks.folders.progress import silent
    from ..benchmarks.run import run_suite
    from ..benchmarks.runner.estimator_labels import check_estimators

    changes = dict(overrides or {})
    if isinstance(estimators, str):
        check_estimators(estimators)  # which refuses it: its letters would pass for a list of labels
    if estimators:
        changes["estimators"] = list(estimators)
    return run_suite(
        suite,
        out,
        overrides=changes,
        split=split,
        resume=resume,
        overwrite=overwrite,
        report=report,
        cache=cache,
        progress=progress or silent,
        command=list(command),
    )
