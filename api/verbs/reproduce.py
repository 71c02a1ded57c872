"""`beambench reproduce`: the numbers and figures of Guo et al. 2017, with a verdict on each."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from ..benchmarks.reproduce.run import Reproduction

__all__ = ["reproduce"]


def reproduce(
    *,
    out: str | Path | None = None,
    overwrite: bool = False,
    pictures: bool = True,
    progress: Callable[[str], None] | None = None,
) -> Reproduction:
    """Recompute the equations, figures and tables of Guo et al. 2017, sections 2 to 5, with a verdict on each.

    All random seeds are fixed, so reproduction.csv has the same bytes in every run on one machine.

    Main arguments:
        out: Folder of the results; ./beambench-runs/reproduce-<time> by default.
    Other arguments:
        overwrite: Replace an earlier output, once the new one is complete.
        pictures: Draw charts, raw images and surfaces.
        progress: Receives a line for each part.

    Returns:
        The result: `out` (folder), `rows` (of reproduction.csv), `page` (reproduction.html) and `wall_s`.

    Raises:
        InputError: The output exists, or cannot be written.
    """
    from dataclasses import replace

    from ..benchmarks.folders.kinds import REPRODUCE
    from ..benchmarks.folders.workplace import output_folder, workplace
    from ..benchmarks.reproduce.run import reproduce as run

    folder = output_folder(out, "reproduce", resume=False, overwrite=overwrite)
    with workplace(folder, REPRODUCE, overwrite=overwrite) as work:
        result = run(work, pictures=pictures, say=progress)
    return replace(result, out=folder, page=folder / result.page.name)
