"""`beambench reproduce`: the numbers and figures of the first document, with a verdict on each."""

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
    """Recompute every equation, figure and table of document 000, sections 2 to 5, and return what was left.

    The result has `out` (folder), `rows` (of reproduction.csv), `page` (reproduction.html) and `wall_s`. All seeds are
    fixed: reproduction.csv is the same bytes on every run of one machine.

    Main arguments:
        out: folder; ./beambench-runs/reproduce-<time> by default.
    Other arguments:
        overwrite: replace an earlier output, once the new one is complete. pictures: draw charts and surfaces.
        progress: told of each part.

    Raises:
        InputError: the output exists, or cannot be written.
    """
    from dataclasses import replace

    from ..benchmarks.folders.kinds import REPRODUCE
    from ..benchmarks.folders.workplace import output_folder, workplace
    from ..benchmarks.reproduce.run import reproduce as run

    folder = output_folder(out, "reproduce", resume=False, overwrite=overwrite)
    with workplace(folder, REPRODUCE, overwrite=overwrite) as work:
        result = run(work, pictures=pictures, say=progress)
    return replace(result, out=folder, page=folder / result.page.name)
