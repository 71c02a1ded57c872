"""Calibration from a scan of delays: noise by moments of known distributions, widths and time zero by closed forms."""

from __future__ import annotations

import json
import math
from typing import Any

import numpy as np
import pytest

from beambench import InputError
from beambench.estimators.calibration.gated_delay_scan import DELAY_SCAN, delay_scan_values
from beambench.estimators.calibration.gated_noise import dark_statistics, noise_statistics
from beambench.estimators.calibration.gated_scan import DelayScan, read_scan, scan_half
from beambench.estimators.calibration.gated_widths import delays_before, fit_response, surveyed_delay, time_bound_s
from beambench.estimators.rig import DeclaredRig
from beambench.scenes.declared import declared_rig
from beambench.scenes.load import load_scene

SHAPE = (8, 8)
C = 299792458.0


def _rig(**changes: Any) -> DeclaredRig:
    """Pulse of 0.8 ns, gate of 1.5 ns with edges, as declared samples."""
    gate = {"kind": "trapezoidal", "width_s": 1.5e-9, "rise_s": 0.3e-9, "fall_s": 0.4e-9, "transmission": 1.0}
    values = {
        "rig.camera.rows": SHAPE[0], "rig.camera.cols": SHAPE[1], "rig.laser.pulse.fwhm_s": 0.8e-9, "rig.gates": [gate],
        "rig.ambient_e_per_s": 0.0, "rig.detector.dark_current_e_per_s": 0.0,
    } | changes  # fmt: skip
    data = declared_rig(load_scene("flat-wall", values))
    return DeclaredRig(json.dumps(data), data)


def _erf_response(
    u: np.ndarray[Any, Any], fwhm_s: float, width_s: float, rise_s: float, fall_s: float
) -> np.ndarray[Any, Any]:
    """R of a Gaussian pulse and a trapezoidal gate, by its closed form: the gate is a difference of two ramps, each the
    integral of a step over its edge, and a Gaussian blurs a step into Φ. Shares nothing with the samples that the fit
    reads."""
    from scipy.special import erf

    s = fwhm_s / math.sqrt(8 * math.log(2))

    def ramp(x: np.ndarray[Any, Any]) -> np.ndarray[Any, Any]:  # ∫ Φ((x − t)/s) dt
        return np.asarray(
            0.5 * x * (1 + erf(x / (s * math.sqrt(2)))) + s / math.sqrt(2 * math.pi) * np.exp(-0.5 * (x / s) ** 2)
        )

    rising = (ramp(u + rise_s / 2) - ramp(u - rise_s / 2)) / rise_s
    falling = (ramp(u - width_s + fall_s / 2) - ramp(u - width_s - fall_s / 2)) / fall_s
    return rising - falling


def _scan(
    seed: int, *, light: float = 60.0, gain: float = 1.03, read: float = 2.0, f2: float = 1.0,
    stretch: tuple[float, float] = (1, 1),
    shift_s: float = 0.0, repeats: int = 40, dark: int = 60, vary: float = 0.0, **changes: Any,
) -> tuple[DelayScan, np.ndarray[Any, Any]]:  # fmt: skip
    """A scan drawn by NumPy from the closed form: Poisson numbers of gamma pulses, read noise, rounding."""
    rng = np.random.default_rng(seed)
    range_m = np.linspace(4.95, 5.05, SHAPE[0] * SHAPE[1])
    rig = _rig(**changes)
    n_g = rig.number("medium.group_index")
    tau = 2 * range_m * n_g / C
    delay = tau.mean() - 2.4e-9 + 0.15e-9 * np.arange(28)
    u = tau + shift_s - delay[:, None]
    p, g = stretch
    mean = light * _erf_response(u, 0.8e-9 * p, 1.5e-9 * g, 0.3e-9 * g, 0.4e-9 * g)
    energy = 1.0 + vary * rng.standard_normal((28, repeats, 1))
    n = rng.poisson(mean[:, None, :] * energy).astype(float)
    if f2 > 1:
        shape = n / (f2 - 1)
        n = np.where(n > 0, rng.standard_gamma(np.where(n > 0, shape, 1.0)) * (f2 - 1), 0.0)
    counts = np.floor(100.5 + gain * (n + read * rng.standard_normal(n.shape)))
    off = np.floor(100.5 + gain * read * rng.standard_normal((dark, mean.shape[1])))
    return DelayScan(counts, off, delay, SHAPE, rig), range_m.reshape(SHAPE)


def test_photon_transfer_finds_gain_excess_noise_and_read_noise() -> None:
    """Over twelve draws: means within four standard errors of the mean, and scatters that the stated errors tell."""
    found = [noise_statistics(_scan(seed, f2=1.8, light=25.0)[0]) for seed in range(12)]
    for name, true in (("slope", 1.03 * 1.8), ("excess", 1.8)):
        values = np.array([one[name].value for one in found])
        stated = np.array([one[name].sigma for one in found])
        assert abs(values.mean() - true) < 4 * stated.mean() / math.sqrt(12), name
        assert 0.5 < values.std(ddof=1) / stated.mean() < 2.0, name
    dark = dark_statistics(_scan(3)[0])
    assert dark["noise"].value == pytest.approx(math.sqrt((1.03 * 2.0) ** 2 + 1 / 12), abs=4 * dark["noise"].sigma)
    assert dark["level"].value == pytest.approx(100.0, abs=4 * 2.06 / math.sqrt(60 * 64))


