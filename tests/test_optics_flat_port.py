"""Rays through a flat port against Fermat's principle, and the camera there and back."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.optimize import minimize

from beambench.optics.pinhole import Pinhole, distorted, undistorted
from beambench.optics.port import FlatPort, slope_toward, through_port
from beambench.optics.rotation import rotation_matrix, turned_by

PORT = FlatPort(0.03, 0.012, 1.00027, 1.52, 1.335)


def _fermat(point: np.ndarray, port: FlatPort) -> np.ndarray:
    """Where the ray of least optical path from the pupil to `point` crosses the two surfaces (4): x, y inside, x, y outside.

    Written here from n·length alone. Newton's method on the gradient of the path, from scipy's minimum: a minimiser that
    compares path lengths stops where these agree to 1e-16, which leaves 1e-8 of the place.
    """
    depth, far = port.stand_off_m, port.stand_off_m + port.thickness_m

    def gradient(v: np.ndarray) -> np.ndarray:
        nodes = np.array([[0, 0, 0], [v[0], v[1], depth], [v[2], v[3], far], point])
        legs = np.diff(nodes, axis=0)
        unit = legs / np.linalg.norm(legs, axis=1)[:, None]
        n = np.array([port.inside, port.glass, port.outside])[:, None]
        return ((n * unit)[:-1, :2] - (n * unit)[1:, :2]).ravel()

    def path(v: np.ndarray) -> float:
        nodes = np.array([[0, 0, 0], [v[0], v[1], depth], [v[2], v[3], far], point])
        return float(np.linalg.norm(np.diff(nodes, axis=0), axis=1) @ [port.inside, port.glass, port.outside])

    start = np.concatenate([point[:2] * depth / point[2], point[:2] * far / point[2]])
    found = minimize(path, start, jac=gradient, method="BFGS", options={"gtol": 1e-12}).x
    for _ in range(20):
        h = 1e-7
        hessian = np.stack([(gradient(found + h * e) - gradient(found - h * e)) / (2 * h) for e in np.eye(4)], axis=1)
        found = found - np.linalg.solve(hessian, gradient(found))
    return np.asarray(found)


def test_the_ray_to_a_point_is_fermats() -> None:
    rng = np.random.default_rng(3)
    for _ in range(12):
        point = np.array([*rng.uniform(-0.6, 0.6, 2), rng.uniform(0.3, 2.0)])
        crossing = _fermat(point, PORT)
        x, y = slope_toward(point[:, None], PORT)
        origin, direction = through_port(x, y, PORT)
        inner = np.array([x[0], y[0]]) * PORT.stand_off_m
        assert np.abs(inner - crossing[:2]).max() < 1e-9 and np.abs(origin[:2, 0] - crossing[2:]).max() < 1e-9
        towards = point - origin[:, 0]
        assert np.abs(direction[:, 0] - towards / np.linalg.norm(towards)).max() < 1e-9


def test_a_pixel_and_its_point_are_one_to_1e_12_px() -> None:
    camera = Pinhole(432.4, 127.5, 95.5, (-0.2, 0.05, 1e-3, -5e-4, 0.01), PORT)
    rng = np.random.default_rng(1)
    row, col = rng.uniform(-0.5, 255.5, 2000), rng.uniform(-0.5, 191.5, 2000)
    row[:2], col[:2] = 127.5, (95.5, 100.0)  # on the axis
    origin, direction = camera.rays(row, col)
    again = camera.project(origin + direction * rng.uniform(0.01, 5.0, 2000))
    assert np.abs(again[0] - row).max() < 1e-12 and np.abs(again[1] - col).max() < 1e-12


def test_without_a_port_the_camera_is_a_pinhole() -> None:
    camera = Pinhole(500.0, 10.0, 20.0)
    row, col = camera.project(np.array([[0.2], [-0.1], [2.0]]))
    assert row == pytest.approx(10 - 25) and col == pytest.approx(20 + 50)
    origin, direction = camera.rays(row, col)
    assert not origin.any() and direction[:, 0] == pytest.approx(np.array([0.2, -0.1, 2.0]) / np.sqrt(4.05))


def test_what_no_ray_reaches_is_nan() -> None:
    """Behind the window; beyond the critical angle of a bubble (49 degrees from water to air)."""
    outside = slope_toward(np.array([[0.0, 0.1], [0.0, 0.0], [0.041, -1.0]]), PORT)
    assert np.isnan(outside).all()
    bubble = FlatPort(0.0, 0.0, 1.335, 1.335, 1.0)
    _, direction = through_port(np.array([0.5, 2.0]), np.zeros(2), bubble)
    assert np.isfinite(direction[:, 0]).all() and np.isnan(direction[:, 1]).all()
    assert np.isnan(Pinhole(500.0, 0.0, 0.0).project(np.array([[0.0], [0.0], [-1.0]]))).all()


def test_snells_law_at_one_surface() -> None:
    x = np.linspace(0.0, 3.0, 50)
    _, direction = through_port(x, np.zeros(50), FlatPort(0.0, 0.0, 1.0, 1.5, 1.33))
    assert direction[0] * 1.33 == pytest.approx(np.sin(np.arctan(x)), abs=1e-15)
    assert (direction**2).sum(axis=0) == pytest.approx(1.0, abs=1e-15)


def test_distortion_is_undone() -> None:
    k = (-0.25, 0.08, 2e-3, -1e-3, 0.02)
    x, y = (v.ravel() for v in np.meshgrid(np.linspace(-0.5, 0.5, 21), np.linspace(-0.4, 0.4, 21)))
    assert np.abs(np.subtract(undistorted(*distorted(x, y, k), k), (x, y))).max() < 1e-12
    # r(1 − 3r²) never exceeds its maximum of 2/9: beyond it no slope is the image of any.
    assert np.isnan(undistorted(np.array([0.3]), np.zeros(1), (-3.0, 0.0, 0.0, 0.0, 0.0))).all()


def test_a_rotation_vector_turns_by_its_length() -> None:
    assert turned_by([0, 0, np.pi / 2]) @ [1, 0, 0] == pytest.approx([0, 1, 0], abs=1e-15)
    assert np.allclose(turned_by(np.deg2rad([0, 20, 0])), rotation_matrix((0, 20, 0)), atol=1e-15)
    assert np.array_equal(turned_by([0, 0, 0]), np.eye(3))
