"""Where an estimator stands among the built-in ones of its stage, and where it breaks first: a benchmark of about a minute.

It runs on the clean captures of the laws, which are written from closed forms, so that no renderer is needed; with less light
and with more background. Every estimator is called in a process of its own, in the jail of a run, and timed there.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from ...captures.hide import hide_truth
from ...captures.quantities import Stage
from ...captures.sizes import sizes_of
from ...estimators import BUILTIN, get_estimator
from ...estimators.labels import LINK
from ...estimators.registry import Estimator
from ..folders.progress import Progress, silent
from ..judges import judge_of
from ..judges.bound import bounds_of, truths_of
from ..runner.job import Job, Outcome
from ..runner.protocol import write_capture, write_meta
from ..runner.scratch import scratch_folder
from ..runner.session import Session, run_sessions
from ..scores.score import KEY, REGULAR_KINDS, score_rows
from ..scores.truth import Bound, Truth, single_valued
from ..suites.spec import Limits
from .maker import Laws, Maker

if TYPE_CHECKING:
    import xarray as xr

__all__ = ["FAILED", "STRESSES", "Breakdown", "Place", "Standing", "placed"]

#: Stress -> multiples of what the clean capture has, from none on.
STRESSES: Mapping[str, tuple[float, ...]] = {
    "light": (1.0, 0.3, 0.1, 0.03, 0.01, 0.003, 0.001),
    "background": (1.0, 10.0, 100.0, 1e3, 1e4),
}
#: Share of failed elements from which an estimator has broken down.
FAILED = 0.1
#: Least number of elements that errors are the mean of, and most captures for them.
_ENOUGH, _MOST_CAPTURES = 32, 8
_CONDITION = "matched"
_LIMITS = Limits(time_s=60.0, warmup_s=120.0, memory_bytes=2**31)


@dataclass(frozen=True)
class Standing:
    """One estimator on the clean captures.

    Main arguments:
        label: of the estimator, without what feeds it. own: whether it is the one that is checked. status: "ok", or why it has no
            figures.
        rmse: root mean square error, an element without an answer counts with the prior's. coverage: share of answers.
        z_rms: root mean square of error over stated sigma. cpu_s: CPU time of an element, with what feeds it.
    """

    label: str
    own: bool
    status: str
    rmse: float = math.nan
    coverage: float = math.nan
    z_rms: float = math.nan
    cpu_s: float = math.nan


@dataclass(frozen=True)
class Breakdown:
    """Failure under one stress.

    Main arguments:
        stress: "light" or "background". levels, rates: multiples, and shares of failed elements there. first: the first
            level at which FAILED of them fail; None: none of them.
        best: the most accurate built-in estimator, best_first: as `first`.
    """

    stress: str
    levels: tuple[float, ...]
    rates: tuple[float, ...]
    first: float | None
    best: str
    best_first: float | None


@dataclass(frozen=True)
class Place:
    """Where an estimator stands.

    Main arguments:
        quantity, unit: what is compared. captures, elements: how many. bound: rms bound of the standard error; NaN where none is
            known. standings: the estimator first, then the built-in ones, the most accurate first. breakdowns: one per stress.
        why: reason why there is no comparison, "" if there is one.
    """

    quantity: str = ""
    unit: str = ""
    captures: int = 0
    elements: int = 0
    bound: float = math.nan
    standings: tuple[Standing, ...] = ()
    breakdowns: tuple[Breakdown, ...] = ()
    why: str = ""

    @property
    def own(self) -> Standing:
        """The estimator that is checked."""
        return self.standings[0]


@dataclass
class _Posed:
    """Captures that were written for the children, with their truths."""

    folder: Path
    stage: Stage
    jobs: list[Job] = field(default_factory=list)
    truths: list[tuple[Mapping[str, Truth], Mapping[str, Bound]]] = field(default_factory=list)

    def add(self, capture: xr.Dataset, *, timed: bool) -> Job:
        """Write one capture without its truth."""
        hidden, number = hide_truth(capture), len(self.jobs)
        folder = self.folder / f"capture-{number:03d}"
        write_capture(folder, hidden)
        write_meta(folder, hidden, _CONDITION)
        self.jobs.append(Job(number, folder, _CONDITION, str(capture.attrs["modality"]), sizes_of(hidden), timed=timed))
        self.truths.append((truths_of(capture), bounds_of(capture)))
        return self.jobs[-1]

    def row(self, outcome: Outcome, quantity: str) -> dict[str, Any]:
        """Scores of the quantity in one outcome."""
        truth, bound = self.truths[outcome.job.index]
        rows = score_rows(
            dict.fromkeys(KEY, ""), self.stage, truth, bound, outcome.arrays or None, status=outcome.status,
            cpu_s=outcome.cpu_s,
        )  # fmt: skip
        return next(row for row in rows if row["quantity"] == quantity)


def placed(label: str, own: Estimator, laws: Laws, progress: Progress = silent) -> Place:
    """The place of an estimator among the built-in ones of its stage.

    Main arguments:
        label: `name` or `name[key=value]`. own: the estimator, of which stage and needs are read: it is not called here. laws: of
            its modality.
    Other arguments:
        progress: told of every answer.
    """
    stage = own.stage
    maker = Maker(laws, stage, own.unfit)
    clean = [maker.stressed(1)]
    quantity, n = ("", 0) if clean[0].attrs.get("truth_kind") == "none" else _scored(stage, clean[0])
    if not quantity:
        return Place(why="The captures of the laws hold no truth of this stage.")
    rivals = [name for name in BUILTIN if name != label and _rivals(get_estimator(name), stage, clean[0])]
    clean += [maker.stressed(seed) for seed in range(2, 1 + min(_MOST_CAPTURES, math.ceil(_ENOUGH / n)))]
    with scratch_folder("check") as folder:
        posed = _Posed(folder / "captures", stage)
        timed = [posed.add(capture, timed=True) for capture in clean]
        levels = {
            (stress, level): posed.add(maker.stressed(1, **{stress: level}), timed=False)
            for stress, values in STRESSES.items()
            for level in values
        }
        jobs = {label: [*timed, *levels.values()]} | dict.fromkeys(rivals, timed)
        total = sum(len(one) for one in jobs.values())
        steps = _Answers(progress, total + (len(levels) if rivals else 0))
        outcomes = _asked(jobs, stage, folder, steps)
        standings = [_standing(posed, outcomes[one][: len(timed)], one, quantity, own=one == label) for one in jobs]
        rest = sorted(standings[1:], key=lambda one: (one.status != "ok", one.rmse, one.label))
        best = rest[0].label if rest and rest[0].status == "ok" else ""
        others = _asked({best: list(levels.values())}, stage, folder, steps)[best] if best else []
        found = []
        for stress, values in STRESSES.items():
            numbers = [levels[stress, value].index for value in values]
            rates = _rates(posed, outcomes[label], numbers, quantity)
            beside = _first(values, _rates(posed, others, numbers, quantity)) if best else None
            found.append(Breakdown(stress, values, rates, _first(values, rates), best, beside))
    bounds = [posed.truths[job.index][1][quantity] for job in timed]
    unit = next(q.unit for q in stage.gives if q.name == quantity)
    return Place(
        quantity, unit, len(clean), n * len(clean), _bound(bounds), (standings[0], *rest), tuple(found)
    )  # fmt: skip


def _rivals(other: Estimator, stage: Stage, capture: xr.Dataset) -> bool:
    return other.stage == stage and not other.unfit(capture)


def _scored(stage: Stage, capture: xr.Dataset) -> tuple[str, int]:
    """(the first quantity of the stage of which a capture holds truth, of how many elements); ("", 0) for none."""
    truths = truths_of(capture)
    for quantity in stage.gives:
        if quantity.name in truths and (n := int(single_valued(truths[quantity.name]).sum())):
            return quantity.name, n
    return "", 0


class _Answers:
    """Counts answers for a progress."""

    def __init__(self, progress: Progress, total: int) -> None:
        self._progress, self._total, self._done = progress, total, 0
        progress("compare", 0, total, "")

    def __call__(self, label: str) -> None:
        """One more answer, of an estimator."""
        self._done += 1
        self._progress("compare", self._done, self._total, label)


def _asked(
    jobs: Mapping[str, Sequence[Job]], stage: Stage, folder: Path, answered: _Answers
) -> dict[str, list[Outcome]]:
    """The outcomes of every estimator on its jobs, behind what feeds its stage."""
    feeders = judge_of(stage.modality).feeders
    before = "" if stage.reads_captures else feeders[stage.word] + LINK
    labels = list(jobs)
    sessions = [
        Session(before + label, jobs[label], _LIMITS, folder / f"estimator-{number}")
        for number, label in enumerate(labels)
    ]
    found: dict[str, list[Outcome]] = {label: [] for label in labels}

    def keep(number: int, outcome: Outcome) -> None:
        found[labels[number]].append(outcome)
        answered(labels[number])

    run_sessions(sessions, keep)
    return found


def _standing(posed: _Posed, outcomes: Sequence[Outcome], label: str, quantity: str, *, own: bool) -> Standing:
    bad = next((outcome.status for outcome in outcomes if outcome.status != "ok"), "")
    if bad:
        return Standing(label, own, bad)
    rows = [posed.row(outcome, quantity) for outcome in outcomes]
    cpu = np.median([outcome.cpu_s / outcome.job.elements for outcome in outcomes])
    return Standing(
        label, own, "ok", _root([row["rmse_full"] for row in rows]), float(np.mean([row["coverage"] for row in rows])),
        _root([row["z_rms"] for row in rows]), float(cpu),
    )  # fmt: skip


def _rates(posed: _Posed, outcomes: Sequence[Outcome], numbers: Sequence[int], quantity: str) -> tuple[float, ...]:
    """Shares of failed elements on the captures of these numbers; all of them where there is no answer."""
    by_number = {outcome.job.index: outcome for outcome in outcomes}
    return tuple(float(posed.row(by_number[number], quantity)["failure_rate"]) for number in numbers)


def _first(levels: Sequence[float], rates: Sequence[float]) -> float | None:
    return next((level for level, rate in zip(levels, rates, strict=True) if rate >= FAILED), None)


def _bound(bounds: Sequence[Bound]) -> float:
    """Root mean square of the bound; NaN where none can be reached."""
    if any(bound.kind not in REGULAR_KINDS for bound in bounds):
        return math.nan
    sigma = np.concatenate([bound.sigma.ravel() for bound in bounds])
    return _root(sigma[np.isfinite(sigma)])


def _root(values: Sequence[float] | np.ndarray) -> float:
    """Root mean square."""
    array = np.asarray(values, np.float64)
    return float(np.sqrt((array**2).mean())) if array.size else math.nan