def test_a_laser_that_varies_does_not_pass_for_gain() -> None:
    """3 % of 400 electrons are 12, whose square would raise the variance by a third; the frame's mean takes it out."""
    still, varied = (noise_statistics(_scan(5, light=400.0, vary=vary)[0]) for vary in (0.0, 0.03))
    assert varied["slope"].value == pytest.approx(still["slope"].value, rel=0.02)
    assert varied["fluctuation"].value == pytest.approx(0.03, rel=0.15)
    assert abs(still["fluctuation"].value) < 0.004


@pytest.mark.parametrize(("stretch", "shift_s"), [((1.05, 1.0), 20e-12), ((0.96, 1.03), -35e-12)])
def test_pulse_gate_and_time_zero_are_found(stretch: tuple[float, float], shift_s: float) -> None:
    """Against the closed form, with a surveyed target; four standard errors, and 0.2 % for samples that are linear between."""
    scan, range_m = _scan(7, light=300.0, stretch=stretch, shift_s=shift_s)
    fit = fit_response(scan, known_s=surveyed_delay(scan, range_m))
    for one, true in ((fit.pulse, stretch[0]), (fit.gate, stretch[1])):
        assert one.sigma < 0.01
        assert one.value == pytest.approx(true, abs=4 * one.sigma + 2e-3)
    assert fit.shift_s.value == pytest.approx(shift_s, abs=4 * fit.shift_s.sigma + 0.5e-12)
    assert float(np.mean(fit.chi2)) / fit.dof == pytest.approx(1.0, abs=0.15)


def test_time_zero_goes_into_the_rig_with_its_sign() -> None:
    """An echo that seems 20 ps later than surveyed means gates that open 20 ps earlier than stated."""
    scan, range_m = _scan(8, light=300.0, shift_s=20e-12)
    values = delay_scan_values(scan, range_m)
    assert values.numbers["rig.t0_s"].value == pytest.approx(-20e-12, abs=2e-12)
    assert "rig.t0_s" not in delay_scan_values(scan).numbers


def test_the_bound_of_time_is_that_of_a_bright_gaussian_echo() -> None:
    """At N photoelectrons in all and a dense scan, σ = 1/√(Σ (a R')²/V): checked by direct sums of the closed form's
    differences."""
    scan, range_m = _scan(9, light=300.0)
    fit = fit_response(scan, known_s=surveyed_delay(scan, range_m))
    bound = time_bound_s(scan, fit)
    tau = surveyed_delay(scan, range_m)
    shape = lambda t: 300.0 * _erf_response(t - scan.delay_s[:, None], 0.8e-9, 1.5e-9, 0.3e-9, 0.4e-9)  # noqa: E731
    r, d = shape(tau), (shape(tau + 1e-12) - shape(tau - 1e-12)) / 2e-12
    w = 1.03**2 / (1.03**2 * (4.0 + r) + 1 / 12)
    f00, f01, f11 = (w * d * d).sum(0), (w * d * r).sum(0), (w * r * r).sum(0)
    assert np.median(bound / (1 / np.sqrt(f00 - f01**2 / f11))) == pytest.approx(1.0, abs=0.03)


def test_delays_before_the_echo_are_those_whose_gate_has_closed() -> None:
    scan, range_m = _scan(10)
    tau = surveyed_delay(scan, range_m)
    assert not delays_before(scan, tau).any()
    early = DelayScan(scan.counts, scan.dark, scan.delay_s - 6e-9, scan.shape, scan.rig)
    assert delays_before(early, tau).any()


def test_halves_share_no_frame_and_short_recordings_are_refused() -> None:
    scan, _ = _scan(11, repeats=7, dark=5)
    halves = [scan_half(scan, number) for number in (0, 1)]
    assert [half.repeats for half in halves] == [3, 3]
    assert np.array_equal(halves[1].counts[:, 0], scan.counts[:, 1])
    with pytest.raises(InputError, match="two halves"):
        scan_half(DelayScan(scan.counts[:, :4], scan.dark, scan.delay_s, scan.shape, scan.rig), 0)


def test_the_procedure_says_what_a_capture_lacks() -> None:
    from beambench.captures import make_capture

    rig = _rig()
    coords = {"delay": np.arange(4) * 1e-10, "gate": 0, "laser_on": True, "valid": True, "time": np.arange(4.0)}
    counts = np.full((4, *SHAPE), 100, np.uint16)
    capture = make_capture("gated", {"counts": counts}, coords, {}, {"rig": rig.values, "truth_kind": "none"})
    assert "repeats" in DELAY_SCAN.lacking([capture]) or "few frames" in DELAY_SCAN.lacking([capture])
    with pytest.raises(InputError, match="few frames"):
        read_scan(capture)
