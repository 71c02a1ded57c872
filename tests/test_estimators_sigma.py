"""Stated errors beyond plain propagation: vertices through the brightest slice, and the limits of `learned`."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
import xarray as xr

from beambench.benchmarks.written.gated_stack import GaussianRig, stack_capture
from beambench.estimators import run_estimator
from beambench.estimators.response import correlate_samples
from beambench.optics.constants import C_M_PER_S

HALF_C = C_M_PER_S / 2
SHAPE = (60, 80)


def _exponential(rig: GaussianRig) -> dict[str, Any]:
    """A sharp rise and an exponential tail under a rectangular gate: no vertex is where R's is."""
    declared = rig.declared(*SHAPE)
    density = np.exp(-np.arange(0, 6e-9, 2e-11) / 0.6e-9)
    declared["pulse"] = {"start_s": -0.6e-9, "step_s": 2e-11, "value": list(density / density.sum() / 2e-11)}
    declared["gates"] = [{"start_s": 0.0, "step_s": 2e-11, "value": [1.0] * 75}]
    return declared


def _pixels(
    rig: GaussianRig, peak_e: float, level_e: float, declared: dict[str, Any], seed: int = 7
) -> tuple[np.ndarray, xr.Dataset]:
    """Echoes of peak_e photoelectrons at places spread over the middle of the window, and their capture."""
    rng = np.random.default_rng(seed)
    response = correlate_samples(declared["pulse"], declared["gates"][0])
    tau = rng.uniform(rig.delay_s[14], rig.delay_s[-14], SHAPE) + rig.centre_s
    mean = peak_e * response(tau[None] - rig.delay_s[:, None, None])[0] / response.peak + level_e
    electrons = rng.poisson(mean).astype(np.float64)
    if rig.intensifier:
        gain, excess = rig.intensifier
        electrons = np.where(
            electrons > 0, rng.gamma(np.maximum(electrons, 0.1) / (excess - 1), gain * (excess - 1)), 0
        )
    electrons = electrons + rig.read_noise_e * rng.normal(size=mean.shape)
    counts = np.rint(rig.offset_dn + rig.gain_dn_per_e * electrons).clip(0, 65535).astype(np.uint16)
    return tau, stack_capture(rig, counts, declared)


def _z(label: str, tau: np.ndarray, capture: xr.Dataset) -> tuple[float, float]:
    result = run_estimator(label, capture)
    valid = result["valid"].values
    assert valid.mean() > 0.99, label
    z = ((result["range"].values - tau * HALF_C) / result["sigma"].values)[valid]
    return float(np.sqrt(np.mean(z**2))), float(np.mean(np.abs(z) <= 1.96))


FINE = GaussianRig(offset_dn=50.0, gain_dn_per_e=4.0)
CASES = {
    "dim": (FINE, 100.0, 5.0, False),
    "middling": (FINE, 1000.0, 5.0, False),
    "bright": (FINE, 1e4, 0.0, False),
    "read noise": (GaussianRig(offset_dn=100.0, gain_dn_per_e=2.0, read_noise_e=5.0), 300.0, 0.0, False),
    "tube": (GaussianRig(offset_dn=100.0, gain_dn_per_e=0.01, intensifier=(1000.0, 2.0)), 300.0, 1.0, False),
    "coarse": (GaussianRig(offset_dn=100.0, gain_dn_per_e=2.0, step_s=1e-9), 300.0, 1.0, False),
    "fine": (GaussianRig(offset_dn=100.0, gain_dn_per_e=2.0, step_s=0.05e-9, slices=200), 1000.0, 1.0, False),
    "skewed": (GaussianRig(offset_dn=100.0, gain_dn_per_e=2.0), 300.0, 1.0, True),
    "skewed and bright": (GaussianRig(offset_dn=100.0, gain_dn_per_e=2.0), 2e4, 1.0, True),
}


@pytest.mark.parametrize("case", CASES)
@pytest.mark.parametrize("label", ["parabola", "log-gaussian", "log-gaussian[background=none]"])
def test_a_vertex_states_its_error_to_a_tenth(case: str, label: str) -> None:
    # 4,800 pixels: z_rms has a standard error of 1 %. A cell of the table rests on 40 to 400 trials and a pixel's scene
    # on dozens of cells, which leaves 2 %; amplitude and level are read off the pixel: 5 %. The tenth holds all three.
    rig, peak_e, level_e, skewed = CASES[case]
    declared = _exponential(rig) if skewed else rig.declared(*SHAPE)
    z, covered = _z(label, *_pixels(rig, peak_e, level_e, declared))
    assert 0.9 < z < 1.1
    # A bias that is the same for all pixels is within 1.96 σ of them all.
    assert covered > 0.93


