"""Weighted averages and maxima: closed-form bias, the printed model, speed against a copy."""

from __future__ import annotations

import numpy as np
import pytest

from beambench.benchmarks.written.gated_stack import GaussianRig, stack_capture
from beambench.estimators import run_estimator
from beambench.optics.constants import C_M_PER_S
from beambench.scenes.errors import InputError

HALF_C = C_M_PER_S / 2


def _random(rig: GaussianRig, signal_e: float, background_e: float, seed: int = 1, shape: tuple[int, int] = (60, 80)):  # type: ignore[no-untyped-def]
    rng = np.random.default_rng(seed)
    tau = rng.uniform(rig.delay_s[14], rig.delay_s[-14], shape) + rig.centre_s
    return tau, rng.poisson(rig.electrons(tau, signal_e, background_e)).astype(np.uint16)


@pytest.mark.parametrize("background_e", [0.0, 1.0, 30.0])
def test_weighted_average_bias_is_its_closed_form(background_e: float) -> None:
    rig = GaussianRig(offset_dn=50.0)
    tau = np.linspace(rig.delay_s[14], rig.delay_s[-14], 400).reshape(20, 20) + rig.centre_s
    counts = (50.0 + rig.electrons(tau, 1e4, background_e)).astype(np.float32)
    found = run_estimator("weighted-average", stack_capture(rig, counts))["range"].values
    total = rig.slices * background_e
    middle = rig.delay_s.mean() + rig.centre_s
    bias = (middle - tau) * total / (1e4 + total) * HALF_C
    # Float32 counts carry 6e-8 of 64 samples of a 16 ns window; the ends of R (4.8 σ) cut 1e-6 of the echo.
    assert np.abs(found - tau * HALF_C - bias).max() < 2e-6


def test_integer_and_general_paths_agree() -> None:
    rig = GaussianRig(offset_dn=10.0, slices=150)
    _tau, counts = _random(rig, 5e3, 3.0)
    counts[:, 0, 0] = 65000
    for label in ("weighted-average", "weighted-average[background=min]", "weighted-average[background=outside]"):
        fast = run_estimator(label, stack_capture(rig, counts))
        slow = run_estimator(label, stack_capture(rig, np.asfortranarray(counts)))
        for name in ("range", "sigma"):
            np.testing.assert_allclose(fast[name], slow[name], rtol=1e-9)
        assert (fast["valid"].values == slow["valid"].values).all()


def test_stated_sigmas_are_true() -> None:
    # 4,800 trials: a standard error of z_rms of 1 %. Four of them for propagated sigmas; `peak` has a uniform error and
    # a bound for its wander: its sigma may be too large by a third, never too small by more than a tenth.
    rig = GaussianRig(gain_dn_per_e=4.0)
    for background, label, low, high in (
        (0.0, "weighted-average", 0.96, 1.04),
        (5.0, "weighted-average[background=outside]", 0.93, 1.07),
        (5.0, "radiometric-average", 0.96, 1.04),
        (5.0, "parabola", 0.9, 1.1),
        (5.0, "log-gaussian", 0.9, 1.1),
        (5.0, "peak", 0.75, 1.1),
    ):
        tau, electrons = _random(rig, 2e4, background, seed=7)
        result = run_estimator(label, stack_capture(rig, (4 * electrons).astype(np.uint16)))
        valid = result["valid"].values
        assert valid.mean() > 0.999, label
        error = (result["range"].values - tau * HALF_C)[valid]
        z = np.sqrt(np.mean((error / result["sigma"].values[valid]) ** 2))
        assert low < z < high, (label, z)


def test_background_from_laser_off_slices() -> None:
    rig = GaussianRig()
    tau, counts = _random(rig, 2e4, 20.0)
    rng = np.random.default_rng(8)
    capture = stack_capture(rig, counts)
    off = capture.isel(slice=slice(0, 16)).copy(deep=True)
    off["counts"].values[:] = rng.poisson(20.0, off["counts"].shape)
    off["laser_on"].values[:] = False
    import xarray as xr

    both = xr.concat([capture, off], dim="slice", data_vars="minimal", combine_attrs="override")
    for label in ("weighted-average[background=off-slices]", "poisson-ml"):
        result = run_estimator(label, both)
        error = (result["range"].values - tau * HALF_C)[result["valid"].values]
        z = np.sqrt(np.mean((error / result["sigma"].values[result["valid"].values]) ** 2))
        # 4,800 trials, ±1 % a standard error.
        assert abs(z - 1) < 0.05, label
        assert abs(error.mean()) < 5 * error.std() / np.sqrt(error.size)


