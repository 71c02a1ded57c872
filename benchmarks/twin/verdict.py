"""Verdicts: the difference of a rig's statistic and its twin's, with an interval that holds for all clauses together.
 The twin is drawn M times, each time with the uncertain values of its rig drawn anew and with new noise. Under the hypothesis
that the twin is right the rig's value T is one more such draw, so that

    t = (T − mean) / (s √(1 + 1/M))
 has Student's distribution with M − 1 degrees of freedom, s the standard deviation over draws. The interval of T − mean is ±
t s √(1 + 1/M); it takes the rig's own scatter to be the twin's. Levels are Holm's (Scand. J. Statist. 6:65, 1979): clauses
are sorted by |t|, the k-th of m gets 1 − α/(m − k + 1) as long as each before it was significant, and all that follow the
level of the first that was not. The chance that any clause of a right twin fails is below α.

    pass          the interval lies within the tolerance: shown to agree
    fail          it does not, and it does not hold 0: shown to differ, by more than may be tolerated
    cannot tell   it holds 0 and is wider than the tolerance: a longer recording, or a better calibrated rig, would decide
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

import numpy as np

from ...scenes.errors import InputError
from .clause import Clause, Evidence, Judged, Verdict

__all__ = ["ALPHA", "judged", "with_tolerances"]

#: Family-wise error.
ALPHA = 0.02


def with_tolerances(clauses: Sequence[Clause], given: Mapping[str, float]) -> tuple[Clause, ...]:
    """The clauses with tolerances of the user's, in the unit of display, in place of their own. Raises InputError for
    unknown ones."""
    from dataclasses import replace

    names = [clause.name for clause in clauses]
    for name, value in given.items():
        if (
            name not in names
            or isinstance(value, bool)
            or not isinstance(value, int | float)
            or not 0 < value < math.inf
        ):
            raise InputError(
                "This is no tolerance of a clause.", where=f"tolerance: {name}", value=value,
                allowed=f"a number above 0 for one of: {', '.join(names)}",
            )  # fmt: skip
    return tuple(
        replace(clause, relative=0.0, absolute=given[clause.name], why="given by the user") if clause.name in given else clause
        for clause in clauses
    )  # fmt: skip


def judged(clauses: Sequence[Clause], evidence: Evidence) -> list[Judged]:
    """The verdict of every clause, in the order of `clauses`; those that were not measured cannot tell, with the reason."""
    from scipy.special import stdtrit

    draws = len(evidence.twins)
    found: dict[str, tuple[float, float, float]] = {}
    for clause in clauses:
        held = np.array([twin.get(clause.name, math.nan) for twin in evidence.twins], np.float64)
        real = evidence.real.get(clause.name, math.nan)
        if not clause.above and math.isfinite(real) and draws > 2 and np.isfinite(held).all():
            spread = float(held.std(ddof=1)) * math.sqrt(1.0 + 1.0 / draws)
            found[clause.name] = (real, float(held.mean()), spread)
    levels = _levels({name: _p(*one, draws - 1) for name, one in found.items()})
    result = []
    for clause in clauses:
        if clause.name in found:
            half = float(stdtrit(draws - 1, 0.5 + 0.5 * levels[clause.name])) * found[clause.name][2]
            result.append(_one(clause, found[clause.name], half, levels[clause.name], evidence))
        elif clause.above and clause.name in evidence.intervals:
            result.append(_above(clause, evidence))
        else:
            result.append(_untold(clause, evidence))
    return result


def _p(real: float, mean: float, spread: float, dof: int) -> float:
    from scipy.special import stdtr

    if spread == 0.0:
        return 0.0 if real != mean else 1.0
    return 2.0 * float(stdtr(dof, -abs(real - mean) / spread))


def _levels(p: Mapping[str, float]) -> dict[str, float]:
    """Holm's level of every clause."""
    levels, stopped = {}, 0.0
    for place, name in enumerate(sorted(p, key=lambda name: p[name])):
        share = ALPHA / (len(p) - place)
        if not stopped and p[name] > share:
            stopped = share
        levels[name] = 1.0 - (stopped or share)
    return levels


def _one(clause: Clause, found: tuple[float, float, float], half: float, level: float, evidence: Evidence) -> Judged:
    real, twin, _ = (clause.factor * value for value in found)
    half *= clause.factor
    tolerance = max(clause.relative * max(abs(real), abs(twin)), clause.absolute)
    difference = real - twin
    low, high = difference - half, difference + half
    bound = clause.factor * evidence.bounds.get(clause.name, math.nan)
    verdict: Verdict = "cannot tell"
    if -tolerance <= low and high <= tolerance:
        verdict, remark = "pass", "agrees within the tolerance"
    elif low > 0.0 or high < 0.0:
        verdict, remark = "fail", clause.physics
    else:
        unit = "" if clause.unit == "1" else f" {clause.unit}"
        # Noise falls with the root of the frames at best.
        times = max(((half + abs(difference)) / tolerance) ** 2, 2.0)
        remark = (
            f"the interval, ± {half:.2g}{unit} about the difference, leaves the tolerance: record at least "
            f"{_times(times)} times as many {clause.more}"
        )
    coverage = evidence.coverage.get(clause.name, 1.0)
    return Judged(clause, real, twin, bound, low, high, level, tolerance, verdict, remark, coverage)


def _times(value: float) -> str:
    """A factor, rounded up to two digits."""
    digit = 10.0 ** max(math.floor(math.log10(value)) - 1, 0)
    return f"{math.ceil(value / digit) * digit:.0f}"


def _above(clause: Clause, evidence: Evidence) -> Judged:
    """A degree of agreement with its own interval, which must lie above the tolerance."""
    low, high = evidence.intervals[clause.name]
    real = evidence.real[clause.name]
    best = float(np.median([twin[clause.name] for twin in evidence.twins]))
    verdict: Verdict = "pass" if low > clause.absolute else "fail" if high < clause.absolute else "cannot tell"
    remark = {
        "pass": "agrees better than chance", "fail": clause.physics,
        "cannot tell": "the interval holds agreement by chance: compare more estimators, or record more",
    }[verdict]  # fmt: skip
    return Judged(
        clause,
        real,
        best,
        evidence.bounds.get(clause.name, math.nan),
        low,
        high,
        0.95,
        clause.absolute,
        verdict,
        remark,
        evidence.coverage.get(clause.name, 1.0),
    )


def _untold(clause: Clause, evidence: Evidence) -> Judged:
    nan = math.nan
    why = evidence.why_not.get(clause.name, "the recording does not show it")
    real = clause.factor * evidence.real.get(clause.name, nan)
    return Judged(clause, real, nan, nan, nan, nan, nan, nan, "cannot tell", why, nan)
