"""The measurement of the rungs of laser lines: its family of scenes, its errors, and the verb."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

import beambench
from beambench.benchmarks.fidelity import run as fidelity
from beambench.benchmarks.fidelity.bench import bench_of
from beambench.benchmarks.fidelity.laser_line import SHAPES, WATERS, line_family, measure_line_scene, replicated_error
from beambench.benchmarks.fidelity.rules import decisions
from beambench.generator.laser_line.pilot import image_error
from beambench.scenes.errors import InputError


def test_the_family_holds_every_water_and_shape_and_is_seeded(tmp_path: Path) -> None:
    scenes = line_family(4, 30, tmp_path)
    names = [scene.name.split("-") for scene in scenes]
    assert {name[0] for name in names} == set(WATERS) and {name[1] for name in names} == set(SHAPES)
    assert line_family(4, 30, tmp_path) == scenes and line_family(5, 30, tmp_path) != scenes
    assert line_family(4, 7, tmp_path) == scenes[:7]
    assert len({scene.name for scene in scenes}) == 30


def test_errors_are_free_of_the_references_noise() -> None:
    """An image that is 3 % too bright, against references with 20 and 10 % noise: 3 % within the intervals."""
    rng = np.random.default_rng(2)
    truth = np.ones((60, 60))
    pairs = [1.0 + 0.1 * rng.standard_normal((2, 60, 60)) for _ in range(2)]
    error, low, high = replicated_error(1.03 * truth, pairs[0], pairs[1])
    assert low < 0.03 < high and error == pytest.approx(0.03, abs=0.01)
    one, two = 1.0 + 0.2 * rng.standard_normal((2, 60, 60))
    error, low, high = image_error(1.03 * truth, one, two)
    assert low <= 0.03 <= high
    assert image_error(0.0 * truth, 0.0 * truth, 0.0 * truth) == (0.0, 0.0, 0.0)


def test_rows_of_a_wall_in_air(tmp_path: Path) -> None:
    """Nothing is left out: the line itself, sampled to each limit, is right by every rung, and the cheapest is taken."""
    scene = line_family(3, 8, tmp_path)[7]
    assert scene.name.startswith("air-flat")
    rows, told = measure_line_scene(scene, 3, (0.1, 0.01))
    assert [(row["rtol"], row["rung"]) for row in rows] == [(q, r) for q in (0.1, 0.01) for r in ("direct", "full")]
    assert set(rows[0]) == set(fidelity.COLUMNS) and told["references"] == "own"
    assert all(row["verdict"] == "self-consistent" and row["task_error"] < 0.02 for row in rows)
    assert [d.taken("auto") for d in decisions(rows)] == ["direct", "direct"] == [d.right for d in decisions(rows)]


def test_the_verb_takes_a_modality_that_has_a_family(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    bench = bench_of("laser_line")
    seen: list[Any] = []

    def measured(scene: Any, seed: int) -> Any:
        seen.append(scene.name)
        row = dict.fromkeys(fidelity.COLUMNS, 0.0) | {
            "modality": scene.modality, "scene": scene.name, "rung": "direct", "chosen": True, "verdict": "self-consistent",
            "rtol": 0.1, "limit": 0.1, "reference": "own", "cpu_s": 1.0,
        }  # fmt: skip
        return [row, row | {"rung": "full", "chosen": False}], {"scene": scene.name, "references": "own"}

    import beambench.benchmarks.fidelity.laser_line as module

    monkeypatch.setattr(module, "BENCH", type(bench)(bench.family, measured))
    folder = beambench.fidelity(modality="laser_line", scenes=3, seed=1, out=tmp_path / "out")
    assert len(seen) == 3 and len(fidelity.read_rows(folder / "fidelity.csv")) == 6
    with pytest.raises(InputError, match="no family of random scenes"):
        beambench.fidelity(modality="waveform", scenes=1, out=tmp_path / "no")
