"""The packages that `estimators new --stage centroid` and `--stage reconstruction` write read clean captures as they should."""

from __future__ import annotations

import importlib.util
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import beambench
from beambench.benchmarks.judges.bound import truths_of
from beambench.benchmarks.laws.check import maker_of
from beambench.benchmarks.laws.suite import gain
from beambench.benchmarks.laws.wavefront import clean_capture
from beambench.captures.hide import hide_truth
from beambench.estimators import get_estimator, run_estimator
from beambench.estimators.rig import read_rig


def written(stage: str, folder: Path) -> Any:
    """The function of a package as it is written."""
    made = beambench.estimators_new("my-own", stage=stage, out=folder / stage)
    spec = importlib.util.spec_from_file_location(f"own_{stage}", made / "beambench_my_own.py")
    assert spec is not None and spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module.my_own


def test_the_written_centroid_reads_spots(tmp_path: Path) -> None:
    """Within .1 px rms of spots of 1,500 photoelectrons moved by .1 px, and a sigma that holds it; equal at twice the gain."""
    capture = clean_capture()
    found = run_estimator(centroid := written("centroid", tmp_path), hide_truth(capture))
    error = found["spot"].values - truths_of(capture)["spot"].value
    assert found["valid"].values.all() and np.sqrt((error**2).mean()) < 0.1
    assert np.sqrt(((error / found["sigma"].values) ** 2).mean()) < 1.2
    assert gain(centroid, maker_of("centroid")) == ""


def test_the_written_reconstruction_finds_low_modes(tmp_path: Path) -> None:
    """The coefficients of Noll's 2 to 6, which is all that these waves have, are those of `zernike-ls`; so is the phase."""
    capture = hide_truth(clean_capture())
    slopes, rig = run_estimator("spot-ml+slope-cell", capture), read_rig(capture)
    found = written("reconstruction", tmp_path)(slopes, rig)
    ours = get_estimator("zernike-ls").function(slopes, rig, modes=6, weighted=False)
    np.testing.assert_allclose(found["zernike"], ours["zernike"], atol=1e-9)
    np.testing.assert_allclose(found["sigma"], ours["sigma"], rtol=1e-9)
    np.testing.assert_allclose(found["phase"], ours["phase"], atol=1e-9)


def test_the_law_of_gain_scales_the_reference_too() -> None:
    """The reference comes from the converter of the frames: half of a law would try a capture that no sensor makes."""
    maker = maker_of("centroid")
    twice, clean = maker.doubled(), maker.clean()
    assert twice is not None
    np.testing.assert_array_equal(twice["reference"], 2.0 * clean["reference"])
    assert twice["reference"].attrs == clean["reference"].attrs


@pytest.mark.parametrize("label", ["spot-ml+slope-cell+turbulence-ml", "spot-ml+slope-cell+zernike-ls[modes=4]"])
def test_estimates_of_lengths_that_truth_alone_has_are_scored(label: str, tmp_path: Path) -> None:
    """Fewer modes than the truth holds are an answer, with the others missing; from a file as from `run`."""
    beambench.generate(
        "turbulent-tank", overrides={"rig.imager": None}, fidelity="geometric", out=tmp_path / "tank.zarr"
    )
    beambench.estimate(tmp_path / "tank.zarr", [label], out=tmp_path / "estimates")
    table = beambench.score(tmp_path / "tank.zarr", tmp_path / "estimates", out=tmp_path / "scores")
    wanted = {"r0", "present", "source"} if "turbulence" in label else {"zernike", "phase"}
    assert set(table["quantity"]) == wanted and (table["status"] == "ok").all()
    if "zernike" in wanted:
        assert table.set_index("quantity").loc["zernike", "coverage"] == pytest.approx(3 / 35)
