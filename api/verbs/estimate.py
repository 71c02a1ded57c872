"""`beambench estimate`: run estimators on a store of captures."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from ..benchmarks.folders.progress import Progress

__all__ = ["estimate"]


def estimate(
    data: str | Path,
    estimators: Sequence[str] = (),
    *,
    out: str | Path | None = None,
    resume: bool = False,
    overwrite: bool = False,
    time_limit_s: float = 600.0,
    memory_limit_bytes: int = 8 * 2**30,
    progress: Progress | None = None,
) -> Path:
    """Run estimators on a store of captures; each runs in its own process and sees no truth.

    One HDF5 file per estimator is written. An estimator runs with one thread and is stopped at the limits; a crash or a
    wrong answer becomes the status of that capture; estimates.json tells how many captures each estimator answered.

    Main arguments:
        data: A store of captures.
        estimators: An estimator, as name or name[key=value,...]; at least one is needed.
    Other arguments:
        out: Folder of the estimates; ./beambench-runs/<name>-<time> by default.
        resume: Keep the earlier estimates of these captures in `out`, and add the missing ones.
        overwrite: Replace earlier estimates, once all new ones are complete.
        time_limit_s: Longest wall time per capture, s.
        memory_limit_bytes: Largest resident memory of an estimator, bytes.
        progress: Receives every capture.

    Returns:
        The folder of the estimates.

    Raises:
        InputError: No such store or estimator, no estimator that reads such captures, a label given twice, an impossible
            limit, or an output that exists or is the input.
    """
    from ..benchmarks.datasets.estimate import check_same_captures, check_some_read, estimate_store
    from ..benchmarks.folders.kinds import ESTIMATE, slug
    from ..benchmarks.folders.progress import silent
    from ..benchmarks.folders.workplace import output_folder, workplace
    from ..benchmarks.runner.estimator_labels import check_estimators
    from ..benchmarks.suites.spec import Limits
    from ..captures import open_captures
    from ..estimators.labels import each_label
    from ..scenes.errors import InputError
    from ..scenes.validate import validate_spec

    chosen = check_estimators(estimators if isinstance(estimators, str) else each_label(estimators))
    if not chosen:
        raise InputError("No estimator is named.", where="-e", next_step="beambench estimators list")
    given = {"time_s": time_limit_s, "memory_bytes": memory_limit_bytes}
    limits = validate_spec(Limits, given, "--time-limit-s, --memory-limit-bytes")
    captures = open_captures(data)
    check_some_read(captures, chosen)

    def check(held: Path) -> None:
        check_same_captures(held, captures)

    folder = output_folder(out, slug(Path(f"estimates-{Path(data).name}").stem), resume=resume, overwrite=overwrite)
    with workplace(folder, ESTIMATE, resume=resume, overwrite=overwrite, inputs=[data], check=check) as work:
        estimate_store(captures, [one.label for one in chosen], work, limits, resume, progress or silent)
    return folder
