"""Estimates of a program that states no errors are scored; what is mistyped is named."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest

import beambench
from beambench.benchmarks.laws.gated import clean_capture
from beambench.captures import write
from beambench.captures.hide import hide_truth
from beambench.estimators import get_estimator
from beambench.scenes.errors import InputError

pytestmark = pytest.mark.filterwarnings("ignore:.*captures_sha256")


@pytest.fixture
def answers(tmp_path: Path) -> Path:
    capture = clean_capture()
    write(tmp_path / "made.zarr", capture)
    found = get_estimator("parabola").function(hide_truth(capture))
    with h5py.File(tmp_path / "own.h5", "w") as file:
        for name in ("range", "sigma", "valid"):
            file[name] = found[name].values[None]
    return tmp_path


def _score(folder: Path, name: str = "own.h5") -> dict[str, Any]:
    table = beambench.score(folder / "made.zarr", folder / name, out=folder / "scores", overwrite=True)
    return dict(table.iloc[0])


def test_without_sigma_only_what_needs_it_is_empty(answers: Path) -> None:
    stated = _score(answers)
    with h5py.File(answers / "own.h5", "a") as file:
        del file["sigma"]
    row = _score(answers)
    assert row["status"] == "ok" and stated["z_rms"] > 0 and stated["cover95"] > 0
    assert {name for name in row if row[name] != row[name] and stated[name] == stated[name]} == {"z_rms", "cover95"}
    assert all(
        row[name] == stated[name] for name in ("rmse", "rmse_full", "bias", "coverage", "efficiency", "failure_rate")
    )
    with h5py.File(answers / "own.h5", "a") as file:
        file["range"][0, 0, 0] = np.inf
    assert str(_score(answers)["status"]).startswith("invalid: range is not finite at 1 elements")


def test_what_is_mistyped_is_named(answers: Path) -> None:
    with pytest.raises(
        InputError, match=r"no such file or folder of estimates(.|\n)*own\.h(.|\n)*did you mean .*own\.h5\?"
    ):
        _score(answers, "own.h")
    with h5py.File(answers / "own.h5", "a") as file:
        file.move("range", "ranges")
    with pytest.raises(
        InputError, match=r"hold no `range`(.|\n)*ranges, sigma, valid(.|\n)*rename `ranges` to `range`"
    ):
        _score(answers)


def test_exchanged_axes_are_told(answers: Path) -> None:
    with h5py.File(answers / "own.h5", "a") as file:
        turned = file["range"][:].swapaxes(1, 2)
        del file["range"]
        file["range"] = turned
    with pytest.raises(InputError, match="rows and columns are exchanged"):
        _score(answers)
