"""Inclinometers: what they read, and points in the gravity frame."""

from __future__ import annotations

import json
from typing import Any

import numpy as np
import pytest
import xarray as xr

from beambench.benchmarks.judges.bound import bounds_of, truths_of
from beambench.captures.hide import hide_truth
from beambench.estimators import run_estimator
from beambench.estimators.laser_line.gravity import level_points
from beambench.estimators.result import stage_result
from beambench.estimators.rig import DeclaredRig
from beambench.generator.generate import generate
from beambench.optics.gravity import attitude, level_matrix, level_slopes
from beambench.scenes.errors import InputError
from beambench.scenes.load import load_scene

CHAIN = "line-ml+triangulate-refractive+level-points"
SMALL = {"rig.camera.rows": 64, "rig.frames.lit": 1}


def made(meter: dict[str, Any] | None, **changes: Any) -> xr.Dataset:
    own = {} if meter is None else {"rig.inclinometers": meter}
    scene = load_scene("spotscan-wall", SMALL | own | {f"rig.{k}": v for k, v in changes.items()})
    return generate(scene, seed=4, capture_key=3, fidelity="direct", rtol=0.01)


def floor_of(capture: xr.Dataset) -> tuple[np.ndarray, float]:
    """Unit normal, away from the camera, and distance of the plane in which the true points lie with the wall's own tilt."""
    scene = load_scene("spotscan-wall")
    shape: Any = scene.target[0].shape
    a, b = np.deg2rad([shape.tilt_x_deg, shape.tilt_y_deg])
    tilted_x = np.array([[1, 0, 0], [0, np.cos(a), -np.sin(a)], [0, np.sin(a), np.cos(a)]])
    tilted_y = np.array([[np.cos(b), 0, np.sin(b)], [0, 1, 0], [-np.sin(b), 0, np.cos(b)]])
    points = capture["truth_point"].values.reshape(-1, 3)
    points = points[np.isfinite(points).all(axis=1)]
    normals = [m @ [0.0, 0.0, 1.0] for m in (tilted_y @ tilted_x, tilted_x @ tilted_y)]
    normal = min(normals, key=lambda n: float(np.ptp(points @ n)))
    assert np.ptp(points @ normal) < 1e-6, "the wall's plane"
    return normal, float(np.mean(points @ normal))


def test_the_level_frame_has_gravity_downward() -> None:
    rng = np.random.default_rng(1)
    pitch, roll = rng.uniform(-1.4, 1.4, 50), rng.uniform(-3.0, 3.0, 50)
    turn = level_matrix(pitch, roll)
    np.testing.assert_allclose(turn @ np.swapaxes(turn, 1, 2), np.broadcast_to(np.eye(3), (50, 3, 3)), atol=1e-14)
    back = attitude(np.swapaxes(turn, 1, 2) @ [0.0, 1.0, 0.0])
    np.testing.assert_allclose(back, (pitch, roll), atol=1e-12)
    assert np.allclose(level_matrix(0.0, 0.0), np.eye(3))
    step = 1e-6
    for one, slope in zip(((step, 0.0), (0.0, step)), level_slopes(pitch, roll), strict=True):
        ahead, behind = level_matrix(pitch + one[0], roll + one[1]), level_matrix(pitch - one[0], roll - one[1])
        np.testing.assert_allclose(slope, (ahead - behind) / (2 * step), atol=1e-9)


def test_a_floor_is_level_by_the_inclinometers() -> None:
    """The wall is the floor of a camera that looks down: its points have one height, to their stated errors; a bias tilts it."""
    normal, distance = floor_of(made(None))
    pitch, roll = (float(np.rad2deg(v)) for v in attitude(normal))
    right = {"pitch_deg": pitch, "roll_deg": roll, "sigma_deg": 0.0, "bias_deg": [0.0, 0.0]}
    heights = {}
    for name, meter in (("right", right), ("biased", right | {"bias_deg": [1.0, 0.0]})):
        capture = made(meter)
        level = run_estimator(CHAIN, hide_truth(capture))
        held = level["valid"].values
        heights[name] = level["level_point"].values[held][:, 1]
        if name == "right":
            z = (heights[name] - distance) / level["sigma"].values[held][:, 1]
            assert held.sum() > 60 and 0.5 < np.sqrt((z**2).mean()) < 1.5
    assert np.ptp(heights["right"]) < 2e-3
    # A pitch that is read 1 degree too large lifts what lies ahead: by its z times a degree.
    assert np.ptp(heights["biased"]) > 5.0 * np.ptp(heights["right"])


