"""A run tells the rung of every scene that chose one, and what to type where a rung leaves out what matters."""

from __future__ import annotations

import json
from dataclasses import replace
from typing import Any

import pytest
import xarray as xr

from beambench.benchmarks.rungs import Rungs, rung_lines
from beambench.benchmarks.suites.suite import Cell, cells_of, load_suite

SUITE = {
    "schema_version": 1, "suite": "two", "version": 1, "title": "two walls", "estimators": ["peak"], "rtol": 0.03,
    "fidelity": "direct", "seeds": {"dev": [1], "test": [101, 102]},
    "scenes": [{"scene": "flat-wall"}, {"scene": "harbour-wall", "fidelity": "scatter"}],
}  # fmt: skip


def capture(rung: str, size: float | None, error: float | None = None) -> xr.Dataset:
    """A capture that leaves out one effect of a size."""
    effects = [
        {"name": "shot noise", "modelled": True, "predicted_relative_size": 3.0},
        {"name": "multiple scattering", "modelled": False, "predicted_relative_size": size},
    ]
    told: dict[str, Any] = {"rung": rung, "effects": effects}
    if error is not None:
        told["chosen"] = {"predicted_error": {"direct": 0.5, rung: error}, "limit": 0.03, "basis": "a test"}
    return xr.Dataset(attrs={"fidelity": json.dumps(told)})


@pytest.fixture(scope="module")
def cells() -> list[Cell]:
    return cells_of(load_suite(SUITE))


def test_each_scene_is_told_once(cells: list[Cell]) -> None:
    rungs = Rungs("two", {})
    wall = [replace(cell, fidelity="auto") for cell in cells if cell.scene_name == "flat-wall"]
    rungs.add(wall[0], capture("direct", 0.01, 0.002))
    rungs.add(wall[1], capture("full", None, 0.02))
    rungs.add(cells[-1], capture("scatter", 0.05))
    first, second = rungs.rows()
    assert first == {
        "scene": "flat-wall", "fidelity": "auto", "rungs": {"direct": 1, "full": 1}, "predicted_error": 0.02, "limit": 0.03,
    }  # fmt: skip
    assert second == {"scene": "harbour-wall", "fidelity": "scatter", "rungs": {"scatter": 1}}
    assert rung_lines(rungs.rows()) == [
        "flat-wall: direct (1 of 2 captures), full (1 of 2 captures): predicted error 0.02, limit 0.03"
    ]
    assert rungs.advice() == ""


@pytest.mark.parametrize(
    ("place", "asked", "size", "told"),
    [
        (0, "direct", 0.15, "multiple scattering changes the signal of flat-wall by 15 %, and direct leaves it out: "
                            "beambench run two --set fidelity=auto"),
        (-1, "scatter", 4.0, "multiple scattering changes the signal of harbour-wall by 4 times, and direct leaves it out: "
                             "beambench run two --set scenes.1.fidelity=auto"),
        (0, "auto", 0.15, "multiple scattering changes the signal of flat-wall by 15 %, and direct leaves it out: "
                          "beambench run two --set rtol=0.03"),
    ],
)  # fmt: skip
def test_advice_is_one_line_with_what_to_type(
    cells: list[Cell], place: int, asked: Any, size: float, told: str
) -> None:
    loaded = load_suite(SUITE)
    rungs = Rungs("two", loaded.own_rungs())
    for each in (size / 2, size, size / 3):
        rungs.add(replace(cells[place], fidelity=asked), capture("direct", each, 0.2 if asked == "auto" else None))
    assert rungs.advice() == told


def test_what_the_advice_says_is_a_setting_of_the_suite() -> None:
    for path in ("fidelity", "scenes.1.fidelity"):
        changed = load_suite(SUITE, {path: "auto"})
        assert changed.fidelity("harbour-wall" if path[0] == "s" else "flat-wall") == "auto"
    assert load_suite(SUITE, {"rtol": 0.03}).suite.rtol == 0.03
