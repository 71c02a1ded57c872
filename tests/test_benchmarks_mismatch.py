"""The condition "mismatched": what is declared wrongly moves estimates by closed forms, and nothing else changes."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

import beambench
from beambench import InputError
from beambench.benchmarks.checks.mismatch import losses
from beambench.benchmarks.judges.mismatch import wrongly_declared
from beambench.benchmarks.runner.protocol import content_id, file_sums, write_capture, write_meta
from beambench.benchmarks.runner.sealed import block, unpack
from beambench.benchmarks.scores.tables import read_scores
from beambench.benchmarks.suites.mismatch import ERRORS, applies, mismatched
from beambench.benchmarks.suites.suite import load_suite
from beambench.captures.hide import hide_truth
from beambench.generator.generate import generate
from beambench.scenes.declared import declared_rig
from beambench.scenes.load import load_scene

C = 299792458.0
SMALL = {"rig.camera.rows": 8, "rig.camera.cols": 8, "rig.laser.illumination.half_angle_rad": 0.09}
SUITE = {
    "schema_version": 1, "suite": "small", "conditions": ["matched", "mismatched"], "mismatch": {"t0": 2e-11, "baseline": 1e-3},
    "estimators": ["poisson-ml"], "seeds": {"test": [1, 2]}, "scenes": [{"scene": "flat-wall", "overrides": SMALL}],
}  # fmt: skip


def test_a_wrong_zero_of_time_shifts_ranges_by_half_the_way_of_light() -> None:
    """c/2n a second: a delay that is declared 20 ps too late makes ranges 3 mm too long, in every estimator of ranges."""
    row = next(row for row in losses(load_suite(SUITE)) if row.error == "t0")
    n_g = json.loads(generate(load_scene("flat-wall", SMALL), seed=1).attrs["rig"])["medium"]["group_index"]
    assert row.shift == pytest.approx(C / (2 * n_g), rel=1e-3)
    assert row.unit == "m" and row.error_unit == "s"


def test_what_does_not_apply_is_left_out() -> None:
    scene = load_scene("flat-wall", SMALL)
    assert [name for name in ERRORS if applies(name, scene)] == ["t0", "index", "pulse-width", "gate-width"]
    assert applies("baseline", load_scene("spotscan-wall"))
    assert applies("pitch", load_scene("gated-turbulence"))
    with pytest.raises(InputError, match="applies"):
        mismatched(scene, {"pitch": 0.01})


def test_only_the_declared_rig_and_its_clock_differ() -> None:
    scene = load_scene("flat-wall", SMALL)
    hidden = hide_truth(generate(scene, seed=1))
    wrong = wrongly_declared(scene, {"t0": 2e-11, "pulse-width": 0.05}, hidden)
    assert np.allclose(wrong["delay"].values - hidden["delay"].values, 2e-11, rtol=1e-6)
    assert np.array_equal(wrong["counts"].values, hidden["counts"].values)
    right, other = (json.loads(one.attrs["rig"]) for one in (hidden, wrong))
    assert [key for key in right if right[key] != other[key]] == ["pulse", "t0_s"]


def test_each_condition_gets_its_own_coordinates(tmp_path: Path) -> None:
    scene = load_scene("flat-wall", SMALL)
    hidden = hide_truth(generate(scene, seed=1))
    wrong = wrongly_declared(scene, {"t0": 2e-11}, hidden)
    write_capture(tmp_path / "a", hidden)
    write_meta(tmp_path / "a", hidden, "matched", hidden)
    write_meta(tmp_path / "a", wrong, "mismatched", hidden)
    for name, capture in (("matched", hidden), ("mismatched", wrong)):
        assert np.array_equal(unpack(block(tmp_path / "a", name))["delay"].values, capture["delay"].values)
    sums = file_sums(tmp_path / "a")
    assert content_id(sums, "matched") != content_id(sums, "mismatched")
    del sums["delay@mismatched.npy"]
    assert content_id(sums, "matched") == content_id(file_sums(tmp_path / "a"), "matched")


def test_a_run_scores_both_conditions(tmp_path: Path) -> None:
    """On the same captures: the mismatched reading is worse by 3 mm of bias, with the same bound."""
    folder = beambench.run(SUITE, out=tmp_path / "run", report=False)
    table = read_scores(Path(getattr(folder, "out", folder)))
    rows = table.set_index(["condition", "seed"]).sort_index()
    for seed in (1, 2):
        right, wrong = rows.loc[("matched", seed)], rows.loc[("mismatched", seed)]
        assert wrong["bias"] - right["bias"] == pytest.approx(C / 2 * 2e-11, rel=0.01)
        assert wrong["bound"] == right["bound"]


@pytest.mark.parametrize(
    "change", [{"mismatch": {"to": 1e-11}}, {"mismatch": {}}, {"conditions": ["matched"]}, {"mismatch": {"t0": 0.0}}]
)
def test_tables_that_say_nothing_are_refused(change: dict[str, object]) -> None:
    with pytest.raises(InputError):
        load_suite(SUITE | change)


def test_the_shipped_suite_loads() -> None:
    loaded = load_suite("mismatch")
    assert set(loaded.suite.mismatch) == set(ERRORS)


def test_every_error_of_the_shipped_suite_can_be_declared() -> None:
    """One sign at least of each error that applies: the pitch of a preset of lenslets could not be, and its rows held no number."""
    loaded = load_suite("mismatch")
    seen = set()
    for _, scene in loaded.scenes:
        for error in filter(lambda one: applies(one, scene), loaded.suite.mismatch):
            declared = declared_rig(mismatched(scene, {error: loaded.suite.mismatch[error]}))
            assert declared != declared_rig(scene), error
            seen.add(error)
    assert seen == set(ERRORS)
    pitch = declared_rig(mismatched(load_scene("gated-turbulence"), {"pitch": 0.005}))["lenslets"]["pitch_m"]
    assert pitch == pytest.approx(1.005 * declared_rig(load_scene("gated-turbulence"))["lenslets"]["pitch_m"])
