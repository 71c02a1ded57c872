"""The measurement of the ladder: its family of scenes, its errors, and the table it writes."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from beambench.benchmarks.fidelity import COLUMNS, measure_scene, summarise, task_error
from beambench.benchmarks.fidelity_family import MEDIA, SHAPES, draw_scene, family
from beambench.benchmarks.tables import to_csv
from beambench.generator.choose import stack_error
from beambench.generator.trace import Tracer
from beambench.scenes.load import load_scene


def test_the_family_holds_every_medium_and_shape_and_is_seeded(tmp_path: Path) -> None:
    scenes = family(4, 40, tmp_path)
    names = {tuple(s.name.split("-")[:3]) for s in scenes}
    assert names == {(m, s, d) for m in MEDIA for s in SHAPES for d in ("near", "far")}
    assert family(4, 40, tmp_path) == scenes
    assert family(5, 40, tmp_path) != scenes
    for scene in scenes[:6]:
        Tracer(scene)


def test_error_is_free_of_the_references_noise() -> None:
    """A stack that is 3 % too bright, against two references with 20 % noise: ε = 3 % within its interval's width."""
    rng = np.random.default_rng(1)
    truth = np.ones((20, 30, 30), dtype=np.float32)
    one, two = (truth + 0.2 * rng.standard_normal(truth.shape).astype(np.float32) for _ in range(2))
    error, low, high = stack_error(np.float32(1.03) * truth, one, two)
    assert low < 0.03 < high and error == pytest.approx(0.03, rel=0.25)


def test_task_error_of_a_shift_is_the_shift_over_the_bound() -> None:
    scene = load_scene("flat-wall", {"rig.detector.read_noise_e": 0.0})
    time = np.linspace(-4, 4, 60)[:, None, None]
    truth = (1000 * np.exp(-(time**2) / 2) + 5).astype(np.float32) * np.ones((1, 2, 2), dtype=np.float32)
    slope = (1000 * time * np.exp(-(time**2) / 2)).astype(np.float32) * np.ones((1, 2, 2), dtype=np.float32)
    bound = 1 / np.sqrt(np.sum(slope[:, 0, 0] ** 2 / truth[:, 0, 0]))
    shifted = truth + 0.1 * bound * slope
    assert task_error(scene, shifted, truth, slope, np.zeros(60)) == pytest.approx(0.1, rel=1e-3)


def test_rows_of_a_dark_corner(tmp_path: Path) -> None:
    scene = draw_scene(3, 0, "air", "corner", False, tmp_path)
    rows = measure_scene(scene, 3, (0.1, 0.01))
    assert [r["rung"] for r in rows] == ["direct", "full"]
    direct, full = rows
    assert full["rel_error"] < 0.01 and full["rel_error"] <= full["hi"]
    assert direct["predicted_error"] == pytest.approx(direct["rel_error"], rel=0.3)
    assert sum(len(r["chosen"].split(";")) for r in rows if r["chosen"]) == 2
    assert to_csv(rows, COLUMNS).splitlines()[0] == ",".join(COLUMNS)
    told = summarise(rows)
    assert told["decisions"] == 2 and told["within rtol"] == 1.0
