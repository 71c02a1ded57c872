"""Data sets: what is drawn has its distribution, depends on its number alone, and is split so that no scene is in two parts."""

from __future__ import annotations

import json
from collections import Counter
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy import stats

from beambench.scenes.datasets.content import scene_content
from beambench.scenes.datasets.draws import Draws
from beambench.scenes.datasets.expressions import Expression
from beambench.scenes.datasets.load import is_dataset, load_dataset
from beambench.scenes.datasets.spec import list_datasets
from beambench.scenes.errors import InputError

from ._data_sets import tiny


def drawn(parameters: dict[str, Any], count: int, **changes: Any) -> list[dict[str, Any]]:
    draws = load_dataset(tiny(parameters=parameters, captures=count, **changes))
    return [draws.drawn(number).values for number in range(count)]


@pytest.mark.parametrize(
    ("spec", "law"),
    [
        ({"kind": "uniform", "low": 2.0, "high": 5.0}, stats.uniform(2.0, 3.0)),
        ({"kind": "log_uniform", "low": 0.1, "high": 100.0}, stats.loguniform(0.1, 100.0)),
        ({"kind": "normal", "mean": 3.0, "sigma": 0.5}, stats.norm(3.0, 0.5)),
        ({"kind": "normal", "mean": 0.0, "sigma": 1.0, "low": -0.5, "high": 2.0}, stats.truncnorm(-0.5, 2.0)),
    ],
)
def test_each_distribution_is_drawn(spec: dict[str, Any], law: Any) -> None:
    """Kolmogorov and Smirnov's test of 2000 draws at 1e-4: the seed is fixed, so that it fails always or never."""
    values = [one["x"] for one in drawn({"x": spec}, 2000)]
    assert stats.kstest(values, law.cdf).pvalue > 1e-4


def test_whole_numbers_and_choices_are_drawn_by_their_weights() -> None:
    count = 3000
    rows = drawn(
        {
            "n": {"kind": "integers", "low": 3, "high": 5},
            "c": {"kind": "choice", "values": ["a", "b"], "weights": [1, 3]},
        },
        count,
    )
    numbers, choices = Counter(row["n"] for row in rows), Counter(row["c"] for row in rows)
    assert set(numbers) == {3, 4, 5}
    assert stats.chisquare([numbers[n] for n in (3, 4, 5)]).pvalue > 1e-4
    assert stats.chisquare([choices["a"], choices["b"]], [count / 4, 3 * count / 4]).pvalue > 1e-4


def test_grids_give_every_combination_in_turn() -> None:
    grids = {"a": {"kind": "grid", "values": [1, 2]}, "b": {"kind": "grid", "values": ["x", "y", "z"]}}
    rows = [(row["a"], row["b"]) for row in drawn(grids, 12)]
    assert rows[:6] == [(1, "x"), (1, "y"), (1, "z"), (2, "x"), (2, "y"), (2, "z")]
    assert rows[6:] == rows[:6]


def test_correlated_parameters_keep_their_distributions() -> None:
    """Gaussian copula of r = .8: Spearman's rho is 6/π asin(r/2) = .786 ± 4 standard errors of 1/√n."""
    count = 2000
    rows = drawn(
        {"a": {"kind": "uniform", "low": 0.0, "high": 1.0}, "b": {"kind": "log_uniform", "low": 1.0, "high": 10.0}},
        count,
        correlated=[{"names": ["a", "b"], "correlation": [[1.0, 0.8], [0.8, 1.0]]}],
    )
    a, b = (np.array([row[name] for row in rows]) for name in ("a", "b"))
    assert stats.kstest(a, "uniform").pvalue > 1e-4
    assert stats.kstest(np.log10(b), "uniform").pvalue > 1e-4
    assert abs(stats.spearmanr(a, b).statistic - 6 / np.pi * np.arcsin(0.4)) < 4 / np.sqrt(count)


