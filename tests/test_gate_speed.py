"""Speed against another version: the decision from times that are known, and processes that time what they are told."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import pytest

from beambench.benchmarks.gate.check import ABSTAINS, PASS, REGRESSION, decided
from beambench.benchmarks.gate.sides import Failed, Paired, Plan, Side, interleaved, open_all, typical
from beambench.benchmarks.gate.speed import speed_check, with_retry

EFFECT = 0.03


def paired(rng: np.random.Generator, slower: float = 0.0, scatter: float = 0.005, starts: int = 8) -> Paired:
    """A target whose B is slower, and whose processes have a speed of their own with the given scatter."""
    a, twin, b = scatter * rng.normal(size=(3, starts))
    return Paired(math.log1p(slower) + b - 0.5 * (a + twin), twin - a, 0.01)


def gate(rng: np.random.Generator, slower: float, scatter: float) -> str:
    found = with_retry({0: "x"}, EFFECT, lambda numbers: {n: paired(rng, slower, scatter) for n in numbers})
    return decided([found[0].check])[0].state


def test_three_percent_is_caught_and_the_same_code_is_not() -> None:
    """200 gates each. Caught: at least 95 % red or abstaining with its reason; false alarms: at most 1 %, and by the retry none."""
    rng = np.random.default_rng(1)
    slow = [gate(rng, 0.03, 0.005) for _ in range(200)]
    same = [gate(rng, 0.0, 0.005) for _ in range(200)]
    assert slow.count(PASS) <= 10 and slow.count(REGRESSION) >= 150, [
        slow.count(s) for s in (PASS, REGRESSION, ABSTAINS)
    ]
    assert same.count(REGRESSION) <= 2 and same.count(PASS) >= 180


def test_noise_as_wide_as_the_effect_abstains() -> None:
    rng = np.random.default_rng(2)
    states = [gate(rng, 0.03, 0.05) for _ in range(100)]
    assert states.count(PASS) <= 5 and states.count(ABSTAINS) >= 80


def test_an_a_a_that_differs_is_told_and_not_used() -> None:
    values = np.random.default_rng(3).normal(size=8) * 1e-3
    timed = speed_check("x", Paired(values + 0.2, values + 0.05, 0.01), EFFECT)
    assert timed.check.state == ABSTAINS and "A/A fails" in timed.check.note
    assert timed.same == pytest.approx(0.05, abs=2e-3) and timed.same_half < 0.01


def test_a_slowdown_that_is_not_repeated_is_no_regression() -> None:
    rng = np.random.default_rng(4)
    answers = iter([paired(rng, 0.1), paired(rng, 0.0)])
    found = with_retry({0: "x"}, EFFECT, lambda numbers: {n: next(answers) for n in numbers})
    assert decided([found[0].check])[0].state == PASS
    assert "measured twice" in found[0].check.note


def test_only_what_is_in_question_is_measured_again() -> None:
    rng = np.random.default_rng(5)
    asked: list[list[int]] = []

    def measure(numbers: Sequence[int]) -> Mapping[int, Paired]:
        asked.append(list(numbers))
        return {n: paired(rng, 0.2 if n == 1 else 0.0, scatter=0.001) for n in numbers}

    found = with_retry({0: "a", 1: "b", 2: "c"}, EFFECT, measure)
    assert asked == [[0, 1, 2], [1]]
    assert [decided([found[n].check])[0].state for n in range(3)] == [PASS, REGRESSION, PASS]


class Made:
    """A side that answers at once: the CPU time of a call is what it is made with, times a random factor."""

    def __init__(self, seconds: float, rng: np.random.Generator, calls: list[int], number: int) -> None:
        self.seconds, self.rng, self.calls, self.number, self.closed = seconds, rng, calls, number, False

    def open(self, number: int, target: Mapping[str, Any]) -> dict[str, Any]:
        if target.get("broken"):
            raise Failed("broken")
        return {"homes": [], "cpu_s": [self.seconds]}

    def time(self, number: int, count: int) -> list[float]:
        self.calls.append(self.number)
        return list(self.seconds * np.exp(0.01 * self.rng.normal(size=count)))

    def close(self) -> None:
        self.closed = True


def test_sides_are_timed_in_random_order_and_closed() -> None:
    rng = np.random.default_rng(6)
    calls: list[int] = []
    made: list[Made] = []

    def start() -> list[Made]:
        sides = [Made(seconds, rng, calls, k) for k, seconds in enumerate((0.01, 0.01, 0.011))]
        made.extend(sides)
        return sides

    plan = Plan(starts=6, rounds=9, turn_s=0.05)
    found = interleaved(start, {7: {}}, plan, np.random.default_rng(7))[7]
    assert found.change.shape == (6,) and found.change.mean() == pytest.approx(math.log(1.1), abs=0.01)
    assert abs(found.same.mean()) < 0.01 and found.cpu_s == pytest.approx(0.01, rel=0.02)
    assert len(made) == 18 and all(side.closed for side in made)
    turns = np.array(calls).reshape(-1, 3)
    assert (np.sort(turns, axis=1) == [0, 1, 2]).all(), "in each round every side has one turn"
    assert len({tuple(turn) for turn in turns}) == 6, "and all orders occur"
    assert open_all(start, {0: {}, 1: {"broken": True}})[1] == "broken"


def test_interrupted_calls_do_not_count() -> None:
    clean = [0.001] * 20
    assert typical([*clean, *[0.003] * 10]) == pytest.approx(math.log(0.001))


def test_a_worker_answers_errors_and_ends() -> None:
    side = Side()
    try:
        with pytest.raises(Failed, match="no-such-estimator"):
            side.open(0, {"kind": "estimate", "label": "no-such-estimator", "folder": "/", "condition": "matched"})
        with pytest.raises(Failed, match="KeyError"):
            side.time(3, 1)
    finally:
        side.close()
    with pytest.raises(Failed):
        side.time(0, 1)
