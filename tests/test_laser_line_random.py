"""Random laser-line scenes: light is finite and nowhere negative, truth lies on sheet and target, equal seeds give equal bits."""

from __future__ import annotations

import contextlib
import json
import warnings
from typing import Any

import numpy as np
import pytest

from beambench.benchmarks.judges.bound import bounds_of
from beambench.captures.hide import hide_truth
from beambench.captures.validate import validate
from beambench.estimators import run_estimator
from beambench.generator.generate import generate
from beambench.scenes.errors import InputError
from beambench.scenes.load import load_scene

SEEDS = range(40)
#: All of 500 random scenes; the first 40 are in the default run.
MORE = range(40, 500)


def _changes(seed: int) -> dict[str, Any]:
    """A rig and a target of random values, of which many see no line at all."""
    rng = np.random.default_rng(seed)
    far = float(rng.uniform(0.4, 4.0))
    shape: dict[str, Any] = {
        "kind": "rectangle", "center_m": [0.0, 0.0, far], "width_m": 2 * far, "height_m": 2 * far,
        "tilt_x_deg": float(rng.uniform(-70, 70)), "tilt_y_deg": float(rng.uniform(-70, 70)),
    }  # fmt: skip
    if seed % 3 == 1:
        shape = {"kind": "sphere", "center_m": [float(rng.uniform(-0.1, 0.1)), 0.05, far], "radius_m": 0.3 * far}
    if seed % 3 == 2:
        shape = {
            "kind": "box", "center_m": [0.0, 0.0, far], "size_m": [0.4 * far] * 3,
            "rotation_deg": rng.uniform(0, 90, 3).tolist(),
        }  # fmt: skip
    scattering = float(rng.choice([0.0, 0.1, 1.0]))
    medium: dict[str, Any] = {
        "name": "random water", "index": {"kind": "explicit", "phase": float(rng.uniform(1.0, 1.4)), "group": 1.36},
        "absorption_per_m": float(rng.uniform(0, 1)), "scattering_per_m": scattering,
    }  # fmt: skip
    if scattering:
        medium["phase_function"] = {"kind": "henyey-greenstein", "g": float(rng.uniform(0.5, 0.97))}
    flat = {"kind": "flat", "stand_off_m": float(rng.uniform(0, 0.05)), "thickness_m": 0.01, "glass_index": 1.5,
            "inside_index": 1.0}  # fmt: skip
    baseline = float(rng.choice([-1, 1]) * rng.uniform(0.05, 0.3))
    albedo = float(rng.uniform(0.01, 1))
    port: dict[str, Any] = flat if rng.random() < 0.6 else {"kind": "none"}
    changes: dict[str, Any] = {
        "target.0.shape": shape, "target.0.material.albedo": albedo, "medium": medium,
        "rig.camera.rows": 40, "rig.camera.cols": 48, "rig.camera.pixel_pitch_m": 200e-6,
        "rig.camera.vignetting": str(rng.choice(["none", "cos4"])), "rig.lens_sigma_px": float(rng.choice([0.0, 0.5, 2.0])),
        "rig.laser.position_m": [baseline, float(rng.uniform(-0.05, 0.05)), 0.02],
        "rig.laser.rotation_deg": [0.0, float(-np.sign(baseline) * rng.uniform(0, 15)), float(rng.uniform(-8, 8))],
        "rig.laser.waist_m": float(10 ** rng.uniform(-4.5, -2)), "rig.laser.power_w": float(10 ** rng.uniform(-5, 0)),
        "rig.laser.fan_profile": str(rng.choice(["flat-top", "gaussian"])),
        "rig.detector.prnu": 0.01, "rig.detector.dsnu_e": 5.0, "rig.frames.laser_off": int(rng.integers(0, 2)),
    }  # fmt: skip
    # Drawn after all else, so that the scenes of earlier versions keep their other values.
    if port["kind"] == "none" and rng.random() < 0.5:
        port = {
            "kind": "dome", "center_m": rng.uniform(-0.005, 0.005, 3).tolist(), "radius_m": float(rng.uniform(0.02, 0.04)),
            "thickness_m": 0.005, "glass_index": 1.5, "inside_index": 1.0,
        }  # fmt: skip
    effects: dict[str, Any] = {}
    if rng.random() < 0.3:
        effects["focus"] = {"distance_m": far, "sensor_tilt_deg": float(rng.uniform(-5, 5))}
    if rng.random() < 0.3:
        effects["speckle_looks"] = float(rng.uniform(1, 50))
    if rng.random() < 0.3:
        effects["blooming"] = {"axis": str(rng.choice(["columns", "rows"])), "lost": float(rng.random())}
    if rng.random() < 0.2:
        effects["exposure_poses"] = 3
        changes["rig.motion_m_per_s"] = rng.uniform(-0.5, 0.5, 3).tolist()
    if effects:
        changes["rig.effects"] = effects
    return changes | {"rig.port": port}


def _scene(seed: int) -> Any:
    return load_scene("spotscan-wall", _changes(seed))


@pytest.mark.parametrize("seed", SEEDS)
def test_a_random_scene_is_sound(seed: int) -> None:
    scene = _scene(seed)
    _check(scene, seed)


@pytest.mark.slow
def test_many_random_scenes_are_sound(long_run: None) -> None:
    for seed in MORE:
        _check(_scene(seed), seed)


def _check(scene: Any, seed: int) -> None:
    rung: Any = "full" if seed % 10 == 4 else ("direct", "scatter")[seed % 2]
    rtol = 1e-2
    if rung == "full":  # of few pixels: where there is no line, it is traced until its paths are used up
        scene, rtol = (
            load_scene(scene, {"rig.camera.rows": 8, "rig.camera.cols": 10, "rig.camera.pixel_pitch_m": 1e-3}),
            0.5,
        )
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        try:
            capture = generate(scene, seed=seed, fidelity=rung, truth_electrons=True, rtol=rtol)
        except InputError as error:
            # A laser within a turned target, or behind all of it, is refused with the reason.
            assert any(word in error.what for word in ("inside", "behind", "ahead", "no part of"))
            return
        again = generate(scene, seed=seed, fidelity=rung, rtol=rtol)
    assert np.array_equal(capture["counts"], again["counts"])
    validate(capture)
    light = capture["truth_electrons"].values
    assert np.isfinite(light).all() and (light >= 0).all()
    bounds = bounds_of(capture)
    seen = np.isfinite(capture["truth_column"].values)
    assert (bounds["column"].sigma[seen] > 0).all() and np.isfinite(bounds["column"].scale)
    rig = json.loads(capture.attrs["rig"])
    point = capture["truth_point"].values[seen]
    on_sheet = (point - rig["laser"]["position_m"]) @ np.array(rig["laser"]["normal"])
    assert np.abs(on_sheet).max(initial=0.0) < 1e-9
    assert (capture["truth_amplitude"].values[seen] > 0).all() and (capture["truth_width"].values[seen] >= 0).all()
    found = run_estimator("line-ml+triangulate-refractive", hide_truth(capture))
    assert np.isfinite(found["point"].values[found["valid"].values]).all()


def test_many_of_the_scenes_show_a_line() -> None:
    lines = 0
    for seed in SEEDS:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            with contextlib.suppress(InputError):
                lines += bool(np.isfinite(generate(_scene(seed), seed=1, rtol=0.3)["truth_column"]).any())
    assert lines >= 15
