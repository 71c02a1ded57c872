"""Beam profiles (norm, half angle, offset) and Eq. 7-13."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest
from scipy.integrate import quad

from beambench.optics import illumination as il

MEASURED = (1.0, 0.95, 0.7, 0.75, 0.2, 0.05)


@pytest.mark.parametrize("half_angle", [1e-4, 0.01, 0.2, 0.8, 1.49])
@pytest.mark.parametrize("profile", ["gaussian", "flat-top", "measured"])
def test_unit_energy(profile: str, half_angle: float) -> None:
    values = MEASURED if profile == "measured" else None

    def ring(theta: float) -> float:
        return float(il.beam_intensity(profile, theta, half_angle, values)) * 2.0 * np.pi * np.sin(theta)  # type: ignore[arg-type]

    edges = np.unique(np.minimum(half_angle * np.array([0.0, 0.2, 0.4, 0.6, 0.8, 1.0, 2.0, 3.0, 6.0]), np.pi / 2))
    total = sum(quad(ring, a, b, epsabs=1e-12)[0] for a, b in pairwise(edges))
    # At the very edge of a flat top quad may meet one side or the other: no node lies on it.
    np.testing.assert_allclose(total, 1.0, atol=1e-9)


def test_half_angle_means_what_it_says() -> None:
    at = il.gaussian_intensity([0.0, 0.3], 0.3)
    np.testing.assert_allclose(at[1] / at[0], np.exp(-2.0), rtol=1e-13)
    flat = il.flat_top_intensity([0.0, 0.29, 0.31], 0.3)
    assert flat[0] == flat[1] > 0.0 and flat[2] == 0.0
    np.testing.assert_allclose(flat[0], 1.0 / (2.0 * np.pi * (1.0 - np.cos(0.3))), rtol=1e-12)
    seen = il.measured_intensity([0.0, 0.06, 0.3, 0.31], 0.3, MEASURED)
    np.testing.assert_allclose(seen / seen[0], [1.0, 0.95, 0.05, 0.0], rtol=1e-12)
    # A narrow Gaussian beam has the paraxial peak 2/(πw²) (next order w²/12).
    np.testing.assert_allclose(il.gaussian_intensity(0.0, 1e-3), 2.0 / (np.pi * 1e-6), rtol=1e-6)
    # A measured table of a Gaussian is the Gaussian (cut at 3w: 1e-8; linear interpolation: (3/400)²/2 = 3e-5).
    grid = np.linspace(0.0, 0.3, 401)
    table = il.measured_intensity([0.0, 0.11, 0.2], 0.3, np.exp(-2.0 * (grid / 0.1) ** 2))
    np.testing.assert_allclose(table, il.gaussian_intensity([0.0, 0.11, 0.2], 0.1), rtol=5e-4)


def test_beam_offset() -> None:
    axis = il.beam_axis((0.1, -0.05))
    np.testing.assert_allclose(axis[:2] / axis[2], [np.tan(0.1), np.tan(-0.05) / np.cos(0.1)], rtol=1e-14)
    np.testing.assert_allclose(np.linalg.norm(axis), 1.0, rtol=1e-14)
    np.testing.assert_allclose(il.off_axis_angle([0.0, 0.0, 2.0], il.beam_axis((0.1, 0.0))), 0.1, rtol=1e-14)
    # Accurate near the axis, where acos(d·a) would give 0 or 1.5e-8.
    np.testing.assert_allclose(il.off_axis_angle([1e-10, 0.0, 1.0], [0.0, 0.0, 1.0]), 1e-10, rtol=1e-12)
    x = np.tan(np.linspace(-0.2, 0.2, 81))
    rays = np.stack(np.broadcast_arrays(x[None, :], x[:, None], 1.0), axis=-1)
    seen = il.gaussian_intensity(il.off_axis_angle(rays, axis), 0.1)
    row, col = np.unravel_index(np.argmax(seen), seen.shape)
    assert (row, col) == (30, 60)


def test_bad_beams() -> None:
    for bad in (0.0, -0.1, 2.0, float("nan")):
        with pytest.raises(ValueError, match="half_angle_rad"):
            il.gaussian_intensity(0.0, bad)
    with pytest.raises(ValueError, match="radial_value"):
        il.measured_intensity(0.0, 0.1, [1.0, -1.0])
    with pytest.raises(ValueError, match="radial_value"):
        il.beam_intensity("measured", 0.0, 0.1)
    with pytest.raises(ValueError, match="profile"):
        il.beam_intensity("top-hat", 0.0, 0.1)  # type: ignore[arg-type]


def test_eq7_to_eq11() -> None:
    x, y, r = np.array([0.0, 0.3, 1.0]), np.array([0.0, 0.4, 2.0]), 2.0
    radial = il.radial_distance_eq7(x, y, r)
    np.testing.assert_allclose(radial, [2.0, np.sqrt(4.25), 3.0], rtol=1e-14)
    # Eq. 8: r' = r exactly on the axis, and to ½(ρ/r)² beside it.
    assert il.orthogonal_suffices_eq8(0.0, 0.0, r, 0.0)
    np.testing.assert_array_equal(il.orthogonal_suffices_eq8([0.02, 0.3], [0.0, 0.0], r, 1e-4), [True, False])
    np.testing.assert_array_equal(
        il.orthogonal_suffices_eq8(1.0 / np.array([23.0, 22.0]), 0.0, 1.0, 1e-3), [True, False]
    )
    ratio = il.distortion_ratio_eq11(r, radial)
    np.testing.assert_allclose(ratio, np.cos(np.arctan(np.hypot(x, y) / r)), rtol=1e-14)
    np.testing.assert_allclose(il.orthogonal_distance_eq10(radial, ratio), r, rtol=1e-14)
    # Eq. 9 scales about the centre, and Eq. 10 is its case e = 0.
    np.testing.assert_allclose(il.distorted_point_eq9([3.0, 5.0], 1.0, 0.9), [2.8, 4.6], rtol=1e-14)
    assert il.distorted_point_eq9(1.0, 1.0, 0.3) == 1.0


@pytest.mark.parametrize("phi", [0.05, 0.2, 0.5])
def test_eq12_is_an_approximation(phi: float) -> None:
    x = np.linspace(0.0, 4.0, 4001)
    printed = il.diverging_angle_eq12(x, 0.75 * x, 4.0, 3.0, phi)
    true = il.diverging_angle_true(x, 0.75 * x, 4.0, 3.0, phi)
    # Right at the centre and at the corner, and too small between.
    assert printed[0] == true[0] == 0.0
    np.testing.assert_allclose([printed[-1], true[-1]], phi, rtol=1e-13)
    assert np.all(true[1:-1] > printed[1:-1])
    # atan(q tanφ) − qφ = q(1 − q²)φ³/3 + O(φ⁵): largest at q = 1/√3, 2φ³/(9√3); the next order is below φ² of it.
    worst = np.max(true - printed)
    np.testing.assert_allclose(worst, 2.0 * phi**3 / (9.0 * np.sqrt(3.0)), rtol=phi**2)
    # What it does to a range corrected by cosθ: sinθ·Δθ, below φ⁴/12 (2e-4 of the range at φ = 0.2).
    range_error = np.max(np.abs(np.cos(printed) / np.cos(true) - 1.0))
    assert 0.3 * phi**4 / 12.0 < range_error < 1.3 * phi**4 / 12.0


def test_eq13_and_its_exponent() -> None:
    np.testing.assert_allclose(il.distortion_ratio_eq13(2.0, 1.5, 4.0, 3.0, 0.4, 1.0), np.cos(0.2), rtol=1e-14)
    np.testing.assert_allclose(il.distortion_ratio_eq13(2.0, 1.5, 4.0, 3.0, 0.4, 2.0), np.cos(0.1), rtol=1e-14)
    ratio = il.distortion_ratio_eq13(np.linspace(0.0, 4.0, 50), 0.0, 4.0, 0.0, 0.4, 1.5)
    assert ratio[0] == 1.0 and np.all(np.diff(ratio) < 0.0)
    np.testing.assert_allclose(ratio[-1], np.cos(0.4), rtol=1e-14)
