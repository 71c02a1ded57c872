"""`beambench sweep`: where the estimators of a suite break down along its stresses."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

if TYPE_CHECKING:
    from ..benchmarks.folders.progress import Progress
    from ..benchmarks.search.sweep import SweepResult

__all__ = ["sweep"]


def sweep(
    suite: str | Path | Mapping[str, Any],
    *,
    overrides: Mapping[str, Any] | None = None,
    estimators: Sequence[str] | None = None,
    split: Literal["dev", "test"] = "test",
    budget: int = 16,
    depth: int = 2,
    out: str | Path | None = None,
    resume: bool = False,
    overwrite: bool = False,
    report: bool = True,
    progress: Progress | None = None,
    command: Sequence[str] = (),
) -> SweepResult:
    """Map failures along every stress of a suite, and return what it left: `rows` (of breakdown.csv), `maps` (of
    failure_map.csv), `pictures`, `report`, `out`.

    Levels are halved where the failure rate passes 10 and 50 %, until the interval of that level is narrow; over two
    axes, cells on the edge are halved. A suite needs five lines: suite, scenes, estimators, stresses, seeds.

    Main arguments:
        suite: a name that ships, a path to a .toml or .json file, or plain data.
        overrides: {path: value}, applied before validation.
    Other arguments:
        estimators: labels to sweep instead of the suite's. split: which seeds.
        budget: levels at most, per estimator and axis. depth: halvings of the cells of a grid.
        out: folder; ./beambench-runs/<suite>-<time> by default. resume: keep what an interrupted sweep measured
            there. overwrite: replace it.
        report: write report.html. progress: told of every step. command: what was typed, for run.json.

    Raises:
        InputError: bad input, before anything is generated.
    """
    from ..benchmarks.folders.progress import silent
    from ..benchmarks.runner.estimator_labels import check_estimators
    from ..benchmarks.search.sweep import sweep_suite

    changes = dict(overrides or {})
    if isinstance(estimators, str):
        check_estimators(estimators)  # which refuses it: its letters would pass for a list of labels
    if estimators:
        changes["estimators"] = list(estimators)
    return sweep_suite(
        suite,
        out,
        overrides=changes,
        split=split,
        budget=budget,
        depth=depth,
        resume=resume,
        overwrite=overwrite,
        report=report,
        progress=progress or silent,
        command=list(command),
    )
