"""The bench: keeps captures and estimators ready, so that a search can request one cell after another.

`run_suite` knows all its cells in advance; a failure map or a search for bugs chooses each cell from the results of the
earlier ones. Estimators run in the same supervised child processes, and are scored by the same functions, as in a run.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from types import TracebackType
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from ...captures.sizes import sizes_of
from ..runner.estimator_labels import Chosen
from ..runner.protocol import write_capture, write_meta
from ..runner.session import Job, Outcome, Session
from ..runner.spool import Entry, Spool
from ..scores.score import score_rows
from ..scores.truth import Bound, Truth, aligned, errors_of, failure_limit, single_valued
from ..statistics.skips import skipped_rows
from ..suites.suite import Cell, Limits
from .failure_rate import Trial

if TYPE_CHECKING:
    import xarray as xr

__all__ = ["Answer", "Bench", "trials_of"]

Float = npt.NDArray[np.float64]
Bool = npt.NDArray[np.bool_]

#: Captures stay on disk up to this total size; the oldest are deleted first, and generated again on request.
_KEPT_BYTES = 2**30


@dataclass(frozen=True)
class Answer:
    """Result of one estimator on one capture: its main quantity, over the n unmixed elements with truth.

    Main arguments:
        status: "ok", or the reason of a failure; then every element counts as failed. rows: rows of the score table.
        error (n): error in the unit of the quantity, NaN without an estimate. valid (n): the flags of the estimate.
        limit (n): |error| beyond which an element has failed.
    """

    status: str
    rows: list[dict[str, Any]]
    error: Float
    valid: Bool
    limit: Float

    @property
    def row(self) -> dict[str, Any]:
        """The score row of the unmixed elements."""
        return self.rows[0]


class Bench:
    """Generate cells and run estimators on them, on demand. Use in a `with` block.

    Main arguments:
        chosen: the estimators. limits: limits of their child processes.
    Other arguments:
        rtol: argument of the generator; the rung is the cell's. failure_at: see `score_rows`.
        condition: its name in tables. declare: (cell, capture without truth) -> the capture as it is given under the condition.
    """

    def __init__(
        self,
        chosen: Sequence[Chosen],
        limits: Limits,
        *,
        suite: str = "bench",
        rtol: float = 1e-3,
        failure_at: float | None = None,
        condition: str = "matched",
        declare: Callable[[Cell, xr.Dataset], xr.Dataset] | None = None,
    ) -> None:
        self.chosen = {one.label: one for one in chosen}
        self.limits, self.suite, self.failure_at, self.condition = limits, suite, failure_at, condition
        self.captures_made = 0
        self._rtol, self._declare = rtol, declare
        self._spool = Spool()
        self._kept: dict[tuple[Any, ...], Entry] = {}
        self._sessions: dict[str, Session] = {}
        self._count = 0

    def __enter__(self) -> Bench:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        for session in self._sessions.values():
            session.close(kill=kind is not None)
        self._spool.__exit__(kind, error, trace)

    def answer(
        self, cells: Sequence[Cell], labels: Sequence[str] | None = None, *, timed: bool = False
    ) -> list[dict[str, Answer]]:
        """The result of each estimator on each cell, with its times and memory if `timed`."""
        answers: list[dict[str, Answer]] = []
        for cell in cells:
            entry = self._entry(cell)
            truth, bound = self._spool.truth(entry)
            found = {}
            for label in labels if labels is not None else self.chosen:
                job = Job(entry.index, entry.folder, self.condition, entry.modality, entry.sizes, timed)
                outcome = self._ask(label, job)
                if not self._spool.intact(entry):
                    outcome.status = "invalid: changed its input"
                    self._kept.pop(_key(cell))
                    self._spool.drop(entry)
                    entry = self._entry(cell)
                found[label] = self._score(cell, label, truth, bound, outcome)
            answers.append(found)
        return answers

    def variants(
        self, cell: Cell, label: str, changes: Mapping[str, Callable[[xr.Dataset], xr.Dataset]]
    ) -> tuple[dict[str, Outcome], Mapping[str, Truth], Mapping[str, Bound]]:
        """Outcomes of an estimator on changed versions of a cell's capture, and the truth and bound to score them with."""
        capture, hidden = self._generate(cell)
        outcomes = {}
        for name, change in changes.items():
            self._count += 1
            changed = change(hidden)
            folder = self._spool.open / f"variant-{self._count:06d}"
            write_capture(folder, changed)
            write_meta(folder, changed, self.condition)
            sizes = sizes_of(changed)
            modality = str(changed.attrs["modality"])
            outcomes[name] = self._ask(label, Job(self._count, folder, self.condition, modality, sizes, timed=False))
        from ..judges.bound import bounds_of, truths_of

        return outcomes, truths_of(capture), bounds_of(capture)

    def _ask(self, label: str, job: Job) -> Outcome:
        if label not in self._sessions:
            place = self._spool.open / f"estimator-{len(self._sessions)}"
            self._sessions[label] = Session(label, [], self.limits, place)
        session = self._sessions[label]
        session.jobs = [job]
        outcomes: list[Outcome] = []
        session.run(outcomes.append)
        return outcomes[0]

    def _generate(self, cell: Cell) -> tuple[xr.Dataset, xr.Dataset]:
        from ...captures.hide import hide_truth
        from ...generator.generate import generate

        fidelity: Any = cell.fidelity
        capture = generate(cell.scene, seed=cell.random_seed, capture_key=cell.key, fidelity=fidelity, rtol=self._rtol)
        self.captures_made += 1
        hidden = hide_truth(capture)
        if self._declare is not None:
            hidden = self._declare(cell, hidden)
        return capture, hidden

    def _entry(self, cell: Cell) -> Entry:
        from ..judges.bound import bounds_of, truths_of

        key = _key(cell)
        if key not in self._kept:
            while sum(entry.bytes for entry in self._kept.values()) > _KEPT_BYTES:
                self._spool.drop(self._kept.pop(next(iter(self._kept))))
            self._count += 1
            capture, hidden = self._generate(cell)
            conditions = {self.condition: lambda seen: hidden}
            self._kept[key] = self._spool.add(
                self._count, cell, capture, conditions, truths_of(capture), bounds_of(capture)
            )
        return self._kept[key]

    def _score(
        self, cell: Cell, label: str, truths: Mapping[str, Truth], bounds: Mapping[str, Bound], outcome: Outcome
    ) -> Answer:
        chosen = self.chosen[label]
        key = {
            "suite": self.suite, "scene": cell.scene_name, "stress": cell.stress, "level": cell.level,
            "stress2": cell.stress2, "level2": cell.level2, "seed": cell.seed, "condition": self.condition,
            "estimator": chosen.name, "params": chosen.params,
        }  # fmt: skip
        rows = score_rows(
            key, outcome.stage, truths, bounds, outcome.arrays or None, status=outcome.status, cpu_s=outcome.cpu_s,
            wall_s=outcome.wall_s, peak_bytes=outcome.peak_bytes, failure_at=self.failure_at,
        )  # fmt: skip
        rows = skipped_rows(rows)
        quantity = outcome.stage.gives[0]
        truth, bound = truths[quantity.name], bounds[quantity.name]
        chosen_elements = single_valued(truth)
        limit = failure_limit(bound.sigma[chosen_elements], bound, self.failure_at)
        nothing = np.full(limit.shape, math.nan)
        if outcome.status != "ok":
            return Answer(outcome.status, rows, nothing, np.zeros(limit.shape, bool), limit)
        value, _, answered = aligned(outcome.arrays, outcome.stage, quantity, truth.value.shape)
        valid = answered[chosen_elements]
        error = np.where(valid, errors_of(value, truth)[chosen_elements], math.nan)
        return Answer("ok", rows, error, valid, limit)


