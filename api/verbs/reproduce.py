"""`beambench reproduce`: the numbers and figures of Guo et al. 2017, with a verdict on each."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Literal

if TYPE_CHECKING:
    from ..benchmarks.reproduce.run import Reproduction

__all__ = ["reproduce"]


def reproduce(
    *,
    out: str | Path | None = None,
    only: Literal["000", "001"] | None = None,
    overwrite: bool = False,
    pictures: bool = True,
    progress: Callable[[str], None] | None = None,
) -> Reproduction:
    """Recompute the equations, figures and tables of Guo et al. 2017, sections 2 to 6, with a verdict on each.

    Rows on the predicted range errors of Kusters 1992 follow.

    All random seeds are fixed, so reproduction.csv has the same bytes in every run on one machine.

    Main arguments:
        out: Folder of the results; ./beambench-runs/reproduce-<time> by default.
    Other arguments:
        only: Document whose rows are computed: 000 is Guo et al. 2017, 001 is Kusters 1992 (chapter 3).
        overwrite: Replace an earlier output, once the new one is complete.
        pictures: Draw charts, raw images and surfaces.
        progress: Receives a line for each part.

    Returns:
        The result: `out` (folder), `rows` (of reproduction.csv), `page` (reproduction.html) and `wall_s`.

    Raises:
        InputError: The output exists or cannot be written, or there is no such document.
    """
    from ..scenes.errors import InputError

    if only not in (None, "000", "001"):
        raise InputError("There is no such document.", where="only", value=only, allowed="000, 001")
    from dataclasses import replace

    from ..benchmarks.folders.kinds import REPRODUCE
    from ..benchmarks.folders.workplace import output_folder, workplace
    from ..benchmarks.reproduce.run import reproduce as run

    folder = output_folder(out, "reproduce", resume=False, overwrite=overwrite)
    with workplace(folder, REPRODUCE, overwrite=overwrite) as work:
        result = run(work, only=only, pictures=pictures, say=progress)
    return replace(result, out=folder, page=folder / result.page.name)
