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
    """Search scenes and stresses for where an estimator fails against its neighbours, and shrink the find to a suite of
    at most ten lines that `beambench run` repeats.

    Main arguments:
        name: the estimator's label, `name` or `name[key=value,...]`.
        neighbours: labels that it is compared with; one of each family by default.
        scenes: names or paths, the plainest first.
    Other arguments:
        overrides: {path: value} of every scene. side: rows and columns of the captures.
        factor: how many times worse than the best neighbour (and than itself usually) counts as a failure.
        budget: candidates judged. seed: of search and captures. out: folder. overwrite: replace an earlier one, once
            the new one is complete.
        progress: told of every candidate. command: what was typed, for run.json.

    Raises:
        InputError: bad input, before anything is searched.
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
