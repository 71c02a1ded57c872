"""`beambench estimate`: run estimators on a store of captures."""

from __future__ import annotations

import json
import tempfile
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from ..benchmarks.folders.progress import Progress
    from ..benchmarks.suites.spec import Limits
    from ..captures import CaptureSet
    from ..captures.estimates import Estimates

__all__ = ["estimate"]


def estimate(
    data: str | Path,
    estimators: Sequence[str],
    *,
    out: str | Path | None = None,
    resume: bool = False,
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
        out: folder of the estimates. resume: keep the estimators whose answers to these captures are there, and add the
            others. overwrite: replace what is there, once all new ones are complete.
        time_limit_s, memory_limit_bytes: per capture.
        progress: told of every capture.

    Raises:
        InputError: no such store or estimator, a duplicate label, an impossible limit, or an output that exists or is the
            input.
    """
    from ..benchmarks.folders.files import write_json
    from ..benchmarks.folders.kinds import ESTIMATE, slug
    from ..benchmarks.folders.progress import silent
    from ..benchmarks.folders.workplace import output_folder, workplace
    from ..benchmarks.runner.estimator_labels import check_estimators
    from ..benchmarks.suites.spec import Limits
    from ..captures import open_captures
    from ..captures.estimates import write_estimates
    from ..scenes.errors import InputError
    from ..scenes.validate import validate_spec

    labels = [chosen.label for chosen in check_estimators(estimators)]
    if not labels:
        raise InputError("No estimator is named.", where="-e", next_step="beambench estimators list")
    given = {"time_s": time_limit_s, "memory_bytes": memory_limit_bytes}
    limits = validate_spec(Limits, given, "--time-limit-s, --memory-limit-bytes")
    captures = open_captures(data)
    told: dict[str, Any] = {"schema_version": 1, "data": str(Path(data).resolve()), "captures_sha256": captures.sha256}

    def check(held: Path) -> None:
        _check(held, captures.sha256, data)

    name = slug(Path(f"estimates-{Path(data).name}").stem)
    folder = output_folder(out, name, resume=resume, overwrite=overwrite)
    with workplace(folder, ESTIMATE, resume=resume, overwrite=overwrite, inputs=[data], check=check) as work:
        held = _index(work).get("estimators") if resume else None
        listed = dict.fromkeys([*(held if isinstance(held, list) else []), *labels])
        write_json(work / "estimates.json", told | {"estimators": list(listed)})
        missing = [label for label in labels if not (resume and _finished(work / f"{slug(label)}.h5", label, captures))]
        for found in _answers(captures, missing, limits, progress or silent):
            write_estimates(work / f"{slug(found.label)}.h5", found)
    return folder


def _index(folder: Path) -> dict[str, Any]:
    """estimates.json of a folder, {} where it cannot be read."""
    try:
        found = json.loads((folder / "estimates.json").read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return {}
    return found if isinstance(found, dict) else {}


def _check(folder: Path, sha256: str, data: str | Path) -> None:
    """Refuse to go on with estimates of other captures."""
    from ..scenes.errors import InputError

    if _index(folder).get("captures_sha256") != sha256:
        raise InputError(
            "The folder holds estimates of other captures, or does not tell of which.",
            where="--resume",
            value=str(folder),
            allowed=f"estimates of {data}",
            next_step="--overwrite, or another --out",
        )


def _finished(path: Path, label: str, captures: CaptureSet) -> bool:
    """Whether a file holds an estimator's answers to all of the captures; a failure is tried anew."""
    from ..captures.estimates import read_estimates
    from ..captures.sizes import sizes_of
    from ..scenes.errors import InputError

    if not path.is_file():
        return False
    sizes = sizes_of(captures.load(0))
    try:
        found = read_estimates(path, len(captures), sizes, modality=captures.modality, captures_sha256=captures.sha256)
    except InputError:
        return False
    return found.label == label and all(status == "ok" or status.startswith("skip:") for status in found.status)


def _answers(captures: CaptureSet, labels: list[str], limits: Limits, tell: Progress) -> Iterator[Estimates]:
    """What each estimator answers to all captures, one estimator after the other."""
    from ..benchmarks.folders.kinds import slug
    from ..benchmarks.runner.protocol import write_capture, write_meta
    from ..benchmarks.runner.session import Job, Outcome, run_jobs
    from ..benchmarks.runner.spool import unusable
    from ..captures.estimates import Estimates
    from ..captures.hide import hide_truth
    from ..captures.sizes import sizes_of

    if not labels:
        return
    try:
        space = tempfile.TemporaryDirectory(prefix="beambench-")
    except OSError as error:
        raise unusable(error) from error
    with space as scratch:
        jobs = []
        for index in range(len(captures)):
            hidden = hide_truth(captures[index])
            place = Path(scratch) / f"{index:06d}"
            try:
                write_capture(place, hidden)
                write_meta(place, hidden, "matched")
            except OSError as error:
                raise unusable(error) from error
            sizes = sizes_of(hidden)
            jobs.append(Job(index, place, "matched", str(hidden.attrs["modality"]), sizes))
        done = 0
        for label in labels:
            outcomes: list[Outcome] = []

            def keep(outcome: Outcome, label: str = label, outcomes: list[Outcome] = outcomes) -> None:
                nonlocal done
                outcomes.append(outcome)
                done += 1
                tell("estimate", done, len(jobs) * len(labels), f"{label}: {outcome.status}")

            run_jobs(label, jobs, limits, Path(scratch) / slug(label), keep)
            yield Estimates(
                label,
                captures.modality,
                [o.arrays if o.status == "ok" else None for o in outcomes],
                [o.cpu_s for o in outcomes],
                [o.wall_s for o in outcomes],
                [o.peak_bytes for o in outcomes],
                [o.status for o in outcomes],
                captures.sha256,
                outcomes[0].stage.word,
            )
