"""Domes: exact refraction at two spheres against Fermat's principle, rigs that have one, and ports that are refused."""

from __future__ import annotations

import json
from typing import Any

import numpy as np
import pytest
from scipy.optimize import least_squares

from beambench.captures.hide import hide_truth
from beambench.estimators import get_estimator, run_estimator, stage_result
from beambench.estimators.rig import read_rig
from beambench.generator.generate import generate
from beambench.optics.dome import DomePort, slope_through_dome, through_dome
from beambench.optics.pinhole import Pinhole
from beambench.scenes.errors import InputError
from beambench.scenes.load import load_scene

DOME = DomePort((0.004, -0.003, -0.012), 0.08, 0.008, 1.00027, 1.52, 1.335)


def _fermat(point: np.ndarray, port: DomePort) -> np.ndarray:
    """Where the ray of stationary optical path from the pupil to `point` crosses the two spheres (2, 3).

    Written here from n·length alone: places on a sphere by two angles about the direction of the point, and both derivatives of the
    path by the angles zero, each the difference of the indices' unit vectors along the sphere.
    """
    center = np.array(port.center_m)
    axis = point / np.linalg.norm(point)
    one = np.cross(axis, [0.0, 1.0, 0.0])
    one /= np.linalg.norm(one)
    two = np.cross(axis, one)
    n = np.array([port.inside, port.glass, port.outside])
    radii = (port.radius_m - port.thickness_m, port.radius_m)

    def places(v: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        at, tangents = [], []
        for (a, b), radius in zip(v.reshape(2, 2), radii, strict=True):
            raw = axis + a * one + b * two
            size = np.linalg.norm(raw)
            unit = raw / size
            at.append(center + radius * unit)
            tangents.append([radius * (t - unit * (unit @ t)) / size for t in (one, two)])
        return np.array(at), np.array(tangents)

    def gradient(v: np.ndarray) -> np.ndarray:
        at, tangents = places(v)
        legs = np.diff(np.vstack([np.zeros(3), at, point]), axis=0)
        unit = n[:, None] * legs / np.linalg.norm(legs, axis=1)[:, None]
        return np.array([(unit[k] - unit[k + 1]) @ t for k in range(2) for t in tangents[k]]) / radii[1]

    found = least_squares(gradient, np.zeros(4), xtol=1e-15, ftol=1e-15, gtol=1e-15).x
    for _ in range(5):
        h = 1e-6
        matrix = np.stack([(gradient(found + h * e) - gradient(found - h * e)) / (2 * h) for e in np.eye(4)], axis=1)
        found = found - np.linalg.solve(matrix, gradient(found))
    return places(found)[0]


def test_the_ray_to_a_point_through_a_dome_is_fermats() -> None:
    """It would see a wrong index, sign of a normal, or radius: the decentring bends rays by milliradians."""
    rng = np.random.default_rng(3)
    bent = 0.0
    for _ in range(12):
        point = np.array([*rng.uniform(-0.6, 0.6, 2), rng.uniform(0.3, 2.0)])
        inner, outer = _fermat(point, DOME)
        x, y = slope_through_dome(point[:, None], DOME)
        origin, direction = through_dome(x, y, DOME)
        start = np.array([x[0], y[0], 1.0]) / np.linalg.norm([x[0], y[0], 1.0])
        assert np.abs(start - inner / np.linalg.norm(inner)).max() < 1e-9
        assert np.abs(origin[:, 0] - outer).max() < 1e-9
        toward = point - outer
        assert np.abs(direction[:, 0] - toward / np.linalg.norm(toward)).max() < 1e-9
        bent = max(bent, float(np.linalg.norm(start - direction[:, 0])))
    assert bent > 0.02


def test_a_dome_about_the_pupil_bends_no_ray() -> None:
    port = DomePort((0.0, 0.0, 0.0), 0.1, 0.01, 1.0, 1.5, 1.34)
    x, y = (v.ravel() for v in np.meshgrid(np.linspace(-0.8, 0.8, 9), np.linspace(-0.6, 0.6, 7)))
    origin, direction = through_dome(x, y, port)
    straight = np.stack([x, y, np.ones_like(x)]) / np.sqrt(x * x + y * y + 1.0)
    assert np.abs(direction - straight).max() < 1e-15 and np.abs(origin - 0.1 * straight).max() < 1e-15
    assert Pinhole(500.0, 0.0, 0.0, port=port).narrowing == pytest.approx(1.0, abs=1e-8)
    # The limit of a great sphere is a flat window: narrower by the ratio of the indices near the axis.
    flat = DomePort((0.0, 0.0, -1e4 + 0.04), 1e4, 0.01, 1.0, 1.5, 1.34)
    assert Pinhole(500.0, 0.0, 0.0, port=flat).narrowing == pytest.approx(1.34, rel=1e-4)
    assert flat.depth_m == pytest.approx(0.04, abs=1e-9)


def test_a_pixel_and_its_point_are_one() -> None:
    camera = Pinhole(432.4, 127.5, 95.5, (-0.2, 0.05, 1e-3, -5e-4, 0.01), DOME)
    rng = np.random.default_rng(1)
    row, col = rng.uniform(-0.5, 255.5, 2000), rng.uniform(-0.5, 191.5, 2000)
    origin, direction = camera.rays(row, col)
    again = camera.project(origin + direction * rng.uniform(0.02, 5.0, 2000))
    # 1e-11 in slope is what a point is found to, times a focal length of 432 px.
    assert np.abs(again[0] - row).max() < 5e-9 and np.abs(again[1] - col).max() < 5e-9
    inside = slope_through_dome(np.array([[0.0], [0.0], [0.05]]), DOME)
    assert np.isnan(inside).all() and np.isnan(slope_through_dome(np.array([[0.0], [0.0], [-1.0]]), DOME)).all()


def _dome(**changes: Any) -> dict[str, Any]:
    port = {
        "kind": "dome", "center_m": [0.003, 0.0, -0.01], "radius_m": 0.08, "thickness_m": 0.008, "glass_index": 1.5,
        "inside_index": 1.0,
    }  # fmt: skip
    return {"rig.port": port | changes, "rig.camera.rows": 48, "rig.frames.lit": 1}


def test_a_rig_with_a_dome_is_generated_and_triangulated() -> None:
    """Truth lies on the wall, and its columns triangulate to it; a dome taken for none errs by millimetres."""
    capture = generate(load_scene("spotscan-wall", _dome()), seed=1, truth_electrons=True)
    column, point = capture["truth_column"].values, capture["truth_point"].values
    assert np.isfinite(column).all()
    a, turn = np.deg2rad(15.0), np.deg2rad(-10.0)
    facing = np.array([np.sin(turn) * -np.cos(a), np.sin(a), np.cos(turn) * -np.cos(a)])
    assert np.abs((point - [0.0, 0.0, 1.0]) @ facing).max() < 2e-6
    lines = stage_result("line", column=column, sigma=np.full(column.shape, 1e-3), valid=np.isfinite(column))

    def found(name: str) -> np.ndarray:
        return np.asarray(get_estimator(name).function(lines, read_rig(capture))["point"].values)

    assert np.abs(found("triangulate-refractive") - point).max() < 1e-12
    assert np.abs(found("triangulate-air") - point).max() > 5e-3
    with pytest.raises(InputError, match="flat ports only"):
        found("triangulate-pinhole-port")
    answer = run_estimator("line-ml+triangulate-refractive", hide_truth(capture))
    error = (answer["point"].values - point) / answer["sigma"].values
    assert answer["valid"].values.all() and 0.6 < np.sqrt((error**2).mean()) < 1.5
    assert json.loads(capture.attrs["rig"])["port"]["kind"] == "dome"


@pytest.mark.parametrize(
    ("changes", "reason"),
    [
        (_dome(center_m=[0.0, 0.0, -0.09]), "outside its dome"),
        (_dome(center_m=[0.0, 0.0, 0.075]), "outside its dome"),
        (_dome(thickness_m=0.08), "outside its dome"),
        (_dome(radius_m=0.3), "inside the camera's dome"),
        ({"rig.port.stand_off_m": -0.01}, "stand_off_m"),
        ({"rig.laser.rotation_deg": [0.0, 0.0, 90.0], "rig.laser.position_m": [0.0, 0.2, 0.03]}, "along the rows"),
        ({"rig.laser.rotation_deg": [0.0, 45.0, 0.0]}, "no part of the laser's sheet"),
        ({"rig.laser.position_m": [0.0, 0.0, 0.03], "rig.laser.rotation_deg": [0.0, 0.0, 0.0]}, "entrance pupil"),
        (
            {
                "medium.index": {"kind": "explicit", "phase": 1.0, "group": 1.0}, "rig.port.inside_index": 1.5,
                "rig.camera.focal_length_m": 5e-3,
            },
            "reflects it totally",
        ),
    ],
)  # fmt: skip
def test_a_rig_that_cannot_be_is_refused_with_the_reason(changes: dict[str, Any], reason: str) -> None:
    with pytest.raises(InputError) as caught:
        generate(load_scene("spotscan-wall", changes), seed=1)
    assert reason in f"{caught.value.what} {caught.value.where} {caught.value.allowed}"