def test_readings_follow_the_turning_rig_with_their_noise() -> None:
    """A rig that turns about its z axis by 1 mrad a second rolls so much; 400 readings tell a standard deviation to 3.5 %."""
    meter = {"pitch_deg": 0.0, "roll_deg": 10.0, "sigma_deg": 0.5, "bias_deg": [0.25, -0.5]}
    capture = made(meter, **{"frames.lit": 400, "camera.rows": 2, "turn_rad_per_s": [0.0, 0.0, 1e-3]})
    expected = np.deg2rad(10.0) + 1e-3 * capture["time"].values
    off = np.rad2deg(capture["roll"].values - expected)
    assert off.mean() == pytest.approx(-0.5, abs=4 * 0.5 / 20) and off.std() == pytest.approx(0.5, rel=0.15)
    pitch = np.rad2deg(capture["pitch"].values)
    assert pitch.mean() == pytest.approx(0.25, abs=4 * 0.5 / 20) and pitch.std() == pytest.approx(0.5, rel=0.15)


def test_without_inclinometers_captures_are_what_they_were_and_points_have_no_gravity() -> None:
    plain, with_meter = made(None), made({"pitch_deg": 1.0, "roll_deg": 2.0, "sigma_deg": 1.0, "bias_deg": [0.0, 0.0]})
    np.testing.assert_array_equal(plain["counts"], with_meter["counts"])
    assert "pitch" not in plain.coords and "inclinometers" not in plain.attrs["rig"]
    with pytest.raises(InputError, match="holds no attitude"):
        run_estimator(CHAIN, hide_truth(plain))


def test_level_points_by_closed_form() -> None:
    """Pitch 30 and roll 90 degrees of a point at (1, 2, 3) m: Rz(90°) gives (−2, 1, 3), and Rx(30°) then (−2, cos 30 − 3 sin 30,
    sin 30 + 3 cos 30). The error of readings of .01 rad alone is by hand: ∂/∂p turns (y, z) by a quarter, ∂/∂r moves x and y of
    the rolled point by −y and x before the pitch."""
    point = np.array([1.0, 2.0, 3.0]).reshape(1, 1, 1, 3)
    points = stage_result(
        "triangulation", point=point, sigma=np.full((1, 1, 1, 3), 1e-9), valid=np.ones((1, 1, 1), bool)
    )
    read = xr.Dataset(coords={"pitch": ("frame", [np.pi / 6]), "roll": ("frame", [np.pi / 2])})
    rig = {"inclinometers": {"sigma_deg": float(np.rad2deg(0.01))}}
    level = level_points(points, DeclaredRig(json.dumps(rig), rig), read)
    c, s = np.cos(np.pi / 6), 0.5
    np.testing.assert_allclose(level["level_point"].values.ravel(), [-2.0, c - 3 * s, s + 3 * c], atol=1e-12)
    by_pitch, by_roll = np.array([0.0, -(s + 3 * c), c - 3 * s]), np.array([-1.0, -2 * c, -2 * s])
    np.testing.assert_allclose(level["sigma"].values.ravel(), 0.01 * np.hypot(by_pitch, by_roll), rtol=1e-6)


def test_points_in_the_gravity_frame_are_scored() -> None:
    """As a chain of the capture of a turning rig: truth by the true attitude, whose plane is that of the wall, and z of the stated
    errors. One reading moves all points of a frame: z of 40 frames is known to 12 %."""
    meter = {"pitch_deg": 30.0, "roll_deg": 10.0, "sigma_deg": 0.05, "bias_deg": [0.0, 0.0]}
    capture = made(meter, **{"frames.lit": 40, "camera.rows": 4, "turn_rad_per_s": [0.0, 0.0, 1e-3]})
    truth, bound = truths_of(capture)["level_point"], bounds_of(capture)["level_point"]
    assert bound.kind == "quasi" and np.isfinite(bound.sigma[np.isfinite(truth.value)]).all()
    found = run_estimator(CHAIN, hide_truth(capture))
    z = ((found["level_point"].values - truth.value) / found["sigma"].values)[found["valid"].values]
    assert z.size > 300 and 0.6 < np.sqrt(np.mean(z**2)) < 1.4
    assert not truths_of(made(None)).get("level_point")
