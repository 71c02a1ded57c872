"""`beambench break`: find a scene in which an estimator fails and others do not."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from ..benchmarks.folders.progress import Progress
    from ..benchmarks.search.break_run import BreakResult

__all__ = ["break_"]


def break_(
    name: str,
    *,
    neighbours: Sequence[str] | None = None,
    scenes: Sequence[str] | None = None,
    overrides: Mapping[str, Any] | None = None,
    side: int = 24,
    factor: float = 3.0,
    budget: int = 300,
    seed: int = 0,
    out: str | Path | None = None,
    overwrite: bool = False,
    progress: Progress | None = None,
    command: Sequence[str] = (),
) -> BreakResult:
    """Search for a scene in which an estimator fails and its neighbours do not, and write it as a suite of at most ten lines.

    `beambench run` repeats that suite. The exit code is 0 whether or not a failure is found.

    Main arguments:
        name: The estimator, as name or name[key=value,...].
        neighbours: An estimator to compare with; one of each family by default.
        scenes: A scene to search, by name or file; give the plainest first.
    Other arguments:
        overrides: {path: value} of every scene.
        side: Rows and columns of the captures.
        factor: An estimator fails where its error is at least this many times that of the best neighbour, and its own error on the
            unchanged scenes.
        budget: Number of candidates to try before the scene is simplified.
        seed: Random seed of the search and of the captures.
        out: Folder of the results; ./beambench-runs/break-<name>-<time> by default.
        overwrite: Replace an earlier result in `out`, once the new one is complete.
        progress: Receives every candidate.
        command: What was typed, for run.json.

    Returns:
        The result: `found`, `spec` (the suite file), `ratio`, `scene`, `levels`, `judged` and `out`.

    Raises:
        InputError: Bad input, before anything is searched.
    """
    from ..benchmarks.folders.kinds import BREAK, slug
    from ..benchmarks.folders.progress import silent
    from ..benchmarks.folders.workplace import output_folder, workplace
    from ..benchmarks.search.break_run import break_estimator, plan_break

    plan = plan_break(
        name, neighbours=tuple(neighbours or ()), scenes=tuple(scenes or ()), overrides=overrides, side=side,
        factor=factor, budget=budget, seed=seed,
    )  # fmt: skip
    folder = output_folder(out, f"break-{slug(plan.target.name)}", resume=False, overwrite=overwrite)
    with workplace(folder, BREAK, overwrite=overwrite) as work:
        result = break_estimator(plan, work, progress=progress or silent, command=list(command))
    spec = folder / result.spec.name if result.spec is not None else None
    return replace(result, out=folder, spec=spec)
