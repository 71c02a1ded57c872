"""A scene whose rig is declared otherwise than it is, is scored under the condition "declared", with what differs."""

from __future__ import annotations

from pathlib import Path

import h5py
import pytest

import beambench
from beambench.benchmarks.laws.gated import clean_capture
from beambench.benchmarks.suites.declared import declared_note, differences, told_condition
from beambench.captures import write
from beambench.captures.hide import hide_truth
from beambench.estimators import get_estimator
from beambench.scenes.load import load_scene


def test_what_differs_is_listed_and_equal_values_do_not_differ() -> None:
    plain = load_scene("flat-wall")
    wrong = load_scene("flat-wall", {"declared": {"t0_s": 2e-11}})
    same = load_scene("flat-wall", {"declared": {"t0_s": plain.rig.t0_s}})
    assert differences(plain) == differences(same) == [] and declared_note(same) == ""
    assert differences(wrong)[0] == f"t0_s 2e-11, truly {plain.rig.t0_s}"
    assert [told_condition("matched", scene) for scene in (plain, same, wrong)] == ["matched", "matched", "declared"]
    assert told_condition("calibrated", wrong) == "calibrated"


def test_calibration_starts_from_a_declared_rig() -> None:
    assert "camera.focal_length_m 0.0081, truly" in declared_note(load_scene("calibration-air"))


@pytest.mark.parametrize("wrong", [False, True])
def test_score_names_the_condition(tmp_path: Path, wrong: bool) -> None:
    capture = clean_capture()
    if wrong:
        scene = load_scene(
            beambench.scenes.scene.Scene.model_validate_json(capture.attrs["truth_scene"]).model_dump(mode="json")
        )
        scene = scene.model_copy(update={"declared": {"t0_s": 2e-11}})
        capture = capture.assign_attrs(truth_scene=scene.model_dump_json())
    write(tmp_path / "made.zarr", capture)
    found = get_estimator("parabola").function(hide_truth(capture))
    with h5py.File(tmp_path / "own.h5", "w") as file:
        for name in ("range", "sigma", "valid"):
            file[name] = found[name].values[None]
    with pytest.warns(UserWarning) as told:
        table = beambench.score(tmp_path / "made.zarr", tmp_path / "own.h5", out=tmp_path / "scores")
    assert set(table["condition"]) == {"declared" if wrong else "matched"}
    assert any("t0_s 2e-11, truly 0" in str(one.message) for one in told) is wrong
