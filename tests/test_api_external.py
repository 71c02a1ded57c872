"""Estimates of programs in other languages: their input, and the scores of files as MATLAB and C++ write them."""

from __future__ import annotations

import importlib.util
import json
import math
from pathlib import Path

import h5py
import numpy as np
import pandas as pd
import pytest

import beambench
from beambench import cli
from beambench.optics.constants import C_M_PER_S

ROWS, COLS = 10, 14


@pytest.fixture(scope="module")
def store(tmp_path_factory: pytest.TempPathFactory) -> Path:
    if importlib.util.find_spec("mitsuba") is None:  # importing it here would let it find a libLLVM of its own
        pytest.skip("Mitsuba is not installed")
    path = tmp_path_factory.mktemp("data") / "wall.zarr"
    size = {"rig.camera.rows": ROWS, "rig.camera.cols": COLS, "rig.pulses_per_slice": 1000}
    beambench.generate("flat-wall", overrides=size, seeds=[1, 2, 3], out=path)
    return path


@pytest.fixture(scope="module")
def exported(store: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    return beambench.export(store, out=tmp_path_factory.mktemp("export") / "captures.h5")


def half_rise(path: Path) -> np.ndarray:
    """A program of one's own: the centre of the brightest slices, from the exported file and nothing else."""
    with h5py.File(path) as file:
        counts, delay = file["counts"][:].astype(float), file["delay"][:]
        rig = json.loads(file["rig"][0])
    signal = np.clip(counts - np.median(counts, axis=1, keepdims=True), 0, None) ** 2
    time = (signal * delay[:, :, None, None]).sum(axis=1) / signal.sum(axis=1)
    gate = rig["gates"][0]
    weight = np.asarray(gate["value"])
    centre = gate["start_s"] + gate["step_s"] * float((np.arange(weight.size) * weight).sum() / weight.sum())
    # Slice k sees R(τ − t_k), which is centred where the echo meets the middle of the gate.
    found: np.ndarray = C_M_PER_S / (2 * rig["medium"]["group_index"]) * (time + centre)
    return found


def test_the_export_holds_no_truth(exported: Path, store: Path) -> None:
    with h5py.File(exported) as file:
        names = set(file)
        assert {"counts", "delay", "gate", "laser_on", "valid", "rig"} <= names
        assert not any("truth" in name for name in names | set(file.attrs)) and "seed" not in file.attrs
        assert file["counts"].shape[0] == 3 and file["counts"].shape[2:] == (ROWS, COLS)
        assert file["counts"].attrs["dims"] == "capture slice row col" and file["delay"].attrs["units"] == "s"
        text = exported.read_bytes()
        assert b"truth_" not in text
        captures = beambench.captures.open_captures(store)
        for index, capture in enumerate(captures):
            assert (file["counts"][index] == capture["counts"].values).all()
            assert json.loads(file["rig"][index]) == json.loads(capture.attrs["rig"])


def _score(store: Path, path: Path, out: Path) -> pd.DataFrame:
    table = beambench.score(store, path, out=out)
    unmixed: pd.DataFrame = table[table["quantity"] == "range"].reset_index(drop=True)
    assert len(unmixed) == 3
    return unmixed


def test_matlab_cpp_and_python_files_score_alike(store: Path, exported: Path, tmp_path: Path) -> None:
    """The same answers, written with the types, axes and strings that each language leaves."""
    found = half_rise(exported)
    sigma = np.full(found.shape, 0.01)
    with h5py.File(tmp_path / "python.h5", "w") as file:
        file["range"], file["sigma"], file["valid"] = found, sigma, np.ones(found.shape, bool)
    with h5py.File(tmp_path / "matlab.h5", "w") as file:
        # h5write of (col, row, capture) arrays: HDF5 sees the axes reversed. All double; vectors are rows; text an array.
        fortran = np.asfortranarray(found.T)
        file["range"], file["sigma"] = np.ascontiguousarray(fortran.T), sigma
        file["valid"] = np.ones(found.shape, np.float64)
        file["wall_s"] = np.full((1, 3), 0.5)
        file.attrs["estimator"] = np.array([b"matlab-method"])
        file.attrs["schema_version"] = np.array([[1.0]])
    with h5py.File(tmp_path / "cpp.h5", "w") as file:
        # The C interface: explicit types, a fixed-length string, chunks and compression of its own choice.
        for name, data, kind in (("range", found, "<f8"), ("sigma", sigma, "<f4"), ("valid", found > 0, "u1")):
            file.create_dataset(name, data=np.asarray(data, kind), chunks=(1, 5, 7), compression="gzip", shuffle=True)
        file.attrs.create("estimator", np.bytes_(b"cpp-method[k=2]"), dtype="S15")
        file["status"] = np.array([b"ok"] * 3, "S2")
    tables = {name: _score(store, tmp_path / f"{name}.h5", tmp_path / name) for name in ("python", "matlab", "cpp")}
    for name, label, params in (
        ("python", "python", ""),
        ("matlab", "matlab-method", ""),
        ("cpp", "cpp-method", "k=2"),
    ):
        table = tables[name]
        assert set(table["estimator"]) == {label} and (table["params"].fillna("") == params).all()
        assert (table["status"] == "ok").all() and (table["coverage"] == 1.0).all()
        for column in ("rmse", "bias", "failure_rate", "bound"):
            assert table[column].tolist() == tables["python"][column].tolist()
    assert (tables["matlab"]["wall_s"] == 0.5).all() and tables["python"]["wall_s"].isna().all()
    # The one-line estimator is sound: within the response's half width everywhere (its bias is a step's fraction).
    assert (tables["python"]["failure_rate"] == 0).all() and (tables["python"]["rmse"] < 0.03).all()


def test_a_folder_of_files_makes_one_table(store: Path, exported: Path, tmp_path: Path) -> None:
    found = half_rise(exported)
    (tmp_path / "made").mkdir()
    for name, offset in (("first", 0.0), ("second", 0.1)):
        with h5py.File(tmp_path / "made" / f"{name}.h5", "w") as file:
            file["range"], file["sigma"] = found + offset, np.full(found.shape, 0.01)
            file["valid"] = np.ones(found.shape, "u1")
    table = beambench.score(store, tmp_path / "made", out=tmp_path / "scores")
    bias = table[table["quantity"] == "range"].groupby("estimator")["bias"].mean()
    assert bias["second"] - bias["first"] == pytest.approx(0.1, abs=1e-9)


def test_a_capture_without_an_answer_is_a_failure(store: Path, exported: Path, tmp_path: Path) -> None:
    found = half_rise(exported)
    with h5py.File(tmp_path / "partial.h5", "w") as file:
        file["range"], file["sigma"] = found, np.full(found.shape, 0.01)
        file["valid"] = np.ones(found.shape, "u1")
        file["status"] = np.array([b"ok", b"licence lost", b"ok"])
    table = _score(store, tmp_path / "partial.h5", tmp_path / "scores")
    assert table["status"].tolist() == ["ok", "licence lost", "ok"]
    assert table["coverage"].tolist() == [1.0, 0.0, 1.0] and table["failure_rate"].tolist() == [0.0, 1.0, 0.0]


@pytest.mark.parametrize("fault", ["valid", "status", "axes"])
def test_what_does_not_fit_is_told(store: Path, tmp_path: Path, fault: str) -> None:
    shape = (ROWS, COLS, 3) if fault == "axes" else (3, ROWS, COLS)
    with h5py.File(tmp_path / "bad.h5", "w") as file:
        file["range"], file["sigma"] = np.ones(shape), np.ones(shape)
        file["valid"] = np.full(shape, math.nan if fault == "valid" else 1.0)
        if fault == "status":
            file["status"] = np.array([b"ok"])
    told = {"valid": "values other than 0 and 1", "status": "do not fit", "axes": "do not fit"}[fault]
    with pytest.raises(beambench.InputError, match=told):
        beambench.score(store, tmp_path / "bad.h5", out=tmp_path / "scores")


def test_export_replaces_only_its_own(
    store: Path, exported: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert cli.main(["export", str(store), "-o", str(exported)]) == 2
    assert cli.main(["export", str(store), "-o", str(exported), "--overwrite", "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["out"] == str(exported)
    note = tmp_path / "note.h5"
    note.write_text("mine")
    with pytest.raises(beambench.InputError, match="not replaced"):
        beambench.export(store, out=note, overwrite=True)
    assert note.read_text() == "mine"
