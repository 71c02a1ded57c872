"""Captures made one after the other share what they can, and are those that `generate` makes alone."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from beambench.generator.generate import generate
from beambench.generator.random import Stage, drawn_from, generator
from beambench.generator.workshop import Workshop
from beambench.scenes.datasets.load import load_dataset

from ._data_sets import ALL_KINDS, tiny

#: Where random numbers begin beside `generator.random`: nowhere.
_BEGINS = re.compile(r"np\.random\.(SeedSequence|default_rng|seed|RandomState)\(")


@pytest.mark.parametrize("entry", ALL_KINDS["scenes"], ids=lambda entry: entry["scene"])
def test_each_capture_is_that_of_generate(entry: dict[str, Any]) -> None:
    """Other seeds and keys of one scene, and of a scene with other materials and light between them."""
    draws = load_dataset(tiny(ALL_KINDS, scenes=[entry]))
    scene = draws.possible(0)[1]
    brighter = scene.model_copy(update={"rig": scene.rig.model_copy(update={"t0_s": 1e-10})})
    rung: Any = draws.fidelity(draws.base(0))
    shop = Workshop()
    for one, seed, key in ((scene, 1, 0), (scene, 1, 1), (brighter, 2, 0), (scene, 2, 0)):
        made = shop.make(one, seed=seed, capture_key=key, fidelity=rung, rtol=0.1)
        assert made.identical(generate(one, seed=seed, capture_key=key, fidelity=rung, rtol=0.1))


def test_a_redraw_of_noise_traces_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    """The second capture of a scene needs no expectation, and one with other materials no new first hits."""
    from beambench.generator.rays.trace import Tracer

    draws = load_dataset(tiny())
    scenes = {draws.base(number): draws.possible(number)[1] for number in range(20)}
    shop, calls = Workshop(), []
    launch = Tracer._launch

    def counted(self: Any, *args: Any, **kwargs: Any) -> Any:
        calls.append(1)
        return launch(self, *args, **kwargs)

    monkeypatch.setattr(Tracer, "_launch", counted)
    scene = scenes["tilted-wall"]
    first = shop.make(scene, seed=1, capture_key=0, fidelity="direct", rtol=1e-2)
    assert calls
    calls.clear()
    second = shop.make(scene, seed=1, capture_key=1, fidelity="direct", rtol=1e-2)
    assert not calls
    assert (first["counts"].values != second["counts"].values).any()
    np.testing.assert_array_equal(first["truth_range"].values, second["truth_range"].values)
    item = scene.target[0]
    darker = item.model_copy(update={"material": item.material.model_copy(update={"albedo": 0.07})})
    shop.make(scene.model_copy(update={"target": (darker,)}), seed=1, capture_key=0, fidelity="direct", rtol=1e-2)
    assert not calls


def test_all_randomness_begins_in_one_file(project: Path) -> None:
    """What leaves `drawn_from` as it was depends on no seed, only if nothing else begins random numbers."""
    before = drawn_from()
    generator(1, 2, Stage.PHOTONS)
    assert drawn_from() == before + 1
    files = [path for path in (project / "generator").rglob("*.py") if path.name != "random.py"]
    assert len(files) > 50
    assert [str(path) for path in files if _BEGINS.search(path.read_text(encoding="utf-8"))] == []
    assert _BEGINS.search((project / "generator" / "random.py").read_text(encoding="utf-8"))