def _key(cell: Cell) -> tuple[Any, ...]:
    return (cell.scene_name, cell.scene.model_dump_json(), cell.seed, cell.key)


def trials_of(scene: str, seeds: Sequence[int], answers: Sequence[Answer]) -> list[Trial]:
    """Count the failures of one scene at one level, by seed and by mode.

    A failed element is biased if its displacement repeats: its usual error, the median over the other seeds, is at least
    half of its error, on the same side, and clearly larger than the spread of errors about their usual ones over seeds
    and failed elements (`_repeats`); else it is an outlier. With one seed the usual error is the capture's median, its
    spread that over elements. An element without a valid estimate is a refusal; in a capture without an estimate all
    elements count as crashes.
    """
    fine = [answer for answer in answers if answer.status == "ok"]
    trials = []
    with np.errstate(invalid="ignore"):
        far = [answer.valid & ~(np.abs(answer.error) <= answer.limit) for answer in fine]
    counts = iter(zip(fine, far, _repeats(fine, far), strict=True))
    for seed, answer in zip(seeds, answers, strict=True):
        n = int(answer.limit.size)
        if answer.status != "ok":
            trials.append(Trial(scene, seed, n, crash=n))
            continue
        a, bad, bias = next(counts)
        displaced = int((bad & bias).sum())
        trials.append(
            Trial(scene, seed, n, bias=displaced, outlier=int(bad.sum()) - displaced, refusal=int((~a.valid).sum()))
        )
    return trials


