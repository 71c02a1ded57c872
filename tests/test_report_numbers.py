"""Numbers on pages and in terminals are ones that a person can use."""

from __future__ import annotations

import math

import pytest

from beambench.benchmarks.report.numbers import count_text, timed_text, times_text


@pytest.mark.parametrize(
    ("given", "text"),
    [
        ((2.6e-6, 2.5e-6, 2.7e-6), "2.60 µs ± 3.8 %"),
        ((2.6e-6, 1e-7, 7e-5), "2.60 µs, between 100 ns and 70.0 µs"),
        ((2.6e-6, -1e-6, 7e-5), "2.60 µs, at most 70.0 µs"),
        ((2.6e-6, math.nan, math.nan), "2.60 µs"),
        ((math.nan, math.nan, math.nan), "–"),
    ],
)
def test_a_wide_interval_is_told_by_its_ends(given: tuple[float, float, float], text: str) -> None:
    assert timed_text(*given) == text


def test_counts_and_multiples() -> None:
    assert [count_text(n) for n in (12, 1200, 999_999, 1e6, 9e6)] == ["12", "1,200", "999,999", "1.00 M", "9.00 M"]
    assert [times_text(x) for x in (1.2, 345.0, 12345.0, 3779814.79)] == ["1.20", "345", "12,300", "over a million"]
    assert times_text(math.inf) == "over a million" and times_text(math.nan) == "–"
