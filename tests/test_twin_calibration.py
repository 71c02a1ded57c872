"""Calibration from a scan of delays: noise by moments of known distributions, widths and time zero by closed forms."""

from __future__ import annotations

import math

import numpy as np
import pytest

from beambench import InputError
from beambench.estimators.calibration.gated_delay_scan import DELAY_SCAN, delay_scan_values
from beambench.estimators.calibration.gated_noise import dark_statistics, noise_statistics
from beambench.estimators.calibration.gated_scan import DelayScan, read_scan, scan_half
from beambench.estimators.calibration.gated_survey import surveyed_delay
from beambench.estimators.calibration.gated_widths import delays_before, fit_response, time_bound_s

from ._delay_scans import SHAPE, delay_scan, erf_response, scan_rig


def test_photon_transfer_finds_gain_excess_noise_and_read_noise() -> None:
    """Over twelve draws: means within four standard errors of the mean, and scatters that the stated errors tell."""
    found = [noise_statistics(delay_scan(seed, f2=1.8, light=25.0)[0]) for seed in range(12)]
    for name, true in (("slope", 1.03 * 1.8), ("excess", 1.8)):
        values = np.array([one[name].value for one in found])
        stated = np.array([one[name].sigma for one in found])
        assert abs(values.mean() - true) < 4 * stated.mean() / math.sqrt(12), name
        assert 0.5 < values.std(ddof=1) / stated.mean() < 2.0, name
    dark = dark_statistics(delay_scan(3)[0])
    assert dark["noise"].value == pytest.approx(math.sqrt((1.03 * 2.0) ** 2 + 1 / 12), abs=4 * dark["noise"].sigma)
    assert dark["level"].value == pytest.approx(100.0, abs=4 * 2.06 / math.sqrt(60 * 64))


def test_a_laser_that_varies_does_not_pass_for_gain() -> None:
    """3 % of 400 electrons are 12, whose square would raise the variance by a third; the frame's mean takes it out."""
    still, varied = (noise_statistics(delay_scan(5, light=400.0, vary=vary)[0]) for vary in (0.0, 0.03))
    assert varied["slope"].value == pytest.approx(still["slope"].value, rel=0.02)
    assert varied["fluctuation"].value == pytest.approx(0.03, rel=0.15)
    assert abs(still["fluctuation"].value) < 0.004


@pytest.mark.parametrize(("stretch", "shift_s"), [((1.05, 1.0), 20e-12), ((0.96, 1.03), -35e-12)])
def test_pulse_gate_and_time_zero_are_found(stretch: tuple[float, float], shift_s: float) -> None:
    """Against the closed form, with a surveyed target; four standard errors, and 0.2 % for samples that are linear between."""
    scan, range_m = delay_scan(7, light=300.0, stretch=stretch, shift_s=shift_s)
    fit = fit_response(scan, known_s=surveyed_delay(scan, range_m))
    for one, true in ((fit.pulse, stretch[0]), (fit.gate, stretch[1])):
        assert one.sigma < 0.01
        assert one.value == pytest.approx(true, abs=4 * one.sigma + 2e-3)
    assert fit.shift_s.value == pytest.approx(shift_s, abs=4 * fit.shift_s.sigma + 0.5e-12)
    assert float(np.mean(fit.chi2)) / fit.dof == pytest.approx(1.0, abs=0.15)


def test_time_zero_goes_into_the_rig_with_its_sign() -> None:
    """An echo that seems 20 ps later than surveyed means gates that open 20 ps earlier than stated."""
    scan, range_m = delay_scan(8, light=300.0, shift_s=20e-12)
    values = delay_scan_values(scan, range_m)
    assert values.numbers["rig.t0_s"].value == pytest.approx(-20e-12, abs=2e-12)
    assert "rig.t0_s" not in delay_scan_values(scan).numbers


def test_the_bound_of_time_is_that_of_a_bright_gaussian_echo() -> None:
    """At N photoelectrons in all and a dense scan, σ = 1/√(Σ (a R')²/V): checked by direct sums of the closed form's
    differences."""
    scan, range_m = delay_scan(9, light=300.0)
    fit = fit_response(scan, known_s=surveyed_delay(scan, range_m))
    bound = time_bound_s(scan, fit)
    tau = surveyed_delay(scan, range_m)
    shape = lambda t: 300.0 * erf_response(t - scan.delay_s[:, None], 0.8e-9, 1.5e-9, 0.3e-9, 0.4e-9)  # noqa: E731
    r, d = shape(tau), (shape(tau + 1e-12) - shape(tau - 1e-12)) / 2e-12
    w = 1.03**2 / (1.03**2 * (4.0 + r) + 1 / 12)
    f00, f01, f11 = (w * d * d).sum(0), (w * d * r).sum(0), (w * r * r).sum(0)
    assert np.median(bound / (1 / np.sqrt(f00 - f01**2 / f11))) == pytest.approx(1.0, abs=0.03)


def test_delays_before_the_echo_are_those_whose_gate_has_closed() -> None:
    scan, range_m = delay_scan(10)
    tau = surveyed_delay(scan, range_m)
    assert not delays_before(scan, tau).any()
    early = DelayScan(scan.counts, scan.dark, scan.delay_s - 6e-9, scan.shape, scan.rig)
    assert delays_before(early, tau).any()


def test_halves_share_no_frame_and_short_recordings_are_refused() -> None:
    scan, _ = delay_scan(11, repeats=7, dark=5)
    halves = [scan_half(scan, number) for number in (0, 1)]
    assert [half.repeats for half in halves] == [3, 3]
    assert np.array_equal(halves[1].counts[:, 0], scan.counts[:, 1])
    with pytest.raises(InputError, match="two halves"):
        scan_half(DelayScan(scan.counts[:, :4], scan.dark, scan.delay_s, scan.shape, scan.rig), 0)


def test_the_procedure_says_what_a_capture_lacks() -> None:
    from beambench.captures import make_capture

    rig = scan_rig()
    coords = {"delay": np.arange(4) * 1e-10, "gate": 0, "laser_on": True, "valid": True, "time": np.arange(4.0)}
    counts = np.full((4, *SHAPE), 100, np.uint16)
    capture = make_capture("gated", {"counts": counts}, coords, {}, {"rig": rig.values, "truth_kind": "none"})
    assert "repeats" in DELAY_SCAN.lacking([capture]) or "few frames" in DELAY_SCAN.lacking([capture])
    with pytest.raises(InputError, match="few frames"):
        read_scan(capture)