def test_the_printed_reflection_cancels() -> None:
    rig = GaussianRig()
    _tau, counts = _random(rig, 1e4, 2.0, shape=(16, 20))
    capture = stack_capture(rig, counts)
    rng = np.random.default_rng(2)
    plain = run_estimator("chua-2017[diffusivity=0]", capture)["range"].values
    for _ in range(25):
        k_s, k_d, slope, m = rng.uniform(0, 5), rng.uniform(0.01, 2), rng.uniform(0.05, 2), rng.uniform(0, 9)
        label = f"chua-2017[k_s={k_s!r},k_d={k_d!r},slope={slope!r},diffusivity={m!r}]"
        # 64 products and sums of positive terms: 64 units in the last place, with room for both sums.
        np.testing.assert_allclose(run_estimator(label, capture)["range"].values, plain, rtol=3e-14)


def test_the_printed_model_and_its_companion_differ_by_the_cosine() -> None:
    rig = GaussianRig(slices=64)
    tau = np.full((21, 31), rig.delay_s.mean() + rig.centre_s)
    counts = rig.electrons(tau, 1e4, 0.0).astype(np.float32)
    capture = stack_capture(rig, counts)
    x, y = np.meshgrid(np.arange(31) - 15.0, np.arange(21) - 10.0)
    # The declared beam's half angle of .2 belongs to its own edge, 1000 px·tan .2 from the axis: far beyond this array.
    cos = np.cos(np.hypot(x, y) / (1000 * np.tan(0.2)) * 0.2)
    ray = 1 / np.sqrt(1 + (x**2 + y**2) * 1e-6)
    # r³/r² moves the mean: Σ w t³/Σ w t² = τ(1 + 3σ²/τ²)/(1 + σ²/τ²) for a symmetric echo of variance σ².
    spread = (rig.sigma_s / tau) ** 2
    expected = tau * HALF_C * (1 + 3 * spread) / (1 + spread)
    printed = run_estimator("chua-2017", capture)["range"].values
    other = run_estimator("chua-2017-orthogonal", capture)["range"].values
    # Sampling at 2.4 steps per σ is exact to 1e-12; the declared samples widen R by 1e-4 of its width, float32 6e-8.
    np.testing.assert_allclose(printed, expected / cos, rtol=2e-7)
    np.testing.assert_allclose(other, expected * cos / ray, rtol=2e-7)
    # A given angle is that of the corner, for any beam.
    corner = np.cos(np.hypot(x, y) / np.hypot(15, 10) * 0.3)
    given = run_estimator("chua-2017[phi=0.3]", capture)["range"].values
    np.testing.assert_allclose(given, expected / corner, rtol=2e-7)


def test_the_model_s_angle_is_the_ray_s_where_the_beam_fills_the_field() -> None:
    # Eq. 12 is linear in ρ and tan is not: with the cone's edge at f·tan φ the model's angle exceeds the ray's by at most
    # φ − arctan(ρ tan φ/ρ_max) ... < φ³/(9√3)·2 to third order, .3 mrad at φ = .1, and agrees at the centre and the edge.
    from beambench.estimators.gated.chua_2017 import model_angle
    from beambench.estimators.gated.tools.stack import read_stack

    shape = (201, 3)
    rig = GaussianRig(slices=4)
    for phi in (0.1, 0.3):
        declared = rig.declared(*shape)
        declared["laser"]["half_angle_rad"] = phi
        seen = read_stack(stack_capture(rig, np.zeros((4, *shape), np.uint16), declared)).instrument
        angle = model_angle(seen, 1.0, None)
        true = np.arccos(seen.rays()[..., 2])
        assert np.abs(angle - true).max() < 2 * phi**3 / (9 * np.sqrt(3)) * 1.1
        # The array ends within the beam: its corner is at its own angle, not at the beam's.
        assert angle.max() < 0.102 < phi + 0.01
        assert model_angle(seen, 1.0, phi).max() == pytest.approx(phi)
        assert (model_angle(seen, 1.0, 3.0) <= np.pi / 2).all()


@pytest.mark.parametrize("label", ["weighted-average", "weighted-average[background=off-slices]", "parabola",
                                   "log-gaussian", "radiometric-average", "gaussian-least-squares"])  # fmt: skip
