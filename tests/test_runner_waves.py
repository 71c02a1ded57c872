"""Which children start together: no two that would compile the same kernels."""

from __future__ import annotations

import math

import pytest

from beambench.benchmarks.report.as_measured import as_measured
from beambench.benchmarks.runner.session import waves


def test_conditions_and_parameters_of_one_function_start_one_after_the_other() -> None:
    labels = ["peak", "peak", "wa", "wa[b=1]", "line", "line+tri", "spot"]  # peak under two conditions
    found = list(waves(labels, 2))
    assert found == [[0, 2], [1, 3], [4, 6], [5]]


@pytest.mark.parametrize("width", [1, 2, 3, 16])
def test_every_label_starts_once(width: int) -> None:
    labels = [f"{name}[x={i % 3}]" for i, name in enumerate("abcabcddddda")]
    found = list(waves(labels, width))
    assert sorted(n for group in found for n in group) == list(range(len(labels)))
    assert all(0 < len(group) <= width for group in found)
    assert all(len({labels[n][0] for n in group}) == len(group) for group in found)


def row(**more: object) -> dict[str, object]:
    held: dict[str, object] = {
        "scene": "object1", "condition": "matched", "status": "ok", "modality": "gated", "quantity": "range", "unit": "m",
        "rmse_full": 0.021,
    }  # fmt: skip
    return held | more


def test_an_estimate_is_told_as_it_is_measured() -> None:
    assert as_measured("peak", [row()]) == "peak: object1, matched, 21.0 mm rms"
    assert (
        as_measured("peak", [row(quantity="range-mixed", rmse_full=9.0), row()])
        == "peak: object1, matched, 21.0 mm rms"
    )
    assert (
        as_measured("peak", [row(status="timeout: call over 3 s", rmse_full=math.nan)])
        == "peak: object1, matched, timeout"
    )
    assert as_measured("peak", [row(rmse_full=math.nan)]) == "peak: object1, matched"
    assert as_measured("peak", []) == "peak"
