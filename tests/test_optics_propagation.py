"""Propagation and flow: energy, Gaussian beams, Talbot's contrast, scintillation behind a layer, frozen flow, the table of
flows."""

from __future__ import annotations

import numpy as np
import pytest

from beambench.optics.turbulence.flow import TABLE_R0_M, frozen_flow, table_r0_m
from beambench.optics.turbulence.propagation import (
    angular_spectrum,
    fresnel_scale_m,
    guard_band,
    scintillation_index,
    split_step,
    thin_layer_scintillation,
    transfer_function,
)
from beambench.optics.turbulence.screens import kolmogorov_plan, kolmogorov_screen
from beambench.optics.turbulence.strength import r0_from_cn2_m, rytov_variance

WATER = 532e-9 / 1.335


def test_a_gaussian_beam() -> None:
    """Amplitude and phase at 2 m against the closed form of the paraxial beam; non-paraxial terms are below 1e-6 here."""
    h, n, waist, z = 50e-6, 256, 1.2e-3, 2.0
    x = h * (np.arange(n) - n // 2)
    r2 = x[None, :] ** 2 + x[:, None] ** 2
    got = angular_spectrum(np.exp(-r2 / waist**2), h, WATER, z)
    q = 1 + 1j * z * WATER / (np.pi * waist**2)
    want = np.exp(-r2 / (waist**2 * q)) / q
    assert np.abs(got - want).max() < 1e-5
    back = angular_spectrum(got, h, WATER, -z)
    assert np.abs(back - np.exp(-r2 / waist**2)).max() < 1e-12


def test_energy_is_kept_and_steps_add() -> None:
    rng = np.random.default_rng(3)
    field = rng.standard_normal((64, 48)) + 1j * rng.standard_normal((64, 48))
    screens = [rng.standard_normal((64, 48)) for _ in range(3)]
    out = split_step(field, [(0.5, screens[0]), (0.5, screens[1]), (0.7, screens[2])], 1e-4, WATER)
    assert (np.abs(out) ** 2).sum() == pytest.approx((np.abs(field) ** 2).sum(), rel=1e-12)
    two = split_step(field, [(0.5, None), (0.25, None)], 1e-4, WATER)
    assert two == pytest.approx(angular_spectrum(field, 1e-4, WATER, 0.75), abs=1e-11)
    assert split_step(field, [(0.0, screens[0])], 1e-4, WATER) == pytest.approx(field * np.exp(1j * screens[0]))
    assert not transfer_function((8, 8), 0.4 * WATER, WATER, 1.0)[4, 4]  # evanescent


def test_the_contrast_of_a_weak_grating() -> None:
    """Phase a·cos 2πfx gives the irradiance 1 + 2a sin(πλzf²) cos 2πfx; a² terms are below 1e-4 of it."""
    h, n, a = 1e-4, 256, 1e-4
    x = h * np.arange(n)
    for cycles, z in ((8, 1.0), (20, 4.0), (31, 0.3)):
        f = cycles / (n * h)
        phase = np.broadcast_to(a * np.cos(2 * np.pi * f * x), (4, n))
        out = split_step(np.ones((4, n)), [(0.0, phase), (z, None)], h, WATER)
        seen = 2 * (np.abs(out[0]) ** 2 * np.cos(2 * np.pi * f * x)).mean()
        assert seen == pytest.approx(2 * a * np.sin(np.pi * WATER * z * f * f), rel=1e-3, abs=1e-8)


def test_scintillation_behind_a_layer() -> None:
    """Sixteen weak layers, irradiance in the middle half: within 4 standard errors plus 3 % for the grid's finite band."""
    h, n, z, r0 = 1.2e-4, 256, 4.0, 0.015
    want = thin_layer_scintillation(r0, z, WATER)
    guard = guard_band((n, n), 0.15)
    rng = np.random.default_rng(9)
    found = []
    for _ in range(16):
        out = split_step(guard, [(0.0, kolmogorov_screen(r0, (n, n), h, rng)), (z, None)], h, WATER)
        plain = split_step(guard, [(z, None)], h, WATER)
        ratio = (np.abs(out) ** 2 / np.abs(plain) ** 2)[64:192, 64:192]
        found.append(np.log(ratio).var())
    mean, error = np.mean(found), np.std(found, ddof=1) / 4
    assert abs(mean - want) < 4 * error + 0.03 * want and error < 0.1 * want
    assert scintillation_index(ratio) == pytest.approx(np.exp(found[-1]) - 1, rel=0.2)


def test_a_path_is_made_of_layers() -> None:
    """Rytov's variance of a path equals the sum over 2,000 thin layers."""
    k = 2 * np.pi / 532e-9
    z = 4.0 * (np.arange(2000) + 0.5) / 2000
    r0 = r0_from_cn2_m(1e-13, 4.0 / 2000, 532e-9)
    total = sum(thin_layer_scintillation(r0, float(a), WATER) for a in z)
    assert total == pytest.approx(rytov_variance(1e-13, 4.0, 532e-9, 1.335), rel=1e-3)
    assert fresnel_scale_m(4.0, 532e-9, 1.335) == pytest.approx(1.26e-3, abs=5e-6) and k > 0


def test_frozen_flow() -> None:
    """Whole points: frames are the same screen, moved with the flow, and D between frames is that of the displaced points."""
    h = 1e-4
    flow = frozen_flow(lambda s: kolmogorov_plan(0.01, s, h), (24, 20), (0.02, -0.01), 0.06, np.random.default_rng(1))
    first, later = flow.frame(0.0), flow.frame(0.05)  # moved by 10 columns right, 5 rows up
    assert later[:-5, 10:] == pytest.approx(first[5:, :-10], abs=1e-9)
    half = flow.frame(0.0525)
    apart = np.sqrt(((half[:-5, 10:] - first[5:, :-10]) ** 2).mean())
    assert 0.5 < apart / np.sqrt(6.88388 * (0.0025 * np.hypot(0.02, 0.01) / 0.01) ** (5 / 3)) < 2
    assert flow.frame(0.06).shape == (24, 20)
    with pytest.raises(ValueError, match="time_s"):
        flow.frame(0.061)
    with pytest.raises(ValueError, match="duration_s"):
        frozen_flow(lambda s: kolmogorov_plan(0.01, s, h), (4, 4), (0.0, 0.0), -1.0, np.random.default_rng(1))


def test_points_between_points() -> None:
    """D between a frame and one moved by 2.5 points, over 400 flows: within 4 standard errors of the lag's theory plus 2 %."""
    h, rng = 1e-4, np.random.default_rng(4)
    plans: dict[tuple[int, int], object] = {}

    def plan_of(shape: tuple[int, int]) -> object:
        return plans.setdefault(shape, kolmogorov_plan(0.01, shape, h))

    found = []
    for _ in range(400):
        flow = frozen_flow(plan_of, (8, 8), (0.025, 0.0), 0.01, rng)  # type: ignore[arg-type]
        found.append(((flow.frame(0.01) - flow.frame(0.0)) ** 2).mean())
    want = 6.88388 * (2.5e-4 / 0.01) ** (5 / 3)
    assert abs(np.mean(found) - want) < 4 * np.std(found) / 20 + 0.02 * want


def test_the_table_of_flows() -> None:
    """Rising strength with flow and toward the inlet, and no turbulence without flow or path."""
    strength = TABLE_R0_M ** (-5 / 3)
    assert (np.diff(strength, axis=0)[:, 1:] > 0).all() and (np.diff(strength, axis=1) > 0).all()
    assert table_r0_m([10, 40, 0, 25], [4, 1, 3, 0]) == pytest.approx([3.0e-3, 5.0e-3, np.inf, np.inf])
    assert 1.5e-3 < table_r0_m(25, 4) < 2.0e-3
    with pytest.raises(ValueError, match="table"):
        table_r0_m(41, 1)