def test_slices_of_unequal_pulses(label: str) -> None:
    # Shot noise goes as 1/pulses, read noise as 1/pulses²: 2,000 pixels give z_rms within 1.6 % a standard error; four,
    # and .1 for the table of the vertex. A level that is subtracted grows with the pulses too: four standard errors.
    rig = GaussianRig(slices=48, step_s=0.4e-9, read_noise_e=3.0, offset_dn=100.0, gain_dn_per_e=10.0)
    rng = np.random.default_rng(2)
    shape = (40, 50)
    tau = rng.uniform(rig.delay_s[12], rig.delay_s[27], shape) + rig.centre_s
    background = 5.0 if label != "weighted-average" else 0.0
    for pulses in (np.full(48, 4), np.linspace(1, 6, 48).round()):
        mean = rig.electrons(tau, 3e3, background)
        mean[-8:] = background
        y = rng.poisson(mean * pulses[:, None, None]) + 3 * rng.normal(size=mean.shape)
        capture = stack_capture(rig, np.rint(100 + 10 * y).clip(0, 65535).astype(np.uint16))
        capture["pulses"].values[:] = pulses
        capture["laser_on"].values[-8:] = False
        result = run_estimator(label, capture)
        valid = result["valid"].values
        assert valid.mean() > 0.999
        error = (result["range"].values - tau * HALF_C)[valid]
        z = np.sqrt(np.mean((error / result["sigma"].values[valid]) ** 2))
        room = 0.1 if label in ("parabola", "log-gaussian") else 0.064
        # Subtracting the laser-off mean: noise of one mean for all slices, whose share is overstated for read noise.
        low = 0.85 if "off-slices" in label else 1 - room
        assert low < z < 1 + room, (z, pulses[0])
        assert abs(error.mean()) < 4 * error.std() / np.sqrt(error.size)


def test_light_counts_as_light_however_it_is_repeated() -> None:
    # 200 photoelectrons in all: the same light in one, 4 or 16 frames is seen alike, summed or averaged.
    rig = GaussianRig(slices=40, step_s=0.4e-9, offset_dn=100.0, gain_dn_per_e=10.0)
    import xarray as xr

    shape = (20, 25)
    rng = np.random.default_rng(1)
    tau = rng.uniform(rig.delay_s[12], rig.delay_s[-12], shape) + rig.centre_s
    for repeats in (1, 4, 16):
        declared = rig.declared(*shape)
        declared["detector"]["read_noise_e"] = 3.0 / np.sqrt(repeats)
        mean = np.repeat(rig.electrons(tau, 200.0 / repeats, 0.0)[None], repeats, axis=0)
        y = rng.poisson(mean) + 3.0 / np.sqrt(repeats) * rng.normal(size=mean.shape)
        counts = np.rint(100 + 10 * y).clip(0, 65535).astype(np.uint16)
        captures = [stack_capture(rig, one, declared) for one in counts]
        summed = xr.concat(captures, dim="slice", data_vars="minimal", combine_attrs="override")
        averaged = stack_capture(rig, counts.mean(axis=0).astype(np.float32), declared)
        averaged.attrs["averaged"] = repeats
        for capture in (summed, averaged):
            result = run_estimator("weighted-average", capture)
            # Read noise 3 e in 40 slices: 19 e against 200, which is 8 standard errors of the sum.
            assert result["valid"].values.mean() > 0.99, repeats
            error = (result["range"].values - tau * HALF_C)[result["valid"].values]
            z = np.sqrt(np.mean((error / result["sigma"].values[result["valid"].values]) ** 2))
            # 500 pixels: a standard error of 3 %; the quotient by a noisy sum is not quite normal.
            assert 0.85 < z < 1.15


def test_a_published_name_is_kept_for_the_published_estimator() -> None:
    """Ours is not that of Chua et al. 2016, whose weights are not known: the name is refused, and ours is named instead."""
    from beambench.estimators import list_estimators

    assert "chua-2016" not in list_estimators() and "radiometric-average" in list_estimators()
    with pytest.raises(InputError, match=r"11:16015\) is not built") as caught:
        run_estimator(
            "chua-2016[k_d=0.3]", stack_capture(GaussianRig(), np.zeros((GaussianRig().slices, 2, 2), np.uint16))
        )
    assert "did you mean radiometric-average" in str(caught.value)


def test_reflection_acts_in_the_radiometric_variant() -> None:
    rig = GaussianRig()
    _tau, counts = _random(rig, 1e4, 10.0)
    capture = stack_capture(rig, counts)
    bright = run_estimator("radiometric-average[k_d=0.3]", capture)
    dark = run_estimator("radiometric-average[k_d=1e-9]", capture)
    assert not np.allclose(bright["range"], dark["range"], rtol=1e-9, equal_nan=True)


