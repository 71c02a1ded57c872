"""`beambench estimate`: run estimators on a store of captures."""

from __future__ import annotations

import json
import tempfile
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from .output import claim, slug

if TYPE_CHECKING:
    from .benchmarks.progress import Progress

__all__ = ["estimate"]


def estimate(
    data: str | Path,
    estimators: Sequence[str],
    *,
    out: str | Path | None = None,
    overwrite: bool = False,
    time_limit_s: float = 600.0,
    memory_limit_bytes: int = 8 * 2**30,
    progress: Progress | None = None,
) -> Path:
    """Run each estimator on every capture of a store and write one HDF5 file per estimator.

    Each estimator runs in its own child process with one thread, sees no truth, and is stopped at the limits; a crash
    or a wrong answer becomes the `status` of that capture.

    Main arguments:
        data: a store of captures. estimators: labels, `name` or `name[key=value,...]`.
    Other arguments:
        out: folder of the estimates. time_limit_s, memory_limit_bytes: per capture.
        progress: told of every capture.

    Raises:
        InputError: no such store or estimator, a duplicate label, or an output that exists.
    """
    from .benchmarks.estimator_labels import check_estimators
    from .benchmarks.progress import silent
    from .benchmarks.protocol import RESULT, write_capture, write_meta
    from .benchmarks.runner import Job, Outcome, run_jobs
    from .benchmarks.suite_spec import Limits
    from .captures.hide import hide_truth
    from .captures.store import open_captures
    from .estimates import Estimates, write_estimates
    from .scenes.errors import InputError

    tell = progress or silent
    labels = [chosen.label for chosen in check_estimators(estimators)]
    if not labels:
        raise InputError("No estimator is named.", where="-e", next_step="beambench estimators list")
    captures = open_captures(data)
    limits = Limits(time_s=time_limit_s, memory_bytes=memory_limit_bytes)
    folder = claim(out, f"estimates-{Path(data).name}", overwrite=overwrite)
    with tempfile.TemporaryDirectory(prefix="beambench-") as scratch:
        jobs = []
        for index in range(len(captures)):
            hidden = hide_truth(captures[index])
            place = Path(scratch) / f"{index:06d}"
            write_capture(place, hidden)
            write_meta(place, hidden, "matched")
            shape = tuple(int(hidden.sizes[dim]) for dim in RESULT[captures.modality][1])
            jobs.append(Job(index, place, "matched", str(hidden.attrs["modality"]), shape))
        folder.mkdir(parents=True, exist_ok=True)
        index_file = folder / "estimates.json"
        index_file.write_text(
            json.dumps({"schema_version": 1, "data": str(Path(data).resolve()), "estimators": labels})
        )
        done = 0
        for label in labels:
            outcomes: list[Outcome] = []

            def keep(outcome: Outcome, label: str = label, outcomes: list[Outcome] = outcomes) -> None:
                nonlocal done
                outcomes.append(outcome)
                done += 1
                tell("estimate", done, len(jobs) * len(labels), f"{label}: {outcome.status}")

            run_jobs(label, jobs, limits, Path(scratch) / slug(label), keep)
            write_estimates(
                folder / f"{slug(label)}.h5",
                Estimates(
                    label,
                    captures.modality,
                    [o.arrays if o.status == "ok" else None for o in outcomes],
                    [o.cpu_s for o in outcomes],
                    [o.wall_s for o in outcomes],
                    [o.peak_bytes for o in outcomes],
                    [o.status for o in outcomes],
                ),
            )
    return folder
