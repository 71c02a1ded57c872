"""The sheet of light: unit integrals, widths, and means over pixels."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.integrate import quad

from beambench.optics.sheet import Sheet, angle_inside, gaussian_mean, meeting


def _sheet(profile: str) -> Sheet:
    return Sheet(np.array([0.1, 0.0, 0.0]), np.eye(3), 3e-4, 0.42, 1.65e-3, 0.35, profile)


@pytest.mark.parametrize("profile", ["flat-top", "gaussian"])
def test_the_fan_holds_all_power(profile: str) -> None:
    sheet = _sheet(profile)
    whole = quad(lambda a: float(sheet.fan_density(a)), -0.5 * np.pi, 0.5 * np.pi, points=[-0.35, 0.35], epsabs=1e-12)[
        0
    ]
    assert whole == pytest.approx(1.0, abs=1e-9)
    if profile == "gaussian":
        assert sheet.fan_density(0.35) == pytest.approx(np.exp(-2) * sheet.fan_density(0.0))


def test_the_width_is_a_millimetre_at_a_metre() -> None:
    """4 σ is the full width at 1/e²; far away it grows by the divergence."""
    sheet = _sheet("flat-top")
    assert 4 * sheet.sigma(1.0) == pytest.approx(1e-3, rel=0.01)
    assert 4 * (sheet.sigma(101.0) - sheet.sigma(100.0)) == pytest.approx(1.65e-3, rel=1e-4)
    assert 4 * sheet.sigma(0.42) == pytest.approx(3e-4)
    assert angle_inside(2.2e-3, 1.335) == pytest.approx(2.2e-3 / 1.335, rel=1e-6)


def test_offset_range_and_angle() -> None:
    sheet = _sheet("flat-top")
    point = np.array([[0.1 + 2e-3], [0.3], [0.4]])
    assert sheet.offset(point) == pytest.approx(2e-3) and sheet.fan_angle(point) == pytest.approx(np.arctan2(3, 4))
    assert sheet.range(point) == pytest.approx(0.5, rel=1e-4)
    met = meeting(np.zeros((3, 1)), np.array([[0.6], [0.0], [0.8]]), sheet.normal, sheet.source)
    assert met[:, 0] == pytest.approx([0.1, 0.0, 0.4 / 3])


def test_the_mean_over_an_interval() -> None:
    """Against quadrature; far out in a tail; over nothing; and whole lines of any width and place sum to one."""

    def g(u: float) -> float:
        return float(np.exp(-0.5 * (u / 0.3) ** 2) / 0.3 / np.sqrt(2 * np.pi))

    assert gaussian_mean(-0.2, 0.7, 0.3) == pytest.approx(quad(g, -0.2, 0.7)[0] / 0.9, rel=1e-12)
    assert gaussian_mean(0.7, -0.2, 0.3) == pytest.approx(gaussian_mean(-0.2, 0.7, 0.3))
    assert gaussian_mean(2.9, 3.0, 0.3) == pytest.approx(quad(g, 2.9, 3.0, epsabs=0)[0] / 0.1, rel=1e-6)
    assert gaussian_mean(0.1, 0.1, 0.3) == pytest.approx(g(0.1), rel=1e-12)
    edge = np.arange(-12, 13) - 0.5
    for s in (0.05, 0.3, 2.0):
        for c in (-0.5, 0.0, 0.21):
            assert gaussian_mean(edge[:-1] - c, edge[1:] - c, s).sum() == pytest.approx(1.0, abs=1e-6)