def test_bistatic_range_solves_the_path() -> None:
    rig = GaussianRig(laser_m=(0.4, -0.1, 0.05), group_index=1.33)
    rng = np.random.default_rng(6)
    rows, cols = 12, 16
    x, y = np.meshgrid((np.arange(cols) - 7.5) / 1000, (np.arange(rows) - 5.5) / 1000)
    ray = np.stack([x, y, np.ones_like(x)], axis=-1)
    ray /= np.linalg.norm(ray, axis=-1, keepdims=True)
    truth = rng.uniform(4.5, 4.9, (rows, cols))
    path = truth + np.linalg.norm(ray * truth[..., None] - np.array(rig.laser_m), axis=-1)
    tau = path * rig.group_index / C_M_PER_S
    assert rig.delay_s[12] + rig.centre_s < tau.min() and tau.max() < rig.delay_s[-12] + rig.centre_s
    counts = rig.electrons(tau, 1e4, 0.0).astype(np.float32)
    for label in ("weighted-average", "poisson-ml"):
        found = run_estimator(label, stack_capture(rig, counts))["range"].values
        # poisson-ml stops at a few hundredths of sigma (1e-5 m); the average is exact to the float32 counts.
        np.testing.assert_allclose(found, truth, atol=3e-5)


def test_gate_map_is_taken_out() -> None:
    rig = GaussianRig()
    shape = (20, 24)
    declared = rig.declared(*shape)
    declared["gate_offset_s"] = {"iris_s": 0.3e-9, "skew_s": [0.2e-9, -0.1e-9]}
    x, y = np.meshgrid((np.arange(24) - 11.5) / 12, (np.arange(20) - 9.5) / 10)
    rho2 = ((x * 12) ** 2 + (y * 10) ** 2) / (12**2 + 10**2)
    offset = 0.3e-9 * rho2 + 0.2e-9 * x - 0.1e-9 * y
    tau = np.full(shape, rig.delay_s.mean() + rig.centre_s)
    # R_pixel(u) = R(u − offset).
    counts = rig.electrons(tau - offset, 1e4, 0.0).astype(np.float32)
    for label in ("weighted-average", "poisson-ml", "radiometric-average"):
        found = run_estimator(label, stack_capture(rig, counts, declared))["range"].values
        np.testing.assert_allclose(found, tau * HALF_C, atol=3e-5)


def test_weighted_average_is_near_the_speed_of_a_copy() -> None:
    from beambench.benchmarks.peers.copyto import compare

    # The best of three, so that a busy machine does not fail what is a property of the code: 1.5 where it is idle.
    assert min(compare(rounds=9)["ratio"] for _ in range(3)) <= 2.0


def test_poisson_ml_is_hundreds_of_times_faster_than_curve_fit() -> None:
    pytest.importorskip("scipy")
    from beambench.benchmarks.peers.curve_fit import compare

    found = max((compare(peer_pixels=120) for _ in range(2)), key=lambda f: f["ratio"])
    # README: 538-640 on an idle machine. Beside other work both sides scatter by a factor of two, hence the low floor.
    assert found["ratio"] >= 200
    # Same answer quality on 120 pixels: an efficiency has a standard error of 13 % there.
    assert found["poisson_ml_efficiency"] > 0.6 and found["valid"] > 0.999


@pytest.mark.parametrize(("name", "factor"), [("chua-2017", 1 / np.cos(0.2)), ("chua-2017-orthogonal", np.cos(0.2))])
def test_printed_corrections_scale_a_shift_by_the_angle(name: str, factor: float) -> None:
    rig = GaussianRig(offset_dn=20.0, gain_dn_per_e=2.0, read_noise_e=1.0)
    rng = np.random.default_rng(11)
    shape, shift = (9, 40), 0.4321e-9
    tau = rng.uniform(rig.delay_s[14], rig.delay_s[-14], shape) + rig.centre_s
    electrons = rng.poisson(rig.electrons(tau, 5e3, 3.0)) + rng.normal(size=(rig.slices, *shape))
    capture = stack_capture(rig, np.round(20 + 2 * electrons).clip(0, 65535).astype(np.uint16))
    before = run_estimator(name, capture)
    after = run_estimator(name, capture.assign_coords(delay=capture["delay"] + shift))
    assert (before["valid"] == after["valid"]).all() and before["valid"].values.any()
    moved = (after["range"] - before["range"]).values[before["valid"].values]
    low, high = sorted((1.0, factor))
    # The printed model's r³/r² depends on r: 2σ²/r changes by 2σ²Δ/r². A background across the window weighs in r²: allow
    # 2 % of the shift.
    exact = shift * C_M_PER_S / 2
    assert (moved >= 0.98 * low * exact).all() and (moved <= 1.02 * high * exact).all()
