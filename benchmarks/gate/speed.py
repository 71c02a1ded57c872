"""Speed against another version: the decision from interleaved times, its own A/A, and one retry."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from .check import ABSTAINS, ALPHA, REGRESSION, Check, abstained, decided, measured
from .sides import Failed, Paired

__all__ = ["Timed", "speed_check", "with_retry"]

#: Level of the interval of A/A: its chance to exclude zero where both are the same code.
_SAME = 0.99


@dataclass(frozen=True)
class Timed:
    """A check of speed, and the A/A that was measured beside it: ln A'/A and half of its 99 % interval."""

    check: Check
    same: float = math.nan
    same_half: float = math.nan


def speed_check(subject: str, paired: Paired, effect: float) -> Timed:
    """The check of one target.

    Main arguments:
        paired: logarithms per start. effect: slowdown of interest as a fraction, .03: 3 % more CPU time.

    It abstains where the two processes of one version differ by more than chance (their 99 % interval excludes zero) and by
    more than a quarter of the effect, or where that interval is as wide as the effect. Student's t over starts, one-sided.
    """
    from scipy.stats import t

    starts, size = paired.change.size, math.log1p(effect)
    same, same_error = _mean(paired.same)
    half = float(t.ppf(0.5 + 0.5 * _SAME, starts - 1)) * same_error
    told = f"A/A {_percent(same)} ± {100 * half:.1f} % (99 %), {starts} starts, {paired.cpu_s:.3g} s per call"
    if abs(same) > max(half, 0.25 * size):
        return Timed(
            abstained("speed", subject, f"A/A fails: one version against itself differs; {told}", size), same, half
        )
    if half >= size:
        return Timed(abstained("speed", subject, f"A/A is too wide to see the effect; {told}", size), same, half)
    change, error = _mean(paired.change)
    return Timed(measured("speed", subject, change, error, starts - 1, size, told), same, half)


def _mean(values: np.ndarray[tuple[int, ...], np.dtype[np.float64]]) -> tuple[float, float]:
    return float(values.mean()), float(values.std(ddof=1)) / math.sqrt(values.size)


def _percent(log: float) -> str:
    return f"{100 * math.expm1(log):+.1f} %"


def with_retry(
    subjects: Mapping[int, str],
    effect: float,
    measure: Callable[[Sequence[int]], Mapping[int, Paired]],
    *,
    others: Sequence[Check] = (),
    alpha: float = ALPHA,
) -> dict[int, Timed]:
    """Measure all targets, and once more those that are slower, or whose A/A failed.

    Main arguments:
        subjects: {number: name} of the targets. measure: gives the logarithms of the numbers it is called with.
    Other arguments:
        others: the gate's other checks, which count in the correction. alpha: see `check`.

    A slowdown must show twice: the check keeps the larger p and the smaller change. A target on which the first measurement
    abstained has the second one alone. Either way a false alarm is no more probable than in one measurement.
    """
    first = {
        number: speed_check(subjects[number], paired, effect) for number, paired in measure(list(subjects)).items()
    }
    order = list(first)
    states = decided([*(first[number].check for number in order), *others], alpha)[: len(order)]
    again = [number for number, check in zip(order, states, strict=True) if check.state in (REGRESSION, ABSTAINS)]
    if not again:
        return first
    try:
        second = measure(again)
    except Failed:
        second = {}
    slower = {number for number, check in zip(order, states, strict=True) if check.state == REGRESSION}
    for number, paired in second.items():
        repeated = speed_check(subjects[number], paired, effect)
        first[number] = _both(first[number], repeated) if number in slower else _second(repeated)
    return first


def _second(two: Timed) -> Timed:
    return replace(two, check=replace(two.check, note=f"{two.check.note}, second measurement"))


def _both(one: Timed, two: Timed) -> Timed:
    if two.check.state == ABSTAINS:
        return _second(two)
    a, b = one.check, two.check
    weaker = a if a.p >= b.p else b
    note = f"measured twice: {_percent(a.change)} and {_percent(b.change)}; {two.check.note}"
    return replace(
        two, check=replace(weaker, change=min(a.change, b.change), high=min(a.high, b.high), p=max(a.p, b.p), note=note)
    )