#: In robust standard deviations: the least size of a displacement relative to its spread, and the largest distance of errors
#: from it.
_STANDS_OUT = 2.0
_LIES_WITHIN = 3.0
_DEVIATIONS = 1.4826  # standard deviations of a normal law in its median absolute deviation


def _repeats(fine: Sequence[Answer], far: Sequence[Bool]) -> list[Bool]:
    """Flags of the errors of each capture that are repeated displacements.

    Independent errors that fill a window also have a median other than zero, if the target is not in its middle. Such a
    median never exceeds 2 robust standard deviations of the errors, as a uniform distribution shows; hence the threshold.
    """
    if len(fine) == 1:
        valid = fine[0].error[fine[0].valid]
        usual = [np.full(far[0].shape, np.median(valid) if valid.size else 0.0)]
        used = [fine[0].valid]
    else:
        rest = [np.stack([a.error for k, a in enumerate(fine) if k != number]) for number in range(len(fine))]
        usual = [_median(others) for others in rest]
        failed = np.logical_or.reduce(list(far)) if fine else np.zeros(0, bool)
        used = [failed & a.valid & np.isfinite(others).any(axis=0) for a, others in zip(fine, rest, strict=True)]
    off = [np.abs(a.error - centre) for a, centre in zip(fine, usual, strict=True)]
    pooled = np.concatenate([values[mask] for values, mask in zip(off, used, strict=True)]) if fine else np.zeros(0)
    spread = _DEVIATIONS * float(np.median(pooled)) if pooled.size else 0.0
    found = []
    with np.errstate(invalid="ignore"):
        for a, centre, values in zip(fine, usual, off, strict=True):
            half = centre * np.sign(a.error) >= 0.5 * np.abs(a.error)
            near = values <= np.maximum(a.limit, _LIES_WITHIN * spread)
            found.append(half & near & (np.abs(centre) > _STANDS_OUT * spread))
    return found


def _median(error: Float) -> Float:
    """Median of the finite values along the first axis; 0 where none is finite."""
    there = np.isfinite(error)
    ordered = np.sort(np.where(there, error, np.inf), axis=0)
    count = there.sum(axis=0)
    low, high = np.maximum(count - 1, 0) // 2, np.minimum(count // 2, error.shape[0] - 1)
    pair = [np.take_along_axis(ordered, index[None, :], axis=0)[0] for index in (low, high)]
    return np.asarray(np.where(count > 0, 0.5 * (pair[0] + pair[1]), 0.0), np.float64)