def test_a_draw_depends_on_its_number_alone() -> None:
    """Neither on the order, nor on what else the file draws, nor on the number of captures."""
    one = {"x": {"kind": "uniform", "low": 0.0, "high": 1.0}}
    other = {"w": {"kind": "normal", "mean": 0.0, "sigma": 1.0}, **one}
    alone = load_dataset(tiny(parameters=one, captures=10))
    beside = load_dataset(tiny(parameters=other, captures=1000))
    for number in (9, 3, 5):
        assert alone.drawn(number).values["x"] == beside.drawn(number).values["x"]
        assert alone.base(number) == beside.base(number)
    assert alone.drawn(0).values != load_dataset(tiny(parameters=one, seed=4)).drawn(0).values


def test_expressions_follow_what_they_need() -> None:
    rows = drawn(
        {
            "area": {"kind": "expression", "text": "pi * radius ** 2 if radius < 2 else 0"},
            "radius": {"kind": "expression", "text": "max(1, half) * 1.5"},
            "half": {"kind": "uniform", "low": 0.0, "high": 1.0},
            "rows": {"kind": "expression", "text": "10 * half + 3", "whole": True},
        },
        20,
    )
    assert all(row["area"] == np.pi * 1.5**2 for row in rows)
    assert all(isinstance(row["rows"], int) and row["rows"] == round(10 * row["half"] + 3) for row in rows)


@pytest.mark.parametrize(
    "text",
    [
        "__import__('os').system('true')", "x.real", "x[0]", "[x for x in (1,)]", "lambda: 1", "open('f')", "x and 1", "'a' * 9",
        "(x := 1)", "min(*x)", "round(x, ndigits=2)", "1 if x else 2", "x < 1", "not_there + True", "", "1 +", "(" * 300, "x" * 500,
    ],
)  # fmt: skip
def test_nothing_else_is_an_expression(text: str) -> None:
    with pytest.raises(InputError):
        Expression(text, "x").at({"x": 1.0})


@pytest.mark.parametrize(
    "text", ["9 ** 9 ** 9", "1 / (x - 1)", "sqrt(-x)", "log(0 * x)", "exp(1e9 * x)", "(-x) ** 0.5"]
)
def test_an_expression_without_a_value_is_refused(text: str) -> None:
    with pytest.raises(InputError, match="expression"):
        Expression(text, "x").at({"x": 1.0})


def test_no_scene_is_in_two_parts() -> None:
    """Equal targets and media, under other names or with another rig, are one scene, and so in one part."""
    turn = {
        "tilt": {"kind": "choice", "values": [float(n) for n in range(20)], "paths": ["target.0.shape.tilt_y_deg"]},
        "light": {"kind": "uniform", "low": 0.1, "high": 1.0, "paths": ["rig.camera.transmission"]},
    }
    scenes = [{"scene": "step"}, {"scene": "step", "name": "again", "overrides": {"target.0.name": "other"}}]
    draws = load_dataset(tiny(parameters=turn, scenes=scenes, captures=400))
    parts: dict[str, set[str]] = {}
    for number in range(400):
        one = draws.drawn(number)
        parts.setdefault(draws.content(one), set()).add(draws.part(one))
    assert len(parts) == 20
    assert all(len(found) == 1 for found in parts.values())


def test_a_drawn_table_without_its_defaults_is_the_scene_that_is_recorded() -> None:
    """A material with and without its default masking is one scene, in one part, by the hash of what a capture records."""
    full = {
        "kind": "cook-torrance", "diffuse_albedo": 0.2, "f0": 0.04, "roughness": 0.3, "distribution": "beckmann",
        "masking": "height-correlated",
    }  # fmt: skip
    short = {key: value for key, value in full.items() if key != "masking"}
    turn = {"material": {"kind": "choice", "values": [full, short], "paths": ["target.0.material"]}}
    draws = load_dataset(tiny(parameters=turn, scenes=[{"scene": "step"}], captures=40))
    found = [draws.drawn(number) for number in range(40)]
    assert {len(one.values["material"]) for one in found} == {5, 6}
    assert len({draws.content(one) for one in found}) == len({draws.part(one) for one in found}) == 1
    recorded = draws.scene(found[0]).model_dump(mode="json")
    assert draws.content(found[0]) == scene_content(recorded, ("target", "medium"))


def test_the_parts_have_their_shares() -> None:
    """Binomial: within 4 standard deviations of .2 n."""
    draws = load_dataset(tiny(captures=2000))
    parts = Counter(draws.part(draws.drawn(number)) for number in range(2000))
    assert abs(parts["test"] - 400) < 4 * np.sqrt(2000 * 0.2 * 0.8)


