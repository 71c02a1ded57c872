"""`beambench run`: generate, estimate, score and report a suite."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

from .suite_changes import suite_changes

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
    sealed: str | Path | None = None,
    out: str | Path | None = None,
    resume: bool = False,
    overwrite: bool = False,
    report: bool = True,
    cache: bool = False,
    progress: Progress | None = None,
    command: Sequence[str] = (),
) -> RunResult:
    """Generate, estimate, score and report a suite; `quickstart` is the demo.

    An estimator that fails is a row of the table with its status; the command succeeds unless all of them do. Estimators run in
    child processes, whose times the runner measures, in a jail where the kernel offers one: docs/reliability.md says what is
    promised.

    Main arguments:
        suite: Name of a suite that ships with Beambench, or a .toml or .json file; in Python also a suite as data.
        overrides: {path: value}, applied before validation; a path of the suite, or one of every scene.
    Other arguments:
        estimators: Run this estimator instead of those of the suite: name or name[key=value,...].
        split: Seeds of the suite to use: tune parameters on dev, publish results of test.
        sealed: File of a secret key: as many captures with seeds that nobody knows take the place of the suite's
            (docs/challenges.md).
        out: Folder of the results; ./beambench-runs/<suite>-<time> by default.
        resume: Continue an interrupted run in `out`.
        overwrite: Replace an earlier run in `out`.
        report: Write the page report.html.
        cache: Take results that an earlier run measured on this machine (same capture, source code and parameters), with
            their times, which are marked as such, and keep the new ones. Failures are never kept.
        progress: Receives every step.
        command: What was typed, for run.json.

    Returns:
        The result: `out` (folder), `rows` (of scores.csv), `report` (page), `failures`, `warnings` and `wall_s`.

    Raises:
        InputError: Bad input, before anything is generated.
    """
    from ..benchmarks.folders.progress import silent
    from ..benchmarks.run import run_suite
    from ..benchmarks.suites.sealed import read_key

    return run_suite(
        suite,
        out,
        overrides=suite_changes(overrides, estimators),
        split=split,
        sealed=None if sealed is None else read_key(sealed),
        resume=resume, overwrite=overwrite, report=report, cache=cache, progress=progress or silent, command=list(command),
    )  # fmt: skip
