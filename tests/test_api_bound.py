"""`beambench bound`: the bound of a capture as a table, for people, for programs and from Python."""

from __future__ import annotations

import json
import math
from pathlib import Path

import numpy as np
import pytest

import beambench
from beambench.benchmarks.written.gated import response_area_s, written_capture
from beambench.captures import write
from beambench.captures.build import make_capture
from beambench.cli import main
from beambench.optics.constants import C_M_PER_S, FWHM_PER_SIGMA
from beambench.scenes.load import load_scene

PHOTONS = 10_000.0


def _capture():  # type: ignore[no-untyped-def]
    """A dense Gaussian stack of 10,000 photoelectrons without background: cσ_R/(2√N) = .64 mm."""
    scene = load_scene("flat-wall", {
        "rig.camera.rows": 4, "rig.camera.cols": 4, "rig.detector.read_noise_e": 0.0, "rig.detector.gain_dn_per_e": 50.0,
        "rig.detector.full_well_e": 1e6, "medium.index": {"kind": "explicit", "phase": 1.0, "group": 1.0},
        "rig.laser.pulse": {"kind": "gaussian", "fwhm_s": 2e-10},
        "rig.gates": [{"kind": "gaussian", "fwhm_s": math.sqrt(0.96) * 1e-9, "transmission": 1.0}],
        "rig.delays": {"start_s": 29e-9, "step_s": 5e-11, "count": 160, "repeats": 1, "laser_off": 0},
    })  # fmt: skip
    area, _ = response_area_s(scene)
    return written_capture(scene, PHOTONS / (area / 5e-11), 0.0)


def test_the_bound_of_a_store_is_its_closed_form(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    capture = _capture()
    write(tmp_path / "stack.zarr", capture)
    expected = C_M_PER_S * 1e-9 / FWHM_PER_SIGMA / (2 * math.sqrt(PHOTONS))
    (row,) = beambench.bound(tmp_path / "stack.zarr").to_dict("records")
    assert (row["capture"], row["scene"], row["quantity"], row["unit"]) == (0, "flat-wall", "range", "m")
    assert (row["elements"], row["informed"], row["kind"]) == (16, 16, "exact")
    assert row["bound_median"] == pytest.approx(expected, rel=2e-3)
    assert row["bound_rms"] == pytest.approx(expected, rel=2e-3)
    assert row["prior"] == pytest.approx(row["window"] / math.sqrt(12))
    assert main(["bound", str(tmp_path / "stack.zarr"), "--json"]) == 0
    (told,) = json.loads(capsys.readouterr().out)["rows"]
    assert told["bound_median"] == row["bound_median"] and told["kind"] == "exact"
    assert main(["bound", str(tmp_path / "stack.zarr")]) == 0
    assert f"{row['bound_median']:.4g}" in capsys.readouterr().out


def test_a_capture_without_truth_has_no_bound_and_says_so(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    held = _capture()
    names = ("delay", "gate", "pulses", "laser_on", "time", "valid")
    bare = make_capture(
        "gated", {"counts": held["counts"].values}, {n: held[n].values for n in names}, {},
        {"rig": held.attrs["rig"], "truth_kind": "none"},
    )  # fmt: skip
    write(tmp_path / "bare.zarr", bare)
    assert main(["bound", str(tmp_path / "bare.zarr")]) == 2
    assert "holds no truth" in capsys.readouterr().err
    survey = make_capture(
        "gated", {"counts": held["counts"].values}, {n: held[n].values for n in names},
        {"truth_range": np.full((4, 4), 5.0)}, {"rig": held.attrs["rig"], "truth_kind": "surveyed"},
    )  # fmt: skip
    write(tmp_path / "survey.zarr", survey)
    (row,) = beambench.bound(tmp_path / "survey.zarr").to_dict("records")
    assert row["kind"] == "none" and row["informed"] == 0 and math.isnan(row["bound_median"])