def test_a_file_is_known_by_its_content(tmp_path: Path) -> None:
    """A texture under another name is the same scene, and one that differs is another."""
    base = json.loads(json.dumps(load_dataset(tiny()).scenes["step"]))
    for name, value in (("a", 0.5), ("b", 0.5), ("c", 0.7)):
        np.savez(tmp_path / f"{name}.npz", albedo=np.full((2, 2), value, np.float32))
    found = []
    for name in "abc":
        base["target"][0]["texture"] = {"file": str(tmp_path / f"{name}.npz")}
        found.append(scene_content(base, ("target", "medium")))
    assert found[0] == found[1] != found[2]


def test_an_impossible_scene_is_drawn_again_or_told() -> None:
    """A sphere around the camera is impossible; drawn again it is not, and always in the same way."""
    inside = {"radius": {"kind": "uniform", "low": 1.0, "high": 7.0, "paths": ["target.0.shape.radius_m"]}}
    scene = [{"scene": "sphere", "overrides": {"target.0.shape.center_m": [0.0, 0.0, 4.0]}}]
    refused = load_dataset(tiny(parameters=inside, scenes=scene))
    with pytest.raises(InputError, match=r"is impossible.*inside"):
        for number in range(20):
            refused.possible(number)
    again = load_dataset(tiny(parameters=inside, scenes=scene, redraws=50))
    values = [again.possible(number)[0].values["radius"] for number in range(20)]
    assert max(values) < 4.0
    assert values == [again.possible(number)[0].values["radius"] for number in range(20)]


@pytest.mark.parametrize(
    ("changes", "told"),
    [
        ({"captures": 0}, "captures"),
        ({"scenes": [{"scene": "nowhere"}]}, "no such scene"),
        ({"split": {"train": 0.5, "validation": 0.1, "test": 0.1}}, "sum to 0.7"),
        ({"split": {"train": 1, "validation": 0, "test": 0, "by": ["rig"]}}, "leak"),
        ({"parameters": {"x": {"kind": "cauchy"}}}, "kind should be one of"),
        ({"parameters": {"x": {"kind": "uniform", "low": 2, "high": 1}}}, "below"),
        ({"parameters": {"sqrt": {"kind": "uniform", "low": 0, "high": 1}}}, "cannot be the name"),
        ({"parameters": {"x": {"kind": "expression", "text": "y"}}}, "no parameter is named"),
        ({"parameters": {"x": {"kind": "expression", "text": "x + 1"}}}, "need each other"),
        ({"parameters": {n: {"kind": "uniform", "low": 0, "high": 1, "paths": ["rig.t0_s"]} for n in "ab"}}, "one path"),
        ({"correlated": [{"names": ["albedo", "none"], "correlation": [[1, 0], [0, 1]]}]}, "no parameter"),
        ({"correlated": [{"names": ["albedo", "energy_j"], "correlation": [[1, 2], [2, 1]]}]}, "positive definite"),
    ],
)  # fmt: skip
def test_a_wrong_file_is_refused_with_its_reason(changes: dict[str, Any], told: str) -> None:
    with pytest.raises(InputError, match=told):
        load_dataset(tiny(**changes))


def test_files_of_a_data_set_lie_in_its_folder(tmp_path: Path) -> None:
    path = tmp_path / "set" / "mine.json"
    path.parent.mkdir()
    path.write_text(json.dumps(tiny(scenes=[{"scene": "../other.toml"}])))
    assert is_dataset(path)
    with pytest.raises(InputError, match="lie in its folder"):
        load_dataset(path)
    texture = {"texture": {"kind": "choice", "values": [{"file": "../x.npz"}], "paths": ["target.0.texture"]}}
    path.write_text(json.dumps(tiny(parameters=texture)))
    with pytest.raises(InputError, match="lie in its folder"):
        load_dataset(path)


@pytest.mark.parametrize("name", list_datasets())
def test_the_library_is_whole(name: str) -> None:
    draws = load_dataset(name)
    assert draws.data.dataset == name
    assert Draws.of(json.loads(json.dumps(draws.resolved()))).drawn(7) == draws.drawn(7)
    for number in range(3):
        draws.possible(number)
