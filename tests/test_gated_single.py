"""Pixels with two echoes do not enter pulse, gate and time zero: planted edges, whose places and shares are known."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from beambench.estimators.calibration.gated_delay_scan import delay_scan_values
from beambench.estimators.calibration.gated_scan import DelayScan
from beambench.estimators.calibration.gated_single import fit_one_echo
from beambench.estimators.calibration.gated_survey import surveyed_delay
from beambench.estimators.calibration.gated_widths import fit_response, lit_pixels
from beambench.estimators.rig import DeclaredRig

from ._delay_scans import SHAPE, delay_scan, erf_response

EDGE = np.zeros(SHAPE[0] * SHAPE[1], bool)
EDGE[24:32] = True  # one row of eight


def edged(seed: int = 1, **changes: Any) -> tuple[DelayScan, np.ndarray[Any, Any]]:
    """A scan of 300 electrons in which the pixels of `EDGE` see a second surface, 0.6 ns behind, with as much light."""
    scan, range_m = delay_scan(seed, light=300.0, repeats=12, **changes)
    tau = surveyed_delay(scan, range_m)[EDGE]
    behind = 300.0 * erf_response(tau + 0.6e-9 - scan.delay_s[:, None], 0.8e-9, 1.5e-9, 0.3e-9, 0.4e-9)
    more = np.random.default_rng(seed + 1).poisson(
        np.maximum(behind, 0.0)[:, None, :], (*scan.counts.shape[:2], EDGE.sum())
    )
    counts = scan.counts.copy()
    counts[:, :, EDGE] += np.floor(0.5 + 1.03 * more)
    return replace(scan, counts=counts), range_m


@pytest.mark.parametrize("surveyed", [False, True])
def test_edges_are_left_out_and_the_pulse_is_right(surveyed: bool) -> None:
    """With the edges the pulse is wrong by more than ten standard errors, without them by less than four (0.2 % is that of
    samples, which are linear between)."""
    scan, range_m = edged()
    known = surveyed_delay(scan, range_m) if surveyed else None
    every, one = fit_response(scan, known_s=known), fit_one_echo(scan, known_s=known)
    assert not one.single[EDGE].any()
    assert one.single[~EDGE].sum() >= (~EDGE).sum() - 1
    # Each of both shapes is compared: which of them takes up the second echo depends on its place.
    wrong = max(abs(found.value - 1.0) / found.sigma for found in (every.pulse, every.gate))
    assert wrong > 10
    for found in (one.pulse, one.gate):
        assert found.value == pytest.approx(1.0, abs=4 * found.sigma + 2e-3)
    assert float(one.chi2[one.single].mean()) / one.dof == pytest.approx(1.0, abs=0.15)
    assert float(every.chi2.mean()) / every.dof > 3.0


def test_the_calibration_takes_the_pixels_with_one_echo() -> None:
    scan, range_m = edged(3)
    found = delay_scan_values(scan, range_m)
    assert found.pulse.value == pytest.approx(1.0, abs=4 * found.pulse.sigma + 2e-3)
    assert found.numbers["rig.t0_s"].value == pytest.approx(0.0, abs=4 * found.numbers["rig.t0_s"].sigma + 0.5e-12)


def test_a_wrong_shape_leaves_no_pixel_out() -> None:
    """All pixels misfit alike where the declared gate has another shape: χ² has to show it, and does."""
    scan, _ = delay_scan(5, light=300.0, repeats=12)
    declared = dict(scan.rig.values)
    step = declared["gates"][0]["step_s"]
    gate = np.asarray(declared["gates"][0]["value"], float)
    ramp = gate * np.linspace(0.4, 1.0, gate.size)
    wrong = declared | {"gates": [declared["gates"][0] | {"value": ramp.tolist(), "step_s": step}]}
    fit = fit_one_echo(replace(scan, rig=DeclaredRig("", wrong)))
    assert float(fit.chi2[fit.single].mean()) / fit.dof > 2.0
    assert fit.single.mean() > 0.9


def test_a_laser_that_varies_leaves_no_pixel_out() -> None:
    """3 % of 300 electrons in every frame raise χ² of bright pixels by half: common to all, and expected."""
    fit = fit_one_echo(delay_scan(6, light=300.0, repeats=12, vary=0.03)[0])
    assert fit.single.mean() > 0.95
    assert lit_pixels(fit).all()


def test_a_pixel_without_light_is_not_lit() -> None:
    scan, _ = delay_scan(7, light=300.0, repeats=12)
    counts = scan.counts.copy()
    counts[:, :, 0] = scan.dark[: counts.shape[1], 0]
    assert not lit_pixels(fit_one_echo(replace(scan, counts=counts)))[0]
