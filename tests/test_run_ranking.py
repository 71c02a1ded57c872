"""What a run says where it is no ranking to publish; who gets a new process for every capture; detail beside the error."""

from __future__ import annotations

import csv
import json
from pathlib import Path
from typing import Any

import pytest

from beambench.benchmarks import measure
from beambench.benchmarks.checks.interrupted_work import small_suite
from beambench.benchmarks.run import run_suite
from beambench.benchmarks.runner.jail import OFF
from beambench.benchmarks.runner.session import Session

#: A plug-in that remembers how often it was called, and takes a mean along rows.
REMEMBERS = """
import numpy as np, xarray as xr
from beambench.estimators import estimator
from beambench.estimators.gated.parabola import parabola
SEEN = []

@estimator("gated", cites="planted")
def remembers(capture):
    SEEN.append(1)
    found = parabola(capture)
    value = np.nanmean(found["range"].values, axis=1, keepdims=True) + 10.0 * (len(SEEN) > 2) + 0.0 * found["range"].values
    return found.assign(range=(("row", "col"), np.nan_to_num(value)), valid=(("row", "col"), np.ones(value.shape, bool)),
                        sigma=(("row", "col"), np.full(value.shape, 0.1)))
"""


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Any]:
    """A run without a jail of a relief, with a plug-in, two captures and a new child for every capture of a plug-in."""
    place = tmp_path_factory.mktemp("ranking")
    info = place / "site" / "remembers-1.0.dist-info"
    info.mkdir(parents=True)
    (place / "site" / "planted_remembers.py").write_text(REMEMBERS)
    (info / "METADATA").write_text("Metadata-Version: 2.1\nName: remembers\nVersion: 1.0\n")
    (info / "entry_points.txt").write_text("[beambench.estimators]\nremembers = planted_remembers:remembers\n")
    seen: list[tuple[str, bool]] = []

    class Spy(Session):
        def __init__(self, label: str, *given: Any, **named: Any) -> None:
            seen.append((label, bool(named.get("fresh_child"))))
            super().__init__(label, *given, **named)

    relief = {"scene": "relief-tank", "overrides": {"rig.camera.rows": 24, "rig.camera.cols": 24}}
    suite = small_suite() | {
        "scenes": [relief], "stresses": [], "seeds": {"dev": [], "test": [1, 2]}, "new_child": "capture",
        "estimators": ["poisson-ml", "peak", "remembers"],
    }  # fmt: skip
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv(OFF, "none")
        patch.syspath_prepend(str(place / "site"))
        patch.setattr(measure, "Session", Spy)
        run_suite(suite, place / "out")
    return {"out": place / "out", "seen": seen, "record": json.loads((place / "out" / "run.json").read_text())}


def rows(folder: Path, name: str) -> list[dict[str, str]]:
    with open(folder / name, encoding="utf-8", newline="") as file:
        return list(csv.DictReader(file))


def test_a_run_without_a_jail_is_no_ranking_in_table_warnings_and_page(made: dict[str, Any]) -> None:
    assert {row["jail"] for row in rows(made["out"], "ranking.csv")} == {"no"}
    assert any(
        told.startswith("IsolationWarning: estimators ran without Landlock") for told in made["record"]["warnings"]
    )
    page = (made["out"] / "report.html").read_text(encoding="utf-8")
    assert "<h2>Order of errors, not a ranking</h2>" in page and "<b>No ranking:</b> estimators ran without" in page
    assert "<h2>Ranking</h2>" not in page and ">Order</a>" in page


def test_a_plug_in_alone_gets_a_process_for_every_capture(made: dict[str, Any]) -> None:
    """In one child the second capture would be the plug-in's third call or later, which answers 10 m more."""
    assert dict(made["seen"]) == {"poisson-ml": False, "peak": False, "remembers": True}
    found = [float(row["bias"]) for row in rows(made["out"], "scores.csv") if row["estimator"] == "remembers"]
    assert len(found) >= 2 and max(map(abs, found)) < 1.0


def test_who_gives_up_resolution_is_told_beside_the_error(made: dict[str, Any]) -> None:
    kept: dict[str, list[tuple[float, float]]] = {row["estimator"]: [] for row in rows(made["out"], "resolution.csv")}
    for row in rows(made["out"], "resolution.csv"):
        kept[row["estimator"]].append((float(row["response"]), float(row["response_error"])))
    assert all(abs(value - 1.0) < 4.0 * error + 0.05 for value, error in kept["poisson-ml"])
    assert all(value < 0.7 for value, _ in kept["remembers"])
    told = [line for line in made["record"]["warnings"] if line.startswith("ResolutionWarning: ")]
    assert told and all("remembers keeps" in line for line in told)
    assert "(gives up resolution)" in (made["out"] / "report.html").read_text(encoding="utf-8")
