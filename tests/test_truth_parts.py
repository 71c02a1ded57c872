"""Truth by parts: which piece of the target each pixel sees, and what the light is the sum of, on every rung that knows."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import beambench
from beambench import cli
from beambench.generator.generate import generate
from beambench.scenes.load import load_scene
from beambench.scenes.scene import Scene

from ._recipes import shape_of

SMALL = {"rig.camera.rows": 24, "rig.camera.cols": 24, "rig.camera.pixel_pitch_m": 2e-4, "rig.delays.count": 6}


def wreck() -> Scene:
    """Ground and wreckage of one draw as two targets of their own materials."""
    data = load_scene("tilted-wall", SMALL).model_dump(mode="json")
    data["target"] = [
        {"name": part, "shape": shape_of("wreck", 5, part=part), "material": {"kind": "lambert", "albedo": albedo}}
        for part, albedo in (("ground", 0.2), ("objects", 0.6))
    ]
    return load_scene(data)


def test_instances_are_told_and_belong_to_one_material() -> None:
    capture = generate(wreck(), seed=1, truth_instances=True)
    instance, material = capture["truth_instance"].values, capture["truth_material"].values
    assert "truth_instance" not in generate(wreck(), seed=1)
    assert ((instance == -1) == (material == -1)).all() and ((instance == 0) == (material == 0)).all()
    assert len(np.unique(instance)) > 8 and instance.max() <= 14
    assert np.array_equal(np.unique(capture["truth_albedo"].values[instance > 0]), np.float32([0.6]))


def test_two_parts_are_the_whole_in_every_image() -> None:
    """The same light as from the shape in one, whose instances have the same numbers."""
    whole = load_scene("tilted-wall", SMALL | {"target.0.shape": shape_of("wreck", 5), "target.0.material.albedo": 0.6})
    parts = load_scene(wreck(), {"target.0.material.albedo": 0.6})
    one, two = (generate(scene, seed=1, truth_electrons=True, truth_instances=True) for scene in (whole, parts))
    assert np.array_equal(one["truth_instance"].values, two["truth_instance"].values)
    assert np.array_equal(one["truth_range"].values, two["truth_range"].values, equal_nan=True)
    assert np.allclose(one["truth_electrons"].values, two["truth_electrons"].values, rtol=1e-5)


@pytest.mark.parametrize(
    ("name", "rung", "changes", "scattered"),
    [
        ("step", "direct", SMALL, False),
        ("harbour-wall", "scatter", SMALL | {"rig.camera.pixel_pitch_m": 5e-5}, True),
        ("line-step", "direct", {"rig.camera.rows": 24}, False),
        ("seafloor-down", "scatter", {"rig.camera.rows": 24, "rig.frames.lit": 1}, True),
    ],
)
def test_the_parts_sum_to_the_expectation(name: str, rung: Any, changes: dict[str, Any], scattered: bool) -> None:
    scene = load_scene(name, changes)
    kept = generate(scene, seed=2, fidelity=rung, truth_electrons=True, truth_components=True)
    plain = generate(scene, seed=2, fidelity=rung)
    found = {part: kept[f"truth_{part}"] for part in ("direct", "scattered", "ambient") if f"truth_{part}" in kept}
    total = sum(part.astype(float) for part in found.values())
    whole = kept["truth_electrons"]
    assert np.abs(total - whole).max() < 1e-5 * whole.max()  # float32
    assert found["direct"].min() > -1e-5 * whole.max()
    data = "counts"
    assert np.array_equal(kept[data].values, plain[data].values) and "truth_direct" not in plain
    assert (float(found["scattered"].sum()) > 0.0 if "scattered" in found else False) == scattered


def test_unscattered_light_is_that_of_the_same_scene_without_scattering_back() -> None:
    """e^{−2cr}: the scatter rung's direct part in water is the direct rung's in water of the same attenuation."""
    scene = load_scene("harbour-wall", SMALL | {"rig.camera.pixel_pitch_m": 5e-5})
    scatter, direct = (
        generate(scene, seed=2, fidelity=rung, truth_components=True)["truth_direct"].values.sum(axis=0)
        for rung in ("scatter", "direct")
    )
    assert np.allclose(scatter, direct, rtol=2e-3)


def test_the_command_stores_and_repeats_them(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out = tmp_path / "s.zarr"
    small = [word for path, value in SMALL.items() for word in ("--set", f"{path}={value}")]
    asked = ["generate", "step", *small, "--truth-components", "--truth-instances", "-o", str(out)]
    assert cli.main(asked) == 0
    capture = beambench.captures.open_captures(out)[0]
    assert {"truth_direct", "truth_ambient", "truth_instance"} <= set(capture.variables)
    assert json.loads(capture.attrs["provenance"])["arguments"]["truth_instances"] is True
    assert cli.main(["generate", "--like", str(out)]) == 0
    assert cli.main(["generate", "step", *small, "--resume", "-o", str(out)]) == 2
    assert "truth_components" in capsys.readouterr().err
