"""`beambench sweep`: where the estimators of a suite break down along its stresses."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

from .suite_changes import suite_changes

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
    """Find the level of each stress at which each estimator breaks down, with its interval and mode.

    An estimator breaks down where it fails on 10 or 50 % of the elements. Intervals of levels are halved around these
    points until they are narrow; over two axes, the cells at the edge are halved. An axis is a path of the scene, or a name:
    photons, background, incidence, delay-step, jitter, wrong-index and others.

    Main arguments:
        suite: Name of a suite that ships with Beambench, or a .toml or .json file; in Python also a suite as data. Its
            stresses run from harmless to breaking.
        overrides: {path: value}, applied before validation.
    Other arguments:
        estimators: Sweep this estimator instead of those of the suite: name or name[key=value,...].
        split: Seeds of the suite to use: tune parameters on dev, publish results of test.
        budget: Largest number of levels per estimator and axis.
        depth: Halvings of the cells at the edge of a two-dimensional grid.
        out: Folder of the results; ./beambench-runs/<suite>-<time> by default.
        resume: Continue an interrupted sweep in `out`.
        overwrite: Replace an earlier sweep in `out`.
        report: Write the page report.html.
        progress: Receives every step.
        command: What was typed, for run.json.

    Returns:
        The result: `rows` (of breakdown.csv), `maps` (of failure_map.csv), `pictures`, `report` and `out`.

    Raises:
        InputError: Bad input, before anything is generated.
    """
    from ..benchmarks.folders.progress import silent
    from ..benchmarks.search.sweep import sweep_suite

    return sweep_suite(
        suite,
        out,
        overrides=suite_changes(overrides, estimators),
        split=split,
        budget=budget,
        depth=depth,
        resume=resume,
        overwrite=overwrite,
        report=report,
        progress=progress or silent,
        command=list(command),
    )
