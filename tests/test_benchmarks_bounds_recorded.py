"""Recorded captures with a surveyed truth and no true scene: scored by the same code, without a bound."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import xarray as xr

import beambench
from beambench.benchmarks.judges.bound import bound_of
from beambench.captures import write
from beambench.captures.build import make_capture
from beambench.captures.layouts import layout_of
from beambench.generator.generate import generate
from beambench.scenes.errors import InputError
from beambench.scenes.load import load_scene

SMALL = {"rig.camera.rows": 8, "rig.camera.cols": 8}
SCENES: dict[str, tuple[str, dict[str, Any], str]] = {
    "gated": ("relief-tank", SMALL, "poisson-ml"),
    "jittery": ("flat-wall", {**SMALL, "rig.laser.jitter_shot_s": 3e-10}, "poisson-ml"),
    "waveform": ("photodetector-5m", {}, "waveform-ml"),
    "amcw": ("amcw", {}, "amcw-ml"),
}


def rendered(name: str) -> xr.Dataset:
    scene, changes, _ = SCENES[name]
    return generate(load_scene(scene, changes), seed=3, capture_key=1)


def recorded(capture: xr.Dataset, kind: str) -> xr.Dataset:
    """What a laboratory has of the same: data, the declared rig, and a survey of the ranges."""
    schema = layout_of(str(capture.attrs["modality"])).by_name
    data = {n: capture[n].values for n, v in schema.items() if v.role == "data" and n in capture}
    coords = {n: capture[n].values for n, v in schema.items() if v.role == "coord" and n in capture}
    return make_capture(
        str(capture.attrs["modality"]), data, coords, {"truth_range": capture["truth_range"].values},
        {"rig": capture.attrs["rig"], "truth_kind": kind},
    )  # fmt: skip


@pytest.mark.parametrize("kind", ["surveyed", "reference-instrument"])
@pytest.mark.parametrize("name", ["gated", "waveform", "amcw"])
def test_a_surveyed_capture_is_scored_without_a_bound(name: str, kind: str, tmp_path: Path) -> None:
    capture = rendered(name)
    label = SCENES[name][2]
    tables = []
    for folder, held in (("rendered", capture), (kind, recorded(capture, kind))):
        write(tmp_path / folder, held)
        beambench.estimate(tmp_path / folder, [label], out=tmp_path / f"{folder}-estimates")
        tables.append(
            beambench.score(tmp_path / folder, tmp_path / f"{folder}-estimates", out=tmp_path / f"{folder}-scores")
        )
    ours, theirs = (table[table["quantity"] == "range"].iloc[0] for table in tables)
    assert theirs["bound_kind"] == "none"
    assert np.isnan(theirs["bound"])
    assert np.isnan(theirs["efficiency"])
    assert theirs["status"] == "ok"
    assert theirs["n"] == np.isfinite(capture["truth_range"].values).sum()
    # The threshold comes from declared samples: 1/48 of the width apart, they widen it by less than a thousandth.
    assert theirs["failure_at"] == pytest.approx(ours["failure_at"], rel=2e-3)
    if "truth_mixed" not in capture or not capture["truth_mixed"].values.any():
        assert theirs["rmse"] == ours["rmse"]


@pytest.mark.parametrize("name", list(SCENES))
def test_the_declared_rig_tells_the_scales_of_the_true_one(name: str) -> None:
    capture = rendered(name)
    ours, theirs = bound_of(capture), bound_of(recorded(capture, "surveyed"))
    assert theirs.kind == "none"
    assert np.isnan(theirs.sigma).all()
    assert theirs.sigma.shape == capture["truth_range"].shape
    assert theirs.scale == pytest.approx(ours.scale, rel=2e-3)
    assert theirs.window == pytest.approx(ours.window, rel=2e-3)


@pytest.mark.parametrize(("name", "path"), [("gated", "gates"), ("waveform", "response"), ("amcw", "modulation")])
def test_a_rig_that_declares_too_little_is_told(name: str, path: str) -> None:
    held = recorded(rendered(name), "surveyed")
    rig = json.loads(held.attrs["rig"])
    del rig[path]
    with pytest.raises(InputError, match="scale of failure"):
        bound_of(held.assign_attrs(rig=json.dumps(rig)))
