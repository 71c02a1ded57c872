"""What the page says of ranks: what they rest on, for which scenes they hold, and that lead and tables agree."""

from __future__ import annotations

from pathlib import Path

import pandas as pd
import pytest

from beambench.benchmarks.report.page import write_report
from beambench.benchmarks.report.ranking import ranking_section
from beambench.benchmarks.report.text import closing_lines, summary
from beambench.benchmarks.scores.tables import to_csv
from beambench.benchmarks.statistics.tables import RANKING_COLUMNS

from ._api_fixtures import make_run, score_row


def _ranking(folder: Path, basis: str, scenes: int, here: str = "") -> str:
    rows = [
        dict.fromkeys(RANKING_COLUMNS, 0.5)
        | {"modality": "gated", "stage": "range", "quantity": "range", "condition": "matched", "estimator": name}
        | {"scenes": scenes, "rank_lo": low, "rank_hi": low, "basis": basis, "here": here, "here_lo": low, "here_hi": 2}
        for low, name in ((1, "a"), (2, "b"))
    ]
    (folder / "ranking.csv").write_text(to_csv(rows, RANKING_COLUMNS))
    (section,) = ranking_section(folder)
    assert [row[0] for row in section["rows"]] == ["1", "2"]
    return str(section["note"])


@pytest.mark.parametrize(
    ("basis", "scenes", "words"),
    [
        ("tiles", 3, "tile by tile"), ("captures", 3, "hold for these scenes, with new noise, poses"),
        ("scenes", 8, "hold for other scenes"), ("", 3, "all ranks remain open"),
    ],
)  # fmt: skip
def test_a_ranking_says_what_it_rests_on(tmp_path: Path, basis: str, scenes: int, words: str) -> None:
    note = _ranking(tmp_path, basis, scenes)
    assert words in note and "Ranks on these scenes" not in note


def test_ranks_on_these_scenes_stand_beside_those_over_scenes(tmp_path: Path) -> None:
    note = _ranking(tmp_path, "scenes", 8, here="captures")
    assert "hold for other scenes" in note and "capture by capture" in note
    (section,) = ranking_section(tmp_path)
    assert section["head"][:3] == ["rank", "on these scenes", "estimator"]
    assert [row[:3] for row in section["rows"]] == [["1", "1 to 2", "a"], ["2", "2", "b"]]


def _table() -> pd.DataFrame:
    rows = [
        score_row(scene=scene, estimator=name, rmse_full=error, rmse=error, level="", level2="")
        for scene in ("one", "two")
        for name, error in (("a", 1e-3), ("b", 2e-3), ("c", 3e-3))
    ]
    mixed = [row | {"quantity": "range-mixed", "failure_rate": 0.5} for row in rows if row["estimator"] != "a"]
    return pd.DataFrame([*rows, *mixed])


def test_the_lead_uses_what_the_tables_decided_and_names_its_basis() -> None:
    pairs = [
        {"a": "a", "b": other, "winner": "a", "condition": "matched", "quantity": "range", "basis": "tiles"}
        for other in ("b", "c")
    ]
    assert "a is the most accurate" in summary(_table(), pairs)[0] and "on these scenes" in summary(_table(), pairs)[0]
    assert "2 of 2 others significantly worse on these scenes" in closing_lines(_table(), pairs)[0]
    pairs[1]["winner"] = ""
    assert "1 of 2 others significantly worse on these scenes" in summary(_table(), pairs)[0]
    assert "too few scenes" in summary(_table())[0]
    over = [pair | {"basis": "scenes", "winner": "", "winner_here": "a"} for pair in pairs]
    assert "0 of 2 others significantly worse over scenes, 2 on these scenes" in summary(_table(), over)[0]


def test_failures_on_mixed_elements_are_told_apart_in_the_lead() -> None:
    third = summary(_table())[2]
    assert (
        third.startswith("No estimator fails") and "On mixed pixels, which are scored apart, 2 estimators did." in third
    )


def test_the_page_defines_its_terms_and_invents_no_command(tmp_path: Path) -> None:
    folder = make_run(tmp_path / "run", pictures=False)
    (folder / "run.json").write_text('{"verb": "score", "command": ["beambench", "score", "data.zarr", "mine"]}')
    page = write_report(folder).read_text()
    for term in ("matched", "calibrated", "mixed", "bound", "◆ front", "◇ undecided"):
        assert f"<dt>{term}</dt>" in page
    assert "beambench score data.zarr mine" in page and "beambench run" not in page.split('id="repeat"')[-1][:400]
