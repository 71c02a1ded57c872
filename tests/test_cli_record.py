"""Recording from the command line, as typed: the commands of docs/recording.md, files that it shows, and what goes wrong."""

from __future__ import annotations

import io
import json
import re
import tomllib
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from beambench import cli
from beambench.captures import open_captures
from beambench.captures.recording.plan import load_plan, load_rig
from beambench.captures.recording.record import devices_of
from beambench.live_frame import LiveFrame, blocks, progress_line, sixel

from ._emulated import SHAPE, bench, free_host


def commands(project: Path) -> list[list[str]]:
    text = (project / "docs" / "recording.md").read_text(encoding="utf-8")
    return [line.split() for line in re.findall(r"^    beambench (.+)$", text, re.MULTILINE)]


def test_the_page_is_typed(
    project: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    typed = commands(project)
    assert [words[0] for words in typed] == ["record", "record", "data", "drivers"]
    for words in typed:
        assert cli.main(words) == 0, capsys.readouterr().err
    said = capsys.readouterr().out
    assert "No device was touched." in said and "250 of 250 shots" in said and "real.zarr: sound" in said
    capture = open_captures(tmp_path / "real.zarr")[0].load()
    assert capture.valid.values.all() and capture.sizes["slice"] == 250
    # It sees a sphere before a wall: light where the gate is on them, none without the laser.
    counts = capture.counts.values.astype(float)
    dark, lit = counts[~capture.laser_on.values].mean(), counts[capture.laser_on.values].max(axis=0).mean()
    assert lit > dark + 20


def test_the_files_of_the_page_are_valid(project: Path) -> None:
    text = (project / "docs" / "recording.md").read_text(encoding="utf-8")
    plan, rig = (tomllib.loads(block) for block in re.findall(r"```toml\n(.*?)```", text, re.DOTALL))
    planned = load_plan(plan)
    assert len(planned.slots) == 126
    assert devices_of(planned, load_rig(rig)).trigger == "delay"


def files(tmp_path: Path, camera: str, delay: str, **changes: Any) -> list[str]:
    plan = {
        "schema_version": 1, "plan": "cli", "title": "CLI", "instrument": "flat-wall",
        "changes": {"rig.camera.rows": SHAPE[0], "rig.camera.cols": SHAPE[1]},
        "scan": {"start_s": 29.5e-9, "step_s": 1e-9, "count": 3, "repeats": 1, "averages": 1, "dark": 0, "reference": 0},
    }  # fmt: skip
    rig = {
        "schema_version": 1, "rig": "cli", "title": "CLI", "trigger": "delay", "shot_timeout_s": 0.5, "give_up_s": 0.3,
        "devices": {
            "delay": {"driver": "dg645", "address": delay},
            "camera": {"driver": "gige", "address": camera, "serial": "EMU0001"} | changes,
        },
        "settings": {"camera": {"TriggerMode": "On", "TriggerSource": "Line0"}},
    }  # fmt: skip
    (tmp_path / "plan.json").write_text(json.dumps(plan))
    (tmp_path / "rig.json").write_text(json.dumps(rig))
    return ["record", str(tmp_path / "plan.json"), "--rig", str(tmp_path / "rig.json"), "-o", str(tmp_path / "o.zarr")]


def test_exit_codes(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    with bench() as (rig, sight):
        delay = "{}:{}".format(*rig.delays.address)
        words = files(tmp_path, rig.camera.address[0], delay)
        assert cli.main([*words, "--set", "scan.start_ns=3"]) == 2
        assert "start_ns" in capsys.readouterr().err
        assert cli.main([*files(tmp_path, free_host(), delay)]) == 2
        assert "does not answer" in capsys.readouterr().err
        assert cli.main([*files(tmp_path, rig.camera.address[0], delay, serial="OTHER")]) == 2
        assert "Another camera" in capsys.readouterr().err
        assert not (tmp_path / "o.zarr.recording").exists()
        words = files(tmp_path, rig.camera.address[0], delay)
        rig.camera.waits_for = lambda source: len(sight.seen) < 2  # type: ignore[method-assign]
        assert cli.main(words) == 3
        assert "--resume" in capsys.readouterr().out
        assert cli.main([*words, "--resume", "--json"]) == 3
        assert json.loads(capsys.readouterr().out)["done"] == 2
        del rig.camera.waits_for  # type: ignore[method-assign]
        assert cli.main([*words, "--resume"]) == 0
        assert cli.main(words) == 2
        assert "The output exists" in capsys.readouterr().err
    assert cli.main(["record", "gated-demo"]) == 2
    assert cli.main(["record", "gated-demo", "--rig", "emulator", "--resume"]) == 2
    assert cli.main(["record", "nothing", "--rig", "emulator"]) == 2
    assert cli.main(["record", "line-survey", "--rig", "emulator", "-o", str(tmp_path / "l.zarr")]) == 2
    assert cli.main(["record", "gated-demo", "--finish", "-o", str(tmp_path / "n.zarr")]) == 2


# ---------------------------------------------------------------- the last frame in the terminal


def test_blocks_show_bright_and_dark() -> None:
    image = np.zeros((4, 3))
    image[:2] = 100.0
    upper, lower = blocks(image, 2, 3)
    assert upper.count("▀") == lower.count("▀") == 3
    assert "38;5;255;48;5;255" in upper and "38;5;232;48;5;232" in lower
    wide = blocks(np.random.default_rng(1).random((300, 500)), 16, 64)
    assert len(wide) <= 16 and all(line.count("▀") <= 64 for line in wide)


def test_sixels_decode_to_the_image() -> None:
    image = np.arange(16.0).reshape(2, 8)
    text = sixel(image, 14, 16)
    assert text.startswith("\x1bPq") and text.endswith("\x1b\\")
    shown = np.full((18, 16), -1)
    band, level, column = 0, 0, 0
    for token in re.findall(r"#\d+;2;\d+;\d+;\d+|#\d+|[?-~]|[$-]", text[3:-2]):
        if ";" in token:
            continue
        if token.startswith("#"):
            level = int(token[1:])
        elif token == "$":
            column = 0
        elif token == "-":
            band, column = band + 6, 0
        else:
            for bit in range(6):
                if ord(token) - 63 >> bit & 1:
                    shown[band + bit, column] = level
            column += 1
    grey = shown[:4:2, ::2]  # enlarged twice
    assert grey[0, 0] == 0 and grey[1, 7] == 15 and (np.diff(grey.ravel()) >= 0).all()


def test_the_line_says_the_time_that_is_left() -> None:
    assert progress_line(30, 120, 20, 10.0, "scan") == "record 30/120 scan, 45 s left"
    assert progress_line(120, 120, 20, 10.0, "scan") == "record 120/120 scan"
    stream = io.StringIO()
    with LiveFrame(stream=stream) as live:
        live(1, 2, "dark", np.zeros((4, 4)))
        live(2, 2, "scan", None)
    assert stream.getvalue().splitlines() == ["record 1/2 dark", "record 2/2 scan"]
