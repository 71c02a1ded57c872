"""The example of a trained estimator, docs/training-project: its gradient, a short training, its answers, and that it is safe."""

from __future__ import annotations

import importlib.util
import os
import sys
from collections.abc import Iterator
from itertools import pairwise
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
import pytest

import beambench
from beambench.benchmarks.laws.gated import clean_capture
from beambench.captures.hide import hide_truth
from beambench.captures.layouts import stage_of
from beambench.estimators.result import check_result
from beambench.generator.generate import generate
from beambench.scenes.errors import InputError
from beambench.scenes.load import load_scene

SMALL = {
    "rig.camera.rows": 24,
    "rig.camera.cols": 24,
    "rig.delays.count": 32,
    "rig.delays.step_s": 1.0e-9,
    "rig.delays.start_s": 2.0e-8,
}


def _loaded(folder: Path, name: str) -> ModuleType:
    package = folder / name / "__init__.py"
    spec = importlib.util.spec_from_file_location(name, package if package.is_file() else folder / f"{name}.py")
    assert spec is not None and spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    sys.modules[name] = module
    spec.loader.exec_module(module)
    return module


@pytest.fixture(scope="module")
def modules() -> Iterator[tuple[Any, Any]]:
    folder = Path(__file__).parents[1] / "docs" / "training-project"
    net, train = _loaded(folder, "gated_net"), _loaded(folder, "train_gated_net")
    yield net, train
    del sys.modules["gated_net"], sys.modules["train_gated_net"]


def test_the_gradient_is_that_of_the_loss(modules: tuple[Any, Any]) -> None:
    """Central differences of every kind of weight, to 1e-5; samples on both sides of the bend at three standard errors."""
    net, train = modules
    rng = np.random.default_rng(3)
    sizes = (net.FEATURES, 5, 4, 2)
    weights = {f"w{i}": 0.3 * rng.standard_normal((a, b)) for i, (a, b) in enumerate(pairwise(sizes))}
    weights |= {f"b{i}": 0.1 * rng.standard_normal(b) for i, b in enumerate(sizes[1:])}
    f, true = rng.standard_normal((40, net.FEATURES)), 2.0 * rng.standard_normal(40)
    _, slopes = train.gradient(weights, f, true)
    for name, value in weights.items():
        at = tuple(0 for _ in value.shape)
        losses = []
        for step in (1e-5, -1e-5):
            moved = {k: v.copy() for k, v in weights.items()}
            moved[name][at] += step
            losses.append(train.gradient(moved, f, true)[0])
        assert (losses[0] - losses[1]) / 2e-5 == pytest.approx(slopes[name][at], rel=1e-4, abs=1e-7), name


def test_a_short_training_learns_and_its_weights_answer(
    modules: tuple[Any, Any], tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """Three tilted walls of 24 × 24, twelve epochs: better than the brightest slice, with an error that it states."""
    net, train = modules
    data = {
        "schema_version": 1, "dataset": "walls", "captures": 8, "seed": 2, "fidelity": "direct", "rtol": 0.1,
        "scenes": [{"scene": "tilted-wall", "overrides": SMALL}], "split": {"train": 0.5, "validation": 0.5, "test": 0.0},
        "parameters": {
            "tilt": {"kind": "uniform", "low": -40.0, "high": 40.0, "paths": ["target.0.shape.tilt_y_deg"]},
            "far": {"kind": "uniform", "low": 4.5, "high": 5.5, "paths": ["target.0.shape.center_m.2"]},
        },
    }  # fmt: skip
    store = tmp_path / "walls"
    beambench.generate(data, out=store, workers=1)
    out = tmp_path / "w.npz"
    monkeypatch.setattr(sys, "argv", ["train", str(store), "--out", str(out), "--epochs", "12", "--pixels", "300"])
    train.main()
    assert "steps rms" in capsys.readouterr().out
    capture = generate(load_scene("tilted-wall", SMALL | {"target.0.shape.tilt_y_deg": 25.0}), seed=9)
    answer = net.gated_net(hide_truth(capture), weights=str(out))
    check_result(answer, capture, "gated-net", stage_of("gated"))
    valid = answer["valid"].values & ~capture["truth_mixed"].values
    error = (answer["range"].values - capture["truth_range"].values)[valid]
    # A slice is .15 m: the brightest one alone errs by .15/√12 = 43 mm rms.
    assert valid.mean() > 0.2 and np.sqrt(np.mean(error**2)) < 0.03
    assert 0.4 < np.mean(np.abs(error) < answer["sigma"].values[valid]) < 0.95


def test_weights_that_cannot_be_used_are_told(modules: tuple[Any, Any], tmp_path: Path) -> None:
    """No file, no numbers, objects that would be run when loaded, and other shapes."""
    net, _ = modules
    names = (*net.LAYERS, "centre", "scale", "factor")
    np.savez(tmp_path / "pickled.npz", **{name: np.array([{}], dtype=object) for name in names})
    np.savez(tmp_path / "shape.npz", **{name: np.zeros(3) for name in names})
    (tmp_path / "text.npz").write_text("no")
    for name in ("missing.npz", "pickled.npz", "text.npz", "shape.npz"):
        with pytest.raises(InputError, match="weights of gated-net"):
            net.read_weights(str(tmp_path / name))


def test_the_shipped_weights_answer_what_the_laws_ask(modules: tuple[Any, Any]) -> None:
    """Of the bright capture of `beambench estimators check`: weights of one instrument alone answered none of its pixels."""
    net, _ = modules
    capture = clean_capture()
    answer = net.gated_net(hide_truth(capture))
    error = answer["range"].values - capture["truth_range"].values
    sigma = answer["sigma"].values
    assert answer["valid"].values.mean() >= 0.99 and np.sqrt(np.mean(error**2)) < 0.002
    assert 0.3 < np.sqrt(np.mean((error / sigma) ** 2)) < 3.0


def test_the_shipped_weights_answer(modules: tuple[Any, Any]) -> None:
    """On a seabed that was not drawn for them."""
    net, _ = modules
    scene = load_scene(
        "rocky-seabed",
        {
            "rig.camera.rows": 24,
            "rig.camera.cols": 24,
            "rig.camera.pixel_pitch_m": 6e-5,
            "rig.laser.pulse_energy_j": 2e-4,
        },
    )
    capture = generate(scene, seed=5)
    answer = net.gated_net(hide_truth(capture))
    use = answer["valid"].values & ~capture["truth_mixed"].values
    error = (answer["range"].values - capture["truth_range"].values)[use]
    assert answer["valid"].values.mean() > 0.5 and np.median(np.abs(error)) < 0.02


def test_what_is_installed_holds_its_weights(tmp_path: Path) -> None:
    """A plain installation lacked them, and an editable one kept them where the jail of a run does not read."""
    import shutil
    import zipfile

    from setuptools import build_meta

    project = shutil.copytree(Path(__file__).parents[1] / "docs" / "training-project", tmp_path / "project")
    before = Path.cwd()
    os.chdir(project)
    try:
        name = build_meta.build_wheel(str(tmp_path))
    finally:
        os.chdir(before)
    assert {"gated_net/__init__.py", "gated_net/gated_net.npz"} <= set(zipfile.ZipFile(tmp_path / name).namelist())
