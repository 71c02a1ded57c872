"""Estimators run on a store of captures: one HDF5 file each, continued after an interruption."""

from __future__ import annotations

import shutil
from collections.abc import Iterator, Sequence
from contextlib import ExitStack
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ...scenes.errors import InputError
from ...scenes.json_keys import read_json

if TYPE_CHECKING:
    from ...captures import CaptureSet
    from ...captures.estimates import EstimatesOutput
    from ..folders.progress import Progress
    from ..runner.estimator_labels import Chosen
    from ..runner.session import Job, Outcome
    from ..suites.spec import Limits

__all__ = ["asked_of", "check_same_captures", "check_some_read", "estimate_store"]


def estimate_store(
    captures: CaptureSet, labels: Sequence[str], folder: Path, limits: Limits, resume: bool, tell: Progress
) -> None:
    """Run estimators on all captures and write one file each, `<label>.h5`, and estimates.json, which lists them and tells how many
    captures each one answered.

    Main arguments:
        captures: The store.
        labels: The estimators.
        folder: Where to write. With `resume` it may hold earlier estimates of the same captures; they are kept unless one of
            them failed.
        limits: Time and memory per capture.
        tell: Receives the progress.
    """
    from ..folders.files import write_json
    from ..folders.kinds import slug

    held = _index(folder).get("estimators") if resume else None
    listed = dict.fromkeys([*(held if isinstance(held, list) else []), *labels])
    record = {
        "schema_version": 1,
        "data": str(captures.path.resolve()),
        "captures_sha256": captures.sha256,
        "estimators": list(listed),
    }
    write_json(folder / "estimates.json", record)
    missing = [label for label in labels if not (resume and _finished(folder / f"{slug(label)}.h5", label, captures))]
    asked = {label: _told(len(captures) * ["ok"]) for label in labels}
    for label, statuses in _answers(captures, missing, folder, limits, tell):
        asked[label] = _told(statuses)
    write_json(folder / "estimates.json", record | {"asked": asked})


def _told(statuses: Sequence[str]) -> dict[str, Any]:
    """How many captures an estimator answered, of how many, and the first reason why not."""
    reasons = [status for status in statuses if status != "ok"]
    return {
        "captures": len(statuses),
        "answered": len(statuses) - len(reasons),
        "reason": reasons[0] if reasons else "",
    }


def asked_of(folder: Path) -> dict[str, dict[str, Any]]:
    """{label: captures, answered, reason} of the estimators that the last `estimate` into a folder was asked for."""
    return dict(_index(folder).get("asked", {}))


def check_some_read(captures: CaptureSet, chosen: Sequence[Chosen]) -> None:
    """Refuse captures that none of the estimators reads. What a plug-in reads is not known before it runs.

    Raises:
        InputError: All of the estimators are built in and read other modalities.
    """
    from ...estimators import get_estimator
    from ...estimators.chain import is_built_in

    if not all(is_built_in(one.name) for one in chosen):
        return
    read = sorted({get_estimator(one.name).modality for one in chosen})
    if captures.modality not in read:
        raise InputError(
            "None of the named estimators reads captures of this modality.",
            where=str(captures.path),
            value=captures.modality,
            allowed=f"captures of modality {', '.join(read)}",
            next_step="beambench estimators list",
        )


def check_same_captures(folder: Path, captures: CaptureSet) -> None:
    """Refuse to continue a folder with estimates of other captures. Raises InputError."""
    if _index(folder).get("captures_sha256") != captures.sha256:
        raise InputError(
            "The folder holds estimates of other captures, or does not state of which captures.",
            where="--resume",
            value=str(folder),
            allowed=f"estimates of {captures.path}",
            next_step="--overwrite, or another --out",
        )


def _index(folder: Path) -> dict[str, Any]:
    """estimates.json of a folder; {} if it cannot be read."""
    try:
        index = read_json((folder / "estimates.json").read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return {}
    return index if isinstance(index, dict) else {}


def _finished(path: Path, label: str, captures: CaptureSet) -> bool:
    """Whether a file holds an estimator's answers to all of the captures; a failure is tried anew."""
    from ...captures.estimates import read_estimates
    from ...captures.sizes import sizes_of

    if not path.is_file():
        return False
    sizes = sizes_of(captures.load(0))
    try:
        found = read_estimates(path, len(captures), sizes, modality=captures.modality, captures_sha256=captures.sha256)
    except InputError:
        return False
    return found.label == label and all(status == "ok" or status.startswith("skip:") for status in found.status)


def _answers(
    captures: CaptureSet, labels: list[str], folder: Path, limits: Limits, tell: Progress
) -> Iterator[tuple[str, list[str]]]:
    """Write the file of each estimator, one after the other; (label, status of every capture).

    One capture at a time lies in the temporary folder, and one answer is in memory.
    """
    from ...captures.estimates import estimates_output
    from ..folders.kinds import slug
    from ..runner.scratch import scratch_folder
    from ..runner.session import run_jobs
    from ..runner.spool import unusable

    if not labels:
        return
    with ExitStack() as folders:
        try:
            scratch = folders.enter_context(scratch_folder("estimate"))
        except OSError as error:
            raise unusable(error) from error
        spool = _Captures(captures, scratch)
        jobs = spool.jobs()
        done = 0
        for label in labels:
            with estimates_output(folder / f"{slug(label)}.h5", label, captures.modality, captures.sha256) as output:

                def keep(outcome: Outcome, label: str = label, output: EstimatesOutput = output) -> None:
                    nonlocal done
                    costs = (outcome.cpu_s, outcome.wall_s, outcome.peak_bytes)
                    output.add(outcome.arrays if outcome.status == "ok" else None, outcome.stage, costs, outcome.status)
                    done += 1
                    tell("estimate", done, len(jobs) * len(labels), f"{label}: {outcome.status}")

                run_jobs(label, jobs, limits, scratch / slug(label), keep, lay=spool.lay, clear=spool.clear)
            yield label, output.status


class _Captures:
    """The captures without their truth, each in a folder of its own while it is read."""

    def __init__(self, captures: CaptureSet, scratch: Path) -> None:
        self._captures, self._scratch = captures, scratch

    def jobs(self) -> list[Job]:
        """One job per capture. All captures of a store have one layout, and so one set of sizes."""
        from ...captures.hide import hide_truth
        from ...captures.sizes import sizes_of
        from ..runner.session import Job

        sizes = sizes_of(hide_truth(self._captures[0]))
        modality = self._captures.modality
        return [
            Job(index, self._scratch / f"{index:06d}", "matched", modality, sizes)
            for index in range(len(self._captures))
        ]

    def lay(self, job: Job) -> None:
        """Write a capture where its job looks for it. Raises InputError."""
        from ...captures.hide import hide_truth
        from ..runner.protocol import write_capture, write_meta
        from ..runner.spool import unusable

        if job.folder.exists():
            return  # the warm-up has read it, or a child before this one
        hidden = hide_truth(self._captures[job.index])
        try:
            write_capture(job.folder, hidden)
            write_meta(job.folder, hidden, "matched")
        except OSError as error:
            raise unusable(error) from error

    def clear(self, job: Job) -> None:
        """Remove a capture."""
        shutil.rmtree(job.folder, ignore_errors=True)
