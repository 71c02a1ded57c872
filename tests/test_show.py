"""`beambench show`: pictures of captures of every modality and of runs, as charts, files and blocks in the terminal."""

from __future__ import annotations

import json
import re
from pathlib import Path

import numpy as np
import pytest
import xarray as xr

import beambench
from beambench.benchmarks.looks import LOOKS, look_of
from beambench.benchmarks.looks.blocks import samples_of
from beambench.benchmarks.looks.chart import chart_of
from beambench.benchmarks.looks.panel import Curve, Curves, Image, image
from beambench.captures import write
from beambench.captures.example import example_capture
from beambench.captures.layouts import LAYOUTS
from beambench.cli import main
from beambench.coloured import colour_blocks, drawn, grey_blocks
from beambench.generator.generate import generate
from beambench.scenes.load import load_scene

SIDE = {"rig.camera.rows": 16, "rig.camera.cols": 24}


@pytest.fixture(scope="module")
def wall() -> xr.Dataset:
    return generate(load_scene("flat-wall", SIDE), seed=1)


@pytest.fixture(scope="module")
def store(wall: xr.Dataset, tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("show") / "wall.zarr"
    write(path, [wall])
    return path


@pytest.mark.parametrize("modality", sorted(LAYOUTS))
@pytest.mark.parametrize("optional", [True, False])
@pytest.mark.parametrize("channel", [True, False])
def test_every_modality_has_a_picture(modality: str, optional: bool, channel: bool) -> None:
    capture = example_capture(modality, optional=optional, channel=channel)
    shown = beambench.show(capture)
    assert len(shown.panels) >= 2
    assert shown.png().startswith(b"\x89PNG")
    assert shown.chart().to_dict()["concat"]
    for panel in shown.panels:
        assert samples_of(panel, 20, 30).shape[2] == 3


@pytest.mark.parametrize("modality", sorted(LAYOUTS))
def test_a_modality_without_a_look_is_shown_plane_by_plane(modality: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delitem(LOOKS, modality)
    assert len(beambench.show(example_capture(modality)).panels) >= 2


@pytest.mark.parametrize("modality", sorted(LAYOUTS))
def test_a_recording_without_truth_has_a_picture(modality: str) -> None:
    capture = example_capture(modality)
    for name in capture.variables:
        if str(name).startswith("truth_") and capture[name].dtype.kind in "fc":
            capture[name] = capture[name].copy(data=np.full(capture[name].shape, np.nan, capture[name].dtype))
    shown = beambench.show(capture)
    assert shown.svg().startswith("<svg")
    assert not any("true" in line.name for panel in shown.panels if isinstance(panel, Curves) for line in panel.lines)


def test_the_picture_holds_the_capture(wall: xr.Dataset) -> None:
    """The panel of the truth is the truth, and the slices are those of their titles."""
    shown = beambench.show(wall)
    by_title = {panel.title: panel for panel in shown.panels if isinstance(panel, Image)}
    np.testing.assert_allclose(by_title["true range"].values, wall["truth_range"].values)
    slices = [title for title in by_title if title.startswith("slice")]
    assert 1 <= len(slices) <= 3
    for title in slices:
        (number,) = re.findall(r"slice (\d+)", title)
        np.testing.assert_array_equal(by_title[title].values, wall["counts"].values[int(number)])
    (only,) = (panel for panel in beambench.show(wall, element=3).panels if panel.title.startswith("slice"))
    assert only.title.startswith("slice 3,")


def test_true_echoes_lie_on_the_signal() -> None:
    """The mark of the truth is within the echo: its middle is no farther from it than the width of pulse and detector."""
    capture = generate(load_scene("photodetector-5m"), seed=1)
    signal, echo = beambench.show(capture).panels[0].lines[:2]  # type: ignore[union-attr]
    light = signal.y - np.median(signal.y)
    near = light > 0.5 * light.max()
    assert signal.x[near].min() <= echo.x[0] <= signal.x[near].max()


def test_the_true_line_lies_on_the_light() -> None:
    """Where the line is the brightest of its row, its peak is the true column to a pixel and the half that a pixel is wide."""
    capture = generate(load_scene("spotscan-wall"), seed=1)
    panel = beambench.show(capture).panels[0]
    assert isinstance(panel, Image)
    line = panel.lines[0]
    known = np.isfinite(line.x)
    peak = panel.values[line.y[known].astype(int)].argmax(axis=1)
    assert np.median(abs(peak - line.x[known])) <= 1.5


def test_slopes_point_to_where_spots_moved() -> None:
    """A positive slope moves a spot to larger columns and rows: strokes and centres of gravity agree in sign where both are far
    from zero."""
    from beambench.benchmarks.looks.wavefront import spots
    from beambench.captures.hide import hide_truth
    from beambench.estimators import run_estimator

    capture = generate(load_scene("turbulent-tank"), seed=1, fidelity="geometric")
    found = run_estimator("spot-ml+slope-cell", hide_truth(capture))["slope"].values[0]
    true, read = (spots(capture, 0, slope).lines[0] for slope in (capture["truth_slope"].values[0], found))
    a, b = (np.diff(line.x.reshape(-1, 3)[:, :2], axis=1)[:, 0] for line in (true, read))
    far = np.isfinite(a) & np.isfinite(b) & (abs(a) > np.nanmedian(abs(a)))
    assert np.mean(np.sign(a[far]) == np.sign(b[far])) > 0.9


def test_a_small_image_keeps_its_samples_and_a_line_its_place() -> None:
    values = np.arange(12.0).reshape(3, 4)
    diagonal = Curve("line", np.array([0.0, 2.0]), np.array([0.0, 2.0]), "#ff0000")
    samples = samples_of(image("small", values, "DN", lines=[diagonal]), 3, 4)
    assert samples.shape == (3, 4, 3)
    assert {(row, col) for row, col in np.argwhere((samples == (255, 0, 0)).all(axis=2))} == {(0, 0), (1, 1), (2, 2)}


def test_a_chart_loads_nothing_and_holds_no_bad_numbers(wall: xr.Dataset) -> None:
    spec = json.dumps(chart_of(look_of("gated")(wall, None), "wall"), allow_nan=False)
    assert not re.findall(r'"url": "(?!data:)', spec)


def test_blocks_have_one_line_for_two_rows() -> None:
    samples = np.zeros((3, 2, 3), np.uint8)
    samples[0, 0] = (255, 128, 0)
    coloured = colour_blocks(samples)
    assert len(coloured) == 2
    assert coloured[0].startswith("\x1b[38;2;255;128;0;48;2;0;0;0m▀")
    assert coloured[0].endswith("\x1b[0m")
    grey = grey_blocks(np.repeat(np.array([[[0] * 3, [255] * 3]], np.uint8), 2, axis=0))
    assert grey == [" █"]


def test_the_terminal_is_not_overrun(wall: xr.Dataset, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("COLUMNS", "60")
    monkeypatch.setenv("NO_COLOR", "1")
    assert max(map(len, drawn(beambench.show(wall).panels))) <= 60


def test_files_of_every_kind(store: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    for name, begin in (("a.png", b"\x89PNG"), ("a.svg", b"<svg"), ("a.html", b"<!doctype html>")):
        assert main(["show", str(store), "-o", str(tmp_path / name)]) == 0
        assert (tmp_path / name).read_bytes().startswith(begin)
        assert main(["show", str(store), "-o", str(tmp_path / name)]) == 2
        assert main(["show", str(store), "-o", str(tmp_path / name), "--overwrite"]) == 0
    capsys.readouterr()
    assert main(["show", str(store), "--json"]) == 0
    told = json.loads(capsys.readouterr().out)
    assert told["panels"][0]["unit"] == "DN" and told["file"] is None


def test_standard_output_that_is_no_terminal_gets_words(store: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["show", str(store)]) == 0
    out = capsys.readouterr().out
    assert "▀" not in out and "true range" in out and "--terminal" in out
    assert main(["show", str(store), "--terminal"]) == 0
    assert "▀" in capsys.readouterr().out


def test_the_browser_gets_a_page(store: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    opened: list[str] = []
    monkeypatch.setattr("webbrowser.open", lambda url: opened.append(url) or True)
    monkeypatch.chdir(tmp_path)
    assert main(["show", str(store), "--browser"]) == 0
    (url,) = opened
    assert url.startswith("file://") and "<svg" in Path(url.removeprefix("file://")).read_text(encoding="utf-8")


@pytest.mark.parametrize(
    ("more", "words"),
    [
        (["-o", "a.pdf"], ["format", "a.pdf", ".png"]),
        (["-o", "a.png", "--browser"], ["page", "a.png", ".html"]),
        (["--capture", "7"], ["no such capture", "7", "0 … 0"]),
        (["--element", "-1"], ["no such slice", "-1", "0 … "]),
    ],
)
def test_what_cannot_be_drawn_is_told(
    store: Path, more: list[str], words: list[str], capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["show", str(store), *more]) == 2
    error = capsys.readouterr().err
    assert all(word in error for word in words), error


def test_what_is_neither_capture_nor_run_is_told(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["show", str(tmp_path / "nothing")]) == 2
    assert "nothing" in capsys.readouterr().err
    (tmp_path / "run.json").write_text('{"verb": "twin"}', encoding="utf-8")
    assert main(["show", str(tmp_path)]) == 2
    assert "beambench twin" in capsys.readouterr().err


def test_a_run_shows_its_charts_and_its_best_estimate(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    suite = {
        "schema_version": 1, "suite": "small", "version": 1, "title": "Small",
        "scenes": [{"scene": "flat-wall", "overrides": SIDE}],
        "estimators": ["peak", "poisson-ml"],
        "seeds": {"dev": [1], "test": [2]}, "conditions": ["matched"],
    }  # fmt: skip
    beambench.run(suite, out=tmp_path / "run")
    shown = beambench.show(tmp_path / "run")
    assert len(shown.charts) == 1
    assert "poisson-ml" in shown.panels[1].title
    assert shown.png().startswith(b"\x89PNG")
    assert main(["show", str(tmp_path / "run"), "-o", str(tmp_path / "run.png")]) == 0
    out = capsys.readouterr().out
    assert "best" in out and "report.html" in out
