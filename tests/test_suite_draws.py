"""Draws of a suite: each seed has its own pose, old suites keep their hash, and guessing pays no more than refusing."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from beambench.benchmarks.judges.drawn import with_draws
from beambench.benchmarks.laws.gated import clean_capture
from beambench.benchmarks.scores.truth import Bound, Truth, refusal_error
from beambench.benchmarks.suites.spec import Draw
from beambench.benchmarks.suites.suite import cells_of, drawn_scene, list_suites, load_suite
from beambench.generator.generate import generate
from beambench.scenes.errors import InputError
from beambench.scenes.load import load_scene

from ._scores import range_rows

SUITE: dict[str, Any] = {
    "suite": "drawn", "scenes": [{"scene": "flat-wall"}, {"scene": "tilted-wall"}], "seeds": {"test": [1, 2, 3]},
    "estimators": ["peak"], "stresses": [{"axis": "photons", "values": [2.0, 1.0]}],
}  # fmt: skip
DRAWS = [{"axis": "distance", "low": -0.1, "high": 0.2}]


def _depth(scene: Any) -> float:
    return float(scene.target[0].shape.center_m[2])


def test_each_scene_and_seed_has_its_own_pose_the_same_at_every_level_and_in_every_run() -> None:
    nominal = _depth(load_scene("flat-wall"))
    cells = cells_of(load_suite({**SUITE, "draws": DRAWS}))
    again = cells_of(load_suite({**SUITE, "draws": DRAWS}))
    assert [cell.scene for cell in cells] == [cell.scene for cell in again]
    moved = {(cell.scene_name, cell.seed, cell.stress, cell.level): _depth(cell.scene) for cell in cells}
    assert len(moved) == 18
    for name in ("flat-wall", "tilted-wall"):
        seeds = [{depth for key, depth in moved.items() if key[:2] == (name, seed)} for seed in (1, 2, 3)]
        assert all(len(found) == 1 for found in seeds), "one pose per seed, whatever the stress"
        assert len(set.union(*seeds)) == 3
    shifts = [depth - nominal for key, depth in moved.items() if key[0] == "flat-wall"]
    assert -0.1 <= min(shifts) < max(shifts) <= 0.2
    assert cells[0].scene.rig == load_scene("flat-wall").rig, "the rig does not tell"


def test_the_draw_is_uniform() -> None:
    """Kolmogorov's distance of 300 draws from the uniform law, below the 1e-3 quantile 1.95/√n."""
    scene, draw = load_scene("flat-wall"), Draw(axis="distance", low=-0.1, high=0.2)
    levels = [_depth(drawn_scene("s", scene, [draw], seed)) - _depth(scene) for seed in range(300)]
    u = np.sort((np.array(levels) + 0.1) / 0.3)
    assert np.abs(u - (np.arange(300) + 0.5) / 300).max() < 1.95 / math.sqrt(300)


def test_a_suite_without_draws_keeps_its_hash_and_one_with_draws_has_another() -> None:
    plain, drawn = load_suite(SUITE), load_suite({**SUITE, "draws": DRAWS})
    assert "draws" not in plain.suite.model_dump(mode="json") and plain.hash != drawn.hash
    assert load_suite({**SUITE, "draws": [], "new_child": "condition"}).hash == plain.hash
    assert load_suite({**SUITE, "new_child": "capture"}).hash != plain.hash


@pytest.mark.parametrize(
    "draws",
    [
        [{"axis": "distance", "low": 0.1, "high": 0.1}],
        [{"axis": "no-such", "low": 0.0, "high": 1.0}],
        [{"axis": "distance", "low": 0.0, "high": 1.0, "scenes": ["no-such-scene"]}],
    ],
)
def test_a_draw_that_is_none_is_refused(draws: Any) -> None:
    with pytest.raises(InputError):
        load_suite({**SUITE, "draws": draws})


def test_a_draw_may_be_of_some_scenes_only() -> None:
    draws = [{**draw, "scenes": ["flat-wall"]} for draw in DRAWS]
    loaded = load_suite({**SUITE, "draws": draws})
    assert len(loaded.draws("flat-wall")) == len(DRAWS) and not loaded.draws("tilted-wall")
    depths = {
        name: {_depth(cell.scene) for cell in cells_of(loaded) if cell.scene_name == name} for name, _ in loaded.scenes
    }
    assert len(depths["flat-wall"]) == 3 and len(depths["tilted-wall"]) == 1


#: Built-in suites whose captures are of scenes that stand still, and why (docs/stress-and-breakdown.md).
STILL = {
    "laser-line-calibration": "what is estimated is the rig", "laser-line-spectrum": "seafloors of their source",
    "laser-tank": "data sets of their source", "learned-training": "for training", "learned-scatter": "for training",
    "wavefront": "the generator draws turbulence", "wavefront-turbulence": "the generator draws turbulence",
}  # fmt: skip


