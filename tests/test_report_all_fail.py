"""Closing lines and summary where all estimators fail; numbers of any size; labels that are placed once."""

from __future__ import annotations

import numpy as np
import pandas as pd

from beambench.benchmarks.report.layout import place_labels
from beambench.benchmarks.report.text import closing_lines, summary

from . import _api_fixtures as made_up


def test_where_all_fail_none_is_called_the_best() -> None:
    rows = [
        made_up.score_row(estimator=name, scene=scene, failure_rate=rate_of)
        for name, rate_of in (("peak", 0.4), ("parabola", 0.25))
        for scene in ("a", "b")
    ]
    lines = closing_lines(pd.DataFrame(rows))
    assert lines[0].startswith("best     none: all fail") and "parabola, 25.0 %" in lines[0]
    assert not [line for line in lines if line.startswith("fastest")]
    assert sum(line.startswith("fails") for line in lines) == 2
    said = summary(pd.DataFrame(rows))
    assert "all fail" in said[0] and len(said) == 3 and "most accurate" in said[1]
    # One case in which one of them stands, and it is the best again, whatever the others' errors.
    rows[0] |= {"failure_rate": 0.0, "rmse_full": 1.0}
    assert closing_lines(pd.DataFrame(rows))[0].startswith("best     peak")
    assert "peak" in summary(pd.DataFrame(rows))[0]


def test_a_huge_ratio_to_the_bound_is_a_usable_number() -> None:
    (line, *_) = closing_lines(pd.DataFrame([made_up.score_row(rmse=3e3, rmse_full=3e3, bound=7.9e-4)]))
    assert "over a million x the exact bound" in line


def test_labels_that_were_placed_once_are_placed_the_same_again() -> None:
    rng = np.random.default_rng(2)
    points = [
        {"label": f"e{i % 7}", "text": f"estimator {i % 7}", "cpu": 10 ** rng.uniform(0, 3), "error": rng.uniform(1, 9),
         "front": i % 5 == 0}
        for i in range(21)
    ]  # fmt: skip
    axes = [p["cpu"] for p in points], [p["error"] for p in points]
    one, two = ([dict(p) for p in points] for _ in range(2))
    place_labels(one, *axes)
    kept = [dict(p) for p in one]
    for point in one:
        point["text"] = "changed"  # by who was given it, not in what is kept
    place_labels(two, *axes)
    assert two == kept and any(p["text"] for p in two)
