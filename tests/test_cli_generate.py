"""The command `generate`: what it says of the rung that `auto` chose, and seeds as they are typed."""

from __future__ import annotations

from pathlib import Path

import pytest

from beambench.cli import main
from beambench.commands.rungs import chosen_text

EFFECTS = [
    {"name": "interreflection", "modelled": False, "predicted_relative_size": 4.42},
    {"name": "halo", "modelled": True, "predicted_relative_size": 9.0},
    {"name": "speckle", "modelled": False, "predicted_relative_size": None},
    {"name": "jitter", "modelled": False, "predicted_relative_size": 0.001},
]


def test_a_choice_in_words() -> None:
    told = {
        "rung": "scatter",
        "effects": EFFECTS,
        "chosen": {"predicted_error": {"direct": 0.95, "scatter": 0.032}, "limit": 0.05},
    }
    assert chosen_text(told) == (
        "scatter: the cheapest with a predicted error below 0.05 (predicted: direct 0.95, scatter 0.032); "
        "effects above it that are left out: interreflection (4.4)"
    )
    assert chosen_text({"rung": "direct", "effects": EFFECTS}) == ""


def test_the_command_tells_the_rung(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    small = [
        "--set",
        "rig.camera.rows=4",
        "--set",
        "rig.camera.cols=4",
        "--rtol",
        "0.1",
        "--seeds",
        "1",
        "--seeds",
        "2",
    ]
    assert main(["generate", "flat-wall", "--fidelity", "auto", *small, "-o", str(tmp_path / "a.zarr")]) == 0
    lines = [line for line in capsys.readouterr().out.splitlines() if line.startswith("rung ")]
    assert len(lines) == 1 and "direct: the cheapest with a predicted error below 0.1" in lines[0]


def test_seeds_between_commas_or_repeated(capsys: pytest.CaptureFixture[str]) -> None:
    for seeds in (["--seeds", "3,5"], ["--seeds", "3", "--seeds", "5"]):
        assert main(["generate", "flat-wall", "--plan", *seeds]) == 0
        assert "2 captures" in capsys.readouterr().out
    assert main(["generate", "flat-wall", "--plan", "--seeds", "3", "5"]) == 2
    assert "An option for several values is repeated" in capsys.readouterr().err
