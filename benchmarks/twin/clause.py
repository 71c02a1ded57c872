"""A clause of the certificate, what it found, and what a modality contributes."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import xarray as xr

if TYPE_CHECKING:
    from .rig_file import TwinRig

__all__ = ["Ask", "Clause", "Curve", "Evidence", "Judged", "TwinKind", "Verdict"]

Verdict = Literal["pass", "fail", "cannot tell"]


@dataclass(frozen=True)
class Clause:
    """One thing in which a twin should agree with its rig.

    Main arguments:
        name: of the statistic. title: in a few words. unit, factor: of display; factor times the statistic is in `unit`.
        relative, absolute: the tolerance: the larger of `relative` times the larger of both values, and `absolute` in the
            unit of display.
        why: where the tolerance comes from. follows: the published test that it follows, "" for none. cannot: what it cannot
        show. physics: what a failure means beside its bound.
    Other arguments:
        more: what a recording needs more of where noise hides the answer.
        above: the statistic is itself a degree of agreement, and must lie above `absolute`.
    """

    name: str
    title: str
    unit: str
    factor: float
    relative: float
    absolute: float
    why: str
    follows: str
    cannot: str
    physics: str
    more: str = "repeats"
    above: bool = False


@dataclass(frozen=True)
class Curve:
    """A small chart: points of the rig with 1 σ, and the line of the twin."""

    title: str
    x_title: str
    y_title: str
    x: Sequence[float]
    real: Sequence[float]
    sigma: Sequence[float]
    twin: Sequence[float]


@dataclass(frozen=True)
class Evidence:
    """What was measured.

    Main arguments:
        real: statistic -> value of the rig; missing or NaN where it cannot be measured. twins: the same of every draw of the
        twin.
        bounds: statistic -> the physical bound, in the statistic's unit: the least standard error that any evaluation of the
            judged half could have, or the value itself where the clause is about an error. why_not: statistic -> why it could
            not be measured. curves: small charts by the name of their clause. about: lines about the recording and the twin.
    Other arguments:
        intervals: statistic -> 95 % interval of a statistic that brings its own (`Clause.above`). coverage: statistic -> share of
        the pixels with light in which it is measured; missing where that is all of them.
    """

    real: Mapping[str, float]
    twins: Sequence[Mapping[str, float]]
    bounds: Mapping[str, float]
    why_not: Mapping[str, str]
    curves: Mapping[str, Curve]
    about: Sequence[str]
    intervals: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    coverage: Mapping[str, float] = field(default_factory=dict)


@dataclass(frozen=True)
class Judged:
    """A clause with its values in the unit of display: `low`, `high` the interval of the difference real − twin at the
    family-wise corrected `level`, `tolerance`, the `bound`, the verdict and a remark in a sentence. `coverage`: share of the pixels
    with light in which it was measured, NaN where it was not."""

    clause: Clause
    real: float
    twin: float
    bound: float
    low: float
    high: float
    level: float
    tolerance: float
    verdict: Verdict
    remark: str
    coverage: float

    @property
    def measured(self) -> bool:
        """Whether the recording shows what the clause is about."""
        return math.isfinite(self.low)


@dataclass(frozen=True)
class Ask:
    """What is asked of a modality: `rig`, the twin's, None to calibrate on the first half; `scene`: name or file of what the
    rig looked at, None if unknown; the rung; how many draws of the twin; the random seed; estimators whose ranking is
    compared."""

    rig: TwinRig | None
    scene: str | Path | None
    fidelity: Any
    draws: int
    seed: int
    estimators: tuple[str, ...]


@dataclass(frozen=True)
class TwinKind:
    """The record of a modality: its clauses, and the function that measures them.

    Main arguments:
        clauses: in the order of the page. measure: (recording without truth beyond a surveyed one, what is asked) -> evidence.
    """

    clauses: tuple[Clause, ...]
    measure: Callable[[xr.Dataset, Ask], Evidence]
