"""The table of a run for a terminal."""

from __future__ import annotations

from pathlib import Path

import pandas as pd

from beambench.benchmarks.report.terminal_tables import terminal_tables
from beambench.benchmarks.scores.tables import read_scores

from . import _api_fixtures as made_up


def test_the_terminal_has_a_table_of_each_quantity(tmp_path: Path) -> None:
    """Every estimator, a plug-in too, has a row; the bound stands first, then the smallest error over it."""
    (shown,) = terminal_tables(read_scores(made_up.make_run(tmp_path, stress=True, pictures=False)))
    assert shown.title == "range, matched" and shown.heads[0] == "estimator"
    assert all(head.endswith(", mm") for head in shown.heads[1:])
    labels = [row[0] for row in shown.rows]
    assert labels[:2] == ["(bound)", "poisson-ml"] and len(labels) == 7
    assert all(len(row) == len(shown.heads) for row in shown.rows)
    assert any("crash" in row for row in shown.rows), "a failure stands in its place"
    assert any("%" in cell for row in shown.rows for cell in row[1:]), "coverage is told where it is not whole"


def test_many_scenes_are_one_column() -> None:
    rows = [
        made_up.score_row(scene=f"s{i}", estimator=name, rmse_full=error * (i + 1), bound=0.01)
        for i in range(8)
        for name, error in (("mine", 0.02), ("peak", 0.05))
    ]
    (shown,) = terminal_tables(pd.DataFrame(rows))
    assert [row[0] for row in shown.rows] == ["mine", "peak"]
    assert shown.rows[0][1:] == ("10.0", "16.0", "8 of 8")
