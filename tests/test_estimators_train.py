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