@pytest.mark.parametrize(
    "name", [name for name in list_suites() if not name.startswith("stress-") and name not in STILL]
)
def test_a_suite_of_a_ranking_draws_every_scene_and_its_rig_does_not_tell(name: str) -> None:
    loaded = load_suite(name)
    seen = {scene for scene, held in loaded.scenes if held.target and held.modality != "wavefront"}
    cells = [cell for split in ("dev", "test") for cell in cells_of(loaded, split) if cell.scene_name in seen]
    for scene in seen:
        found = {cell.seed: cell.scene for cell in cells if cell.scene_name == scene and cell.stress == "none"}
        assert len({held.rig.model_dump_json() for held in found.values()}) == 1
        assert len({_depth(held) for held in found.values()}) == len(found) > 1
    levels = {cell.stress for cell in cells} - {"none"}
    assert loaded.suite.new_child == "capture" or not levels, "a plug-in would see one pose at several levels"


def test_the_truth_of_a_wavefront_is_another_for_every_seed_and_level() -> None:
    """Slopes of two captures have nothing in common: two thirds of 2 · var or more lies between them."""
    changes = {"rig.lenslets.across": 10, "rig.pupil.diameter_m": 1.5e-3, "rig.pupil.modes": 21, "rig.camera.rows": 96}
    loaded = load_suite("wavefront", {**changes, "rig.camera.cols": 96, "rig.frames.count": 16})
    seeds = loaded.suite.seeds.test[:2]
    here = [cell for cell in cells_of(loaded) if cell.scene_name == "gated-turbulence" and cell.seed in seeds]
    wanted = [cell for cell in here if cell.stress == "none" or cell.level == 1.0]
    slopes = []
    for cell in wanted:
        made = generate(cell.scene, seed=cell.seed, capture_key=cell.key, fidelity="geometric", rtol=1e-3)
        slopes.append(made["truth_slope"].values)
    assert len(slopes) == 4
    for i, one in enumerate(slopes):
        for two in slopes[:i]:
            assert ((one - two) ** 2).mean() > (2.0 / 3.0) * (one.var() + two.var())


def test_turned_objects_are_turned_further() -> None:
    scene = load_scene("tilted-wall")
    turned = drawn_scene("s", scene, [Draw(axis="turn", low=2.0, high=2.0 + 1e-9)], 1)
    held: Any = (scene.target[0].shape, turned.target[0].shape)
    assert held[1].tilt_y_deg - held[0].tilt_y_deg == pytest.approx(2.0)


def test_the_spread_of_a_draw_reaches_the_quantities_of_its_unit_only() -> None:
    bounds = {"range": Bound(np.ones(3), "exact", 0.1, 4.0)}
    draws = [Draw(axis="distance", low=-0.3, high=0.3), Draw(axis="turn", low=0.0, high=9.0)]
    capture = clean_capture()
    assert with_draws(bounds, capture, draws)["range"].drawn == pytest.approx(0.6 / math.sqrt(12.0))
    assert math.isnan(with_draws(bounds, capture, draws[1:])["range"].drawn)


def test_guessing_costs_at_least_a_refusal() -> None:
    """Mean squares over 400 seeds of walls of 5 cm relief, 2 m ± .3 m: every constant costs what refusing costs, or more.

    The variance of the mean of 400 draws of (mean − guess)² is at most (4·.3⁴/45)/400: three standard errors are 1 % of .0325.
    """
    rng, shape = np.random.default_rng(2), (16, 16)
    bound = Bound(np.full(shape, 0.01), "exact", 0.1, 4.0, drawn=0.6 / math.sqrt(12.0))
    key: dict[str, Any] = {
        "suite": "t", "scene": "s", "stress": "none", "level": math.nan, "stress2": "none", "level2": math.nan,
        "seed": 1, "condition": "matched", "estimator": "e", "params": "",
    }  # fmt: skip
    square: dict[float | None, list[float]] = {guess: [] for guess in (None, 1.8, 1.9, 2.0, 2.1, 2.5)}
    for _ in range(400):
        truth = Truth.plain(2.0 + rng.uniform(-0.3, 0.3) + 0.05 * rng.standard_normal(shape))
        for guess, found in square.items():
            answer = {
                "range": np.full(shape, guess or 0.0), "sigma": np.full(shape, 0.1),
                "valid": np.full(shape, guess is not None),
            }  # fmt: skip
            (row,) = range_rows(key, truth, bound, answer, status="ok")
            found.append(float(row["rmse_full"]) ** 2)
    refusing = float(np.mean(square.pop(None)))
    assert refusing == pytest.approx(0.03 + 0.0025, rel=0.01)
    assert min(float(np.mean(found)) for found in square.values()) > 0.98 * refusing


def test_a_refusal_costs_window_over_root_12_at_most_and_without_draws() -> None:
    truth = Truth.plain(np.array([1.0, 3.0, np.nan]))
    chosen = np.array([True, True, False])
    bound = Bound(np.ones(3), "exact", 0.1, 2.0)
    assert refusal_error(truth, chosen, bound) == bound.prior == 2.0 / math.sqrt(12.0)
    assert refusal_error(truth, chosen, replace(bound, drawn=0.1)) == bound.prior  # spread 1 m
    wide = replace(bound, window=40.0, drawn=0.1)
    assert refusal_error(truth, chosen, wide) == pytest.approx(math.hypot(1.0, 0.1))
    assert refusal_error(truth, np.zeros(3, bool), wide) == wide.prior
