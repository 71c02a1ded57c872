"""Answers in another unit, or with rows and columns exchanged, are hinted at by `score`, `run` and `estimators check`."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest
import xarray as xr

import beambench
from beambench.benchmarks.laws.check import check_laws, maker_of
from beambench.benchmarks.laws.gated import clean_capture
from beambench.benchmarks.scores.slips import slip_warnings, slips_of
from beambench.benchmarks.scores.truth import Truth
from beambench.captures import write
from beambench.captures.layouts import stage_of, stages
from beambench.estimators import get_estimator

UNIT_AND_ORDER = "answers are in the unit and order of the stage"
RANGE = stage_of("gated")
SLOPE = next(one for one in stages().values() if one.gives[0].name == "slope" and "axis" in one.gives[0].dims)


def _in_mm(result: xr.Dataset) -> xr.Dataset:
    return result.assign({"range": 1e3 * result["range"], "sigma": 1e3 * result["sigma"]})


def _exchanged(result: xr.Dataset) -> xr.Dataset:
    """In the right shape, in the order of a language whose first index runs fastest."""
    return result.map(lambda one: one.copy(data=one.values.T.reshape(one.shape)))


def _rows(
    stage: Any, quantity: str, value: np.ndarray, truth: np.ndarray, valid: np.ndarray | None = None
) -> list[str]:
    names = stage.variables(stage.gives[0])
    shape = value.shape[: len(stage.gives[0].element_dims)]
    arrays = {
        names.value: value,
        names.sigma: np.ones(value.shape),
        names.valid: np.ones(shape, bool) if valid is None else valid,
    }
    found = slips_of(stage, arrays, {quantity: Truth.plain(truth)})
    return slip_warnings([row | {"estimator": "own", "params": ""} for row in found])


@pytest.mark.parametrize(
    ("change", "seen"), [(_in_mm, "in mm in place of m"), (_exchanged, "rows and columns exchanged")]
)
def test_check_does_not_call_a_slip_ok(change: Any, seen: str) -> None:
    function = get_estimator("parabola").function
    broken = {
        one.law: one.seen for one in check_laws(lambda capture: change(function(capture)), "gated") if not one.holds
    }
    assert seen in broken[UNIT_AND_ORDER]
    assert all(one.holds for one in check_laws(function, "gated") if one.law == UNIT_AND_ORDER)


@pytest.mark.parametrize(
    ("shape", "factor", "seen"),
    [
        ((8, 8), 1e3, "in mm in place of m"),
        ((6, 10), 1e2, "in cm in place of m"),
        ((6, 10), 1.0, ""),
        ((6, 10), 30.0, ""),
    ],
)
def test_a_factor_is_a_unit_or_no_slip(shape: tuple[int, int], factor: float, seen: str) -> None:
    rng = np.random.default_rng(1)
    truth = rng.uniform(3, 5, shape)
    told = _rows(RANGE, "range", factor * (truth + rng.normal(0, 0.01, shape)), truth)
    assert len(told) == bool(seen) and all(seen in line for line in told)


def test_what_is_wild_hides_no_slip_and_a_bad_method_is_none() -> None:
    rng = np.random.default_rng(2)
    truth = rng.uniform(3, 5, (12, 12))
    wild = truth * 1e3
    wild[::5] = 1e12
    assert "in mm" in _rows(RANGE, "range", wild, truth)[0]
    assert _rows(RANGE, "range", rng.uniform(0, 10, truth.shape), truth) == []
    assert _rows(RANGE, "range", np.full(truth.shape, 4.0), truth) == []
    assert _rows(RANGE, "range", truth * 1e3, truth, np.zeros(truth.shape, bool)) == []
    assert _rows(RANGE, "range", truth[:3, :3] * 1e3, truth[:3, :3]) == [], "nine elements say too little"


def test_components_exchanged() -> None:
    truth = np.random.default_rng(3).normal(0, 1e-5, (2, 40, 2))
    assert "components along rows and columns exchanged" in _rows(SLOPE, "slope", truth[..., ::-1], truth)[0]
    assert "in mrad in place of rad" in _rows(SLOPE, "slope", 1e3 * truth, truth)[0]


def _file(path: Path, result: xr.Dataset, factor: float = 1.0) -> Path:
    with h5py.File(path, "w") as file:
        file["range"], file["sigma"] = factor * result["range"].values[None], factor * result["sigma"].values[None]
        file["valid"] = result["valid"].values[None]
    return path


def test_score_warns_and_scores_the_answer_as_it_stands(tmp_path: Path) -> None:
    maker = maker_of("gated")
    write(tmp_path / "made.zarr", clean_capture())
    found = get_estimator("parabola").function(maker.clean())
    with pytest.warns(UserWarning, match="own: the range seems to be given in mm in place of m"):
        table = beambench.score(tmp_path / "made.zarr", _file(tmp_path / "own.h5", found, 1e3), out=tmp_path / "mm")
    assert table["rmse"][0] > 1e3
    with pytest.warns(UserWarning, match="rows and columns exchanged"):
        beambench.score(
            tmp_path / "made.zarr", _file(tmp_path / "turned.h5", _exchanged(found)), out=tmp_path / "turned"
        )
