"""`beambench estimators train`: weights from a data set on disk, with equal bytes each time, used as a parameter."""

from __future__ import annotations

import importlib.util
from pathlib import Path

import numpy as np
import pytest

import beambench
from beambench import cli
from beambench.benchmarks.suites.suite import load_suite
from beambench.estimators import run_estimator
from beambench.estimators.gated.tools import layer
from beambench.estimators.gated.train import fit
from beambench.scenes.errors import InputError

SIZE = {"rig.camera.rows": 40, "rig.camera.cols": 40}


@pytest.fixture(scope="module")
def data(tmp_path_factory: pytest.TempPathFactory) -> Path:
    if importlib.util.find_spec("mitsuba") is None:
        pytest.skip("Mitsuba is not installed")
    folder = tmp_path_factory.mktemp("training")
    for name, energy in (("a-dim", 5e-7), ("b-bright", 5e-6)):
        changes = SIZE | {"rig.laser.pulse_energy_j": energy}
        beambench.generate("flat-wall", overrides=changes, seeds=[1], out=folder / f"{name}.zarr")
    return folder


def test_equal_data_give_equal_bytes_and_weights_that_work(data: Path, tmp_path: Path) -> None:
    found = beambench.estimators_train(data, out=tmp_path / "one.npz", units=16)
    beambench.estimators_train([data / "a-dim.zarr", data / "b-bright.zarr"], out=tmp_path / "two.npz", units=16)
    assert (tmp_path / "one.npz").read_bytes() == (tmp_path / "two.npz").read_bytes()
    assert found["captures"] == 2 and found["pixels"] > 3000 and found["bytes"] < 20_000
    assert found["rms_held_out"] < 1.05 * found["rms_first_guess"]
    with np.load(tmp_path / "one.npz", allow_pickle=False) as weights:
        assert str(weights["trained_on"]) == "a-dim 1; b-bright 1"
    capture = beambench.captures.open_captures(data / "b-bright.zarr")[0]
    result = run_estimator(f"learned[weights={tmp_path / 'one.npz'}]", capture)
    error = (result["range"] - capture["truth_range"]).values[result["valid"].values]
    # Some 2,000 photoelectrons a pixel: the bound is 2 mm.
    assert result["valid"].values.mean() > 0.99 and np.sqrt(np.mean(error**2)) < 0.006


def test_the_command(data: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out = tmp_path / "w.npz"
    arguments = ["estimators", "train", "--data", str(data), "--out", str(out), "--units", "8"]
    assert cli.main(arguments) == 0
    assert "captures" in capsys.readouterr().out and out.is_file()
    assert cli.main(arguments) == 2  # never over an existing file
    assert cli.main([*arguments, "--overwrite", "--seed", "2"]) == 0


def test_progress_tells_captures_then_pixels(data: Path, tmp_path: Path) -> None:
    told: list[tuple[str, int, int, str]] = []
    found = beambench.estimators_train(data, out=tmp_path / "w.npz", units=8, progress=lambda *step: told.append(step))
    assert [step for step in told if step[0] == "read"] == [
        ("read", 0, 2, "a-dim"), ("read", 1, 2, "b-bright"), ("read", 2, 2, ""),
    ]  # fmt: skip
    fits = [step for step in told if step[0] == "fit"]
    assert told[3:] == fits and fits[0][1] == 0 and fits[-1][1] == fits[-1][2] > 0.8 * found["pixels"]


def test_the_sums_of_blocks_are_the_products_of_all_pixels() -> None:
    rng = np.random.default_rng(1)
    features, targets = rng.normal(size=(2 * layer.BLOCK + 77, 3)), rng.normal(size=2 * layer.BLOCK + 77)
    centre, scale, hidden, bias = rng.normal(size=3), rng.uniform(1, 2, 3), rng.normal(size=(5, 3)), rng.normal(size=5)
    steps: list[int] = []
    products, right = layer.normal_sums(features, targets, (centre, scale, hidden, bias), steps.append)
    f = (features - centre) * scale
    x = np.concatenate([np.ones((len(f), 1)), f, np.tanh(f @ hidden.T + bias)], axis=1)
    np.testing.assert_allclose(products, x.T @ x, rtol=1e-10, atol=1e-8)
    np.testing.assert_allclose(right, x.T @ targets, rtol=1e-10, atol=1e-8)
    assert steps == [layer.BLOCK, 2 * layer.BLOCK, 2 * layer.BLOCK + 77]


def test_training_ends_between_two_blocks() -> None:
    """A signal is heard where Python goes on: no call takes all pixels at once."""
    rng, steps = np.random.default_rng(1), []
    count = 8 * layer.BLOCK
    features, answers = rng.uniform(1.0, 2.0, (count, 24)), rng.normal(size=count) * 0.1

    def tell(stage: str, done: int, total: int, text: str) -> None:
        steps.append(done)
        if done >= 2 * layer.BLOCK:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        fit(features, answers, np.ones(count), units=8, ridge=1e-5, seed=1, tell=tell)
    assert steps == [0, layer.BLOCK, 2 * layer.BLOCK]


def test_data_that_cannot_be_used_are_told(data: Path, tmp_path: Path) -> None:
    with pytest.raises(InputError, match="no captures"):
        beambench.estimators_train(tmp_path, out=tmp_path / "w.npz")
    with pytest.raises(InputError, match="too few pixels"):
        beambench.estimators_train(data, out=tmp_path / "w.npz", units=2000)
    with pytest.raises(InputError, match="out of range"):
        beambench.estimators_train(data, out=tmp_path / "w.npz", units=0)


def test_training_and_test_share_no_shape_and_no_seed() -> None:
    training, unseen = load_suite("learned-training"), load_suite("learned-scatter")
    shapes = {item.shape.kind for _, scene in training.scenes for item in scene.target}
    assert shapes == {"rectangle", "sphere"}
    assert all(scene.target[0].shape.kind == "height-grid" for _, scene in unseen.scenes)
    assert not set(training.suite.seeds.test) & set(unseen.suite.seeds.test)


@pytest.mark.parametrize(
    "bad", [{"seed": -1}, {"seed": 1.5}, {"ridge": float("nan")}, {"ridge": float("inf")}, {"units": 0}, {"units": 2.0}]
)
def test_bad_parameters_are_told_before_data_are_read(tmp_path: Path, bad: dict[str, float]) -> None:
    with pytest.raises(InputError, match="out of range") as told:
        beambench.estimators_train(tmp_path / "nowhere", out=tmp_path / "w.npz", **bad)  # type: ignore[arg-type]
    assert told.value.where == f"--{next(iter(bad))}" and told.value.allowed


def test_weights_that_cannot_be_written_leave_the_old_ones(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    from beambench.estimators.gated import train

    out = tmp_path / "w.npz"
    out.write_bytes(b"old")

    def full(fd: int) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(train.os, "fsync", full)
    with pytest.raises(InputError, match="cannot be written"):
        train._write(out, {"a": np.zeros(3)})
    assert out.read_bytes() == b"old" and [path.name for path in tmp_path.iterdir()] == ["w.npz"]


def test_data_of_another_kind_are_told(tmp_path: Path) -> None:
    for data in (5, [], [7], None):
        with pytest.raises(InputError, match="paths"):
            beambench.estimators_train(data, out=tmp_path / "w.npz")  # type: ignore[arg-type]
