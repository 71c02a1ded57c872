"""Labels with a file hold its absolute path, wherever the estimator runs; a missing file is refused at once."""

from __future__ import annotations

from pathlib import Path

import pytest

import beambench
from beambench.benchmarks.runner.estimator_labels import check_estimators
from beambench.scenes.errors import InputError


def test_a_file_is_found_beside_the_suite_then_in_the_working_folder(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    here, suite = tmp_path / "here", tmp_path / "suite"
    for folder in (here, suite):
        folder.mkdir()
    (here / "w.npz").touch()
    monkeypatch.chdir(here)
    (chosen,) = check_estimators(["learned[min_snr=5.0,weights=w.npz]"])
    assert chosen.label == f"learned[min_snr=5.0,weights={here / 'w.npz'}]"
    (suite / "w.npz").touch()
    (chosen,) = check_estimators(["learned[weights=w.npz]"], beside=suite / "mine.toml")
    assert chosen.params == f"weights={suite / 'w.npz'}"
    (again,) = check_estimators([chosen.label])
    assert again == chosen
    with pytest.raises(InputError, match="twice"):
        check_estimators(["learned[weights=w.npz]", f"learned[weights={here}/../here/w.npz]"])


def test_a_missing_file_is_refused_before_anything_runs(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    with pytest.raises(InputError, match="no such file") as told:
        check_estimators(["learned[weights=w.npz]"])
    assert told.value.where == "learned[weights]" and str(tmp_path) in told.value.allowed
    assert "estimators train" in told.value.next_step
    (tmp_path / "a,b").mkdir()
    (tmp_path / "a,b" / "w.npz").touch()
    monkeypatch.chdir(tmp_path / "a,b")
    with pytest.raises(InputError, match="cannot stand in a label"):
        check_estimators(["learned[weights=w.npz]"])


def test_one_label_in_place_of_a_list_is_told(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="list"):
        check_estimators("peak")
    with pytest.raises(InputError, match="list"):
        beambench.estimate(tmp_path, "peak", out=tmp_path / "e")
