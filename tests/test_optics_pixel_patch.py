"""Kusters' triangulation and predicted error as printed, against exact refraction and against the figures derived from them."""

from __future__ import annotations

import numpy as np
import pytest

from beambench.optics.pinhole import Pinhole
from beambench.optics.pixel_patch import (
    direction_eq3_22,
    incidence_eq3_20,
    patch_corner_eq3_33,
    point_eq3_32,
    predicted_error_m,
    refracted_eq3_21,
)
from beambench.optics.port import FlatPort
from beambench.optics.sheet import meeting

SPOTSCAN = {
    "pixel_m": 57.8125e-6, "focal_length_m": 25e-3, "index": 1.33, "baseline_m": 0.15, "angle_rad": np.deg2rad(10.0),
}  # fmt: skip


def test_the_printed_triangulation_is_a_port_at_the_pinhole() -> None:
    """Eq. 3.20 to 3.32 give the points that exact refraction without stand-off gives, in the laser's frame."""
    rng = np.random.default_rng(2)
    d1, d2 = rng.uniform(-4e-3, 4e-3, 200), rng.uniform(-7e-3, 7e-3, 200)
    printed = point_eq3_32(direction_eq3_22(d1, d2, 25e-3, 1.33), 0.15, SPOTSCAN["angle_rad"])
    camera = Pinhole(25e-3, 0.0, 0.0, port=FlatPort(0.0, 0.0, 1.0, 1.5, 1.33))  # a "pixel" of one metre
    origin, direction = camera.rays(d2, d1)
    c, s = np.cos(SPOTSCAN["angle_rad"]), np.sin(SPOTSCAN["angle_rad"])
    laser = np.array([c * 0.15, 0.0, s * 0.15])
    across, ahead = np.array([c, 0.0, s]), np.array([-s, 0.0, c])
    point = meeting(origin, direction, across, laser) - laser[:, None]
    assert printed[1] == pytest.approx(point[1], rel=1e-12) and printed[2] == pytest.approx(ahead @ point, rel=1e-12)
    assert not printed[0].any()


def test_refraction_as_printed() -> None:
    beta = incidence_eq3_20(3e-3, 4e-3, 25e-3)
    assert np.tan(beta) == pytest.approx(0.2) and np.sin(refracted_eq3_21(beta, 1.33)) * 1.33 == pytest.approx(
        np.sin(beta)
    )
    assert direction_eq3_22(0.0, 0.0, 25e-3, 1.33)[2] == pytest.approx(1.33 * 25e-3)
    assert direction_eq3_22(1e-9, 0.0, 25e-3, 1.33)[2] == pytest.approx(1.33 * 25e-3, rel=1e-6)


@pytest.mark.parametrize(("range_m", "error_mm"), [(1.0, 5.95), (2.0, 23.07)])
def test_the_predicted_error_of_the_spotscan(range_m: float, error_mm: float) -> None:
    """The document's "5 mm at 1 m" is below its own prediction, without any aberration of the lens."""
    error = 1e3 * float(predicted_error_m(range_m, **SPOTSCAN))
    assert error == pytest.approx(error_mm, abs=0.01)
    near = 1e3 * range_m**2 * 57.8125e-6 / (2 * 1.33 * 25e-3 * 0.15)
    assert error == pytest.approx(near, rel=0.03)
    assert float(predicted_error_m(1.0, **SPOTSCAN)) > 5e-3


def test_the_error_falls_with_the_baseline_and_hardly_with_the_angle() -> None:
    """Figure 3.7, 100 to 250 mm: nearly as 1/b. "Changing the camera angle has no effect": 94.5 and 91.1 mm at 4 m."""
    at_1_m = [float(predicted_error_m(1.0, **{**SPOTSCAN, "baseline_m": b})) for b in (0.1, 0.15, 0.2, 0.25)]
    assert at_1_m == sorted(at_1_m, reverse=True)
    assert at_1_m[0] / at_1_m[3] == pytest.approx(2.5, rel=0.06)
    by_angle = [1e3 * float(predicted_error_m(4.0, **{**SPOTSCAN, "angle_rad": np.deg2rad(a)})) for a in (5.0, 10.0)]
    assert by_angle == pytest.approx([94.5, 91.1], abs=0.1)


def test_the_far_corner_is_farther_than_the_pixel() -> None:
    d1, d2 = np.linspace(-5e-3, 5e-3, 11), np.full(11, -3e-3)
    middle = point_eq3_32(direction_eq3_22(d1, d2, 25e-3, 1.33), 0.15, SPOTSCAN["angle_rad"])
    corner = patch_corner_eq3_33(d1, d2, 57.8125e-6, 25e-3, 1.33, 0.15, SPOTSCAN["angle_rad"])
    assert (corner[2] > middle[2]).all() and (corner[1] < middle[1]).all()