def test_the_bias_of_a_parabola_between_samples_is_in_its_sigma() -> None:
    # Without noise to speak of the vertex of three samples errs by a fixed curve over the step. Its mean square over the
    # places near one is what sigma must be, so that sigma is also correct for a wall at one place in the step.
    rig = GaussianRig(offset_dn=100.0, gain_dn_per_e=2.0, step_s=1e-9, slices=40)
    tau = rig.delay_s[20] + rig.centre_s + np.linspace(-0.5, 0.5, SHAPE[0] * SHAPE[1]).reshape(SHAPE) * 1e-9
    counts = np.rint(100 + 2 * 2e4 * rig.response(tau[None] - rig.delay_s[:, None, None])).astype(np.uint16)
    result = run_estimator("parabola", stack_capture(rig, counts))
    error, sigma = result["range"].values - tau * HALF_C, result["sigma"].values
    assert np.abs(error).max() > 0.015 and np.sqrt(np.mean((error / sigma) ** 2)) == pytest.approx(1.0, abs=0.1)
    # By eighths of the step; those where the curve passes zero may state up to twice their own.
    for part in np.array_split(np.arange(error.size), 8):
        ratio = np.sqrt(np.mean(error.ravel()[part] ** 2)) / np.sqrt(np.mean(sigma.ravel()[part] ** 2))
        assert 0.4 < ratio < 1.2


def _learned(peak_e: float, level_e: float, **changes: Any) -> tuple[np.ndarray, xr.Dataset, xr.Dataset]:
    rig = GaussianRig(offset_dn=100.0, gain_dn_per_e=2.0, read_noise_e=2.0, **changes)
    tau, capture = _pixels(rig, peak_e, level_e, rig.declared(*SHAPE))
    return tau, capture, run_estimator("learned", capture)


def test_learned_claims_no_less_than_the_light_allows() -> None:
    # N photoelectrons of a Gaussian echo: no estimator has less than σ_R/√N. N is read off the pixel, 1/√N of it by chance.
    rig = GaussianRig()
    for peak_e in (100.0, 1000.0, 5000.0):
        _tau, _capture, result = _learned(peak_e, 0.0)
        valid = result["valid"].values
        assert valid.mean() > 0.99
        number = peak_e * np.sqrt(2 * np.pi) * rig.sigma_s / rig.step_s
        least = rig.sigma_s / np.sqrt(number) * HALF_C
        # Five standard errors of √N.
        assert result["sigma"].values[valid].min() > least * (1 - 2.5 / np.sqrt(number))


def test_learned_refuses_what_it_was_not_trained_on() -> None:
    _tau, capture, result = _learned(1000.0, 0.0)
    assert result["valid"].values.mean() > 0.99
    # A tube's excess noise: the training has none.
    rig = GaussianRig(offset_dn=100.0, gain_dn_per_e=0.002, intensifier=(1000.0, 2.0))
    tube = _pixels(rig, 1000.0, 0.0, rig.declared(*SHAPE))[1]
    assert not run_estimator("learned", tube)["valid"].values.any()
    # Background: the training has at most .08 of the brightest slice.
    assert not _learned(1000.0, 1000.0)[2]["valid"].values.any()
    # Fewer photoelectrons than 50 in the stack, or more than 1.2 million.
    assert not _learned(3.0, 0.0)[2]["valid"].values.any()
    assert not run_estimator("learned", _scaled(capture, 1e4))["valid"].values.any()
    # Slices farther apart than the points of the profile.
    assert not _learned(1000.0, 0.0, step_s=0.6e-9)[2]["valid"].values.any()


def _scaled(capture: xr.Dataset, factor: float) -> xr.Dataset:
    """The same counts, each of them `factor` photoelectrons."""
    import json

    rig = json.loads(capture.attrs["rig"])
    rig["detector"]["gain_dn_per_e"] /= factor
    rig["detector"]["full_well_e"] *= factor
    return capture.assign_attrs(rig=json.dumps(rig))
