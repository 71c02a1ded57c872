"""Registration by a noisy reference: the lattice comes back within its errors, and estimates survive a lattice declared wrongly."""

from __future__ import annotations

import json
from typing import Any

import numpy as np
import pytest

from beambench.benchmarks.judges.calibrate import calibrated_rig
from beambench.benchmarks.suites.spec import Calibration
from beambench.benchmarks.written.wavefront import written_capture
from beambench.captures.hide import hide_truth
from beambench.estimators import run_estimator
from beambench.scenes.declared import declared_rig
from beambench.scenes.errors import InputError
from beambench.scenes.load import load_scene
from beambench.scenes.rigs.wavefront import wavefront_rig
from beambench.scenes.rigs.wavefront_geometry import lattice_of
from beambench.scenes.scene import Scene


def _scene(**changes: Any) -> Scene:
    small = {"rig.lenslets.across": 10, "rig.pupil.diameter_m": 1.4e-3, "rig.pupil.modes": 6, "rig.bench.beam_diameter_m": 2e-3,
             "rig.camera.rows": 120, "rig.camera.cols": 120}  # fmt: skip
    return load_scene("gated-turbulence", {**small, **changes})


def _registered(scene: Scene, declared: dict[str, Any], seed: int = 0, photoelectrons: float = 6e4) -> dict[str, Any]:
    calibration = Calibration(spot_photoelectrons=photoelectrons)
    return dict(json.loads(calibrated_rig(scene, json.dumps(declared), calibration, seed=seed)))


def _wrong(scene: Scene) -> dict[str, Any]:
    """The declared rig of an array that is not turned, with its places .6 px beside and its pixels 1 % too large."""
    flat = _scene()
    declared = declared_rig(flat)
    declared["lenslets"]["col_px"] = [value + 0.6 for value in declared["lenslets"]["col_px"]]
    declared["camera"]["pixel_pitch_m"] *= 1.01
    return declared


def test_a_reference_gives_back_the_lattice() -> None:
    scene = _scene(**{"rig.lenslets.rotation_deg": 1.0})
    rig = wavefront_rig(scene)
    lattice = lattice_of(rig)
    places, pixels, turns = [], [], []
    for seed in range(8):
        found = _registered(scene, _wrong(scene), seed)
        places.append(np.mean(found["lenslets"]["col_px"]) - lattice.col_px.mean())
        pixels.append(found["camera"]["pixel_pitch_m"] / rig.camera.pixel_pitch_m - 1.0)
        turns.append(found["lenslets"]["rotation_rad"] - lattice.rotation_rad)
    # A spot of 6e4 photoelectrons, σ = .6 px and F² = 1.8 is placed within .6·√(1.8/6e4) = 3.3e-3 px and more for its wings and the
    # read noise: 8e-3 px. The mean of n spots errs by that over √n; pitch and rotation by that over √(2Σr²), r from the middle.
    far = np.hypot(lattice.row - lattice.row.mean(), lattice.col - lattice.col.mean()) * 150e-6 / 17.8e-6
    one = 8e-3
    assert 0 < np.std(places) < one / np.sqrt(far.size) and abs(np.mean(places)) < one
    for errors in (pixels, turns):
        assert 0 < np.std(errors) < one / np.sqrt((far**2).sum())
        assert abs(np.mean(errors)) < 2e-4  # sinc² tails of spots beyond the edge pull the outermost spots inwards


def test_slopes_are_scaled_by_the_registered_pixel() -> None:
    scene = _scene()
    slope = np.full((4, lattice_of(wavefront_rig(scene)).row.size, 2), 1.5e-3)
    capture = hide_truth(written_capture(scene, 5e3, 0.0, slope, seed=3))
    means = {}
    for name, rig in (("wrong", _wrong(scene)), ("registered", _registered(scene, _wrong(scene)))):
        found = run_estimator("spot-joint+slope-cell", capture.assign_attrs(rig=json.dumps(rig)))
        means[name] = float(found["slope"].values[found["valid"].values].mean()) / 1.5e-3 - 1.0
    # Noise of the mean: .6·√(1.8/5e3) px, twice that for wings and read noise, of .564 px over √(2·4·n): 2e-3.
    assert abs(means["registered"]) < 5e-3 < 7e-3 < means["wrong"]


def test_a_lattice_that_is_another_is_refused() -> None:
    scene = _scene()
    wrong = declared_rig(scene)
    # Rows for columns: a mirrored lattice, which no turn makes.
    wrong["lenslets"]["row"], wrong["lenslets"]["col"] = wrong["lenslets"]["col"], wrong["lenslets"]["row"]
    with pytest.raises(InputError, match="does not show the declared lattice"):
        _registered(scene, wrong)
    with pytest.raises(InputError, match="spot_photoelectrons"):
        calibrated_rig(scene, json.dumps(declared_rig(scene)), Calibration())
