"""The chart of `estimators check`: names that can be read, and a page that fits its window."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from beambench.benchmarks.laws.place import Place, Standing
from beambench.benchmarks.report import place_chart

#: Figures of the built-in finders of laser lines: error [px], CPU time of a row [s].
_LINES = {
    "my-line": (0.0051, 10.4e-6), "line-template": (0.00486, 103e-6), "line-ml": (0.00486, 7.85e-6),
    "line-erf": (0.00578, 10.2e-6), "line-log-gaussian": (0.00657, 8.84e-6), "line-window-centroid": (0.00694, 11.6e-6),
    "line-peak": (0.287, 9.19e-6), "line-steger": (11.3, 18.2e-6),
}  # fmt: skip


def _place() -> Place:
    standings = [
        Standing(name, name == "my-line", "ok", error, 1.0, 1.0, time) for name, (error, time) in _LINES.items()
    ]
    return Place("column", "px", 1, 96, 0.00433, tuple(standings))


def test_names_are_placed_apart_and_axes_keep_to_the_points(tmp_path: Path, monkeypatch: Any) -> None:
    held: dict[str, Any] = {}

    def caught(chart: Any, *, page: bool) -> Any:
        held.update(chart.to_dict())
        return finished(chart, page=page)

    finished = place_chart.finished
    monkeypatch.setattr(place_chart, "finished", caught)
    place_chart.save_place(_place(), "my-line", tmp_path / "chart.html")
    points = (
        next(one for one in held["datasets"].values() if len(one) == len(_LINES))
        if "datasets" in held
        else held["data"]["values"]
    )
    # Those about ten microseconds lie within a name's height: on the same side of their points they would cover each other.
    crowd = [one for one in points if one["error"] < 0.01 and one["cpu"] < 50]
    assert len({(one["align"], one["dy"]) for one in crowd}) >= 4
    x, y = (held["layer"][0]["encoding"][key]["scale"]["domain"] for key in ("x", "y"))
    assert x[0] > 5.0 and x[1] < 200.0, "no decade without a point"
    assert y[0] < 0.00433, "the bound is on the chart"
    assert held["width"] == "container"
    assert "width=device-width" in (tmp_path / "chart.html").read_text()[:2000]


def test_one_point_without_a_bound_is_drawn(tmp_path: Path) -> None:
    place_chart.save_place(Place("range", "mm", 1, 9, float("nan"), _place().standings[:1]), "a", tmp_path / "a.png")
    assert (tmp_path / "a.png").read_bytes()[:4] == b"\x89PNG"
