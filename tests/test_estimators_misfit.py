"""The stated error of pixels that see two surfaces: drawn here from Gaussians, whose mixture has a variance in closed form."""

from __future__ import annotations

from importlib import import_module
from typing import Any

import numpy as np
import pytest

from beambench.benchmarks.written.gated_stack import GaussianRig, stack_capture
from beambench.estimators import run_estimator
from beambench.optics.constants import C_M_PER_S

HALF_C = C_M_PER_S / 2
SHAPE = (60, 80)
RIG = GaussianRig(sigma_s=0.6e-9, read_noise_e=1.0, offset_dn=50.0)


#: Estimators that fit R itself.
FITS = ("poisson-ml", "poisson-ml-backscatter", "matched-filter", "radiometric-average", "gaussian-least-squares")


def _pixels(
    name: str, apart_s: float, share: float, light: float, seed: int = 3
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """(range [m], sigma [m], τ of the first surface) of echoes of which `share` comes from `apart_s` later."""
    rng = np.random.default_rng(seed)
    tau = rng.uniform(RIG.delay_s[16], RIG.delay_s[-20], SHAPE) + RIG.centre_s
    u = tau[None] - RIG.delay_s[:, None, None]
    mean = light * ((1 - share) * RIG.response(u) + share * RIG.response(u + apart_s)) + 5.0
    electrons = rng.poisson(mean) + RIG.read_noise_e * rng.normal(size=mean.shape)
    capture = stack_capture(RIG, np.rint(50 + electrons).clip(0, 65535).astype(np.uint16), RIG.declared(*SHAPE))
    found = run_estimator(name, capture)
    assert found["valid"].values.mean() > 0.999
    return found["range"].values, found["sigma"].values, tau


@pytest.mark.parametrize("name", [*FITS, "poisson-ml-two-returns"])
def test_an_unmixed_pixel_keeps_its_sigma(name: str) -> None:
    _, sigma, _ = _pixels(name, 0.0, 0.0, 2000.0)
    # Fisher information of a Gaussian echo: σ_R²/N at small background, the same for all but for noise of a few per cent.
    enlarged = sigma > 1.25 * np.median(sigma)
    # The score test at 3.5 σ and χ² at 3.5 σ, each below 1e-3 in a tail that is skewed; 4,800 pixels.
    assert enlarged.sum() <= 20


@pytest.mark.parametrize("share", [0.5, 0.25])
@pytest.mark.parametrize("apart", [1.0, 1.8])
@pytest.mark.parametrize("name", FITS)
def test_sigma_holds_the_spread_of_two_surfaces(name: str, share: float, apart: float) -> None:
    delta = apart * RIG.sigma_s
    value, sigma, tau = _pixels(name, delta, share, 4000.0)
    error = np.minimum(np.abs(value - tau * HALF_C), np.abs(value - (tau + delta) * HALF_C))
    # Two delays: the variance f(1 − f)δ², which the expansion to first order gives within a third up to 1.8 σ_R.
    spread = np.sqrt(share * (1 - share)) * delta * HALF_C
    assert np.median(sigma) == pytest.approx(spread, rel=0.35)
    # Without it sigma is that of an echo of R, and the errors are many times as large.
    z = error / sigma
    assert np.sqrt((z**2).mean()) < 1.4
    assert np.sqrt((error**2).mean()) / (RIG.sigma_s * HALF_C / np.sqrt(4000.0 * RIG.sigma_s / RIG.step_s)) > 5


@pytest.mark.parametrize(("surfaces", "answered"), [(2, True), (3, False)])
def test_two_returns_do_not_answer_for_three_surfaces(surfaces: int, answered: bool) -> None:
    # 1.8 σ_R apart: the likeliest two echoes of three stand where none of the three is, 30 mm away, and would state 2 mm.
    rng = np.random.default_rng(5)
    tau = rng.uniform(RIG.delay_s[16], RIG.delay_s[-24], SHAPE) + RIG.centre_s
    u = tau[None] - RIG.delay_s[:, None, None]
    places = [k * 1.8 * RIG.sigma_s for k in range(surfaces)]
    mean = 2000.0 * sum(RIG.response(u + place) for place in places) + 5.0
    electrons = rng.poisson(mean) + RIG.read_noise_e * rng.normal(size=mean.shape)
    capture = stack_capture(RIG, np.rint(50 + electrons).clip(0, 65535).astype(np.uint16), RIG.declared(*SHAPE))
    found = run_estimator("poisson-ml-two-returns", capture)
    valid = found["valid"].values
    assert valid.mean() > 0.99 if answered else valid.mean() < 0.01
    error = np.min([np.abs(found["range"].values - (tau + place) * HALF_C) for place in places], axis=0)
    # 4,800 trials: z_rms has a standard error of 1 %; four of them.
    assert not answered or np.sqrt(np.mean((error / found["sigma"].values)[valid] ** 2)) == pytest.approx(1.0, abs=0.05)


def test_a_narrow_declared_response_is_seen() -> None:
    rng = np.random.default_rng(2)
    tau = rng.uniform(RIG.delay_s[16], RIG.delay_s[-20], SHAPE) + RIG.centre_s
    wide = GaussianRig(sigma_s=0.8e-9)
    mean = 4000.0 * wide.response(tau[None] - RIG.delay_s[:, None, None] - RIG.centre_s + wide.centre_s) + 5.0
    electrons = rng.poisson(mean) + RIG.read_noise_e * rng.normal(size=mean.shape)
    capture = stack_capture(RIG, np.rint(50 + electrons).clip(0, 65535).astype(np.uint16), RIG.declared(*SHAPE))
    sigma = run_estimator("poisson-ml", capture)["sigma"].values
    # V = .8² − .6² ns².
    assert np.median(sigma) == pytest.approx(np.sqrt(0.28) * 1e-9 * HALF_C, rel=0.25)


@pytest.mark.parametrize("light", [60.0, 4000.0])
def test_screening_in_single_precision_loses_no_pixel(light: float, monkeypatch: pytest.MonkeyPatch) -> None:
    # Surfaces barely apart, so that many pixels lie near the limit; the reference looks at every pixel in double precision.
    rng = np.random.default_rng(7)
    tau = rng.uniform(RIG.delay_s[2], RIG.delay_s[-3], SHAPE) + RIG.centre_s
    u = tau[None] - RIG.delay_s[:, None, None]
    apart = rng.uniform(0.0, 1.2, SHAPE) * RIG.sigma_s
    mean = 0.5 * light * (RIG.response(u) + RIG.response(u + apart)) + 5.0
    electrons = rng.poisson(mean) + RIG.read_noise_e * rng.normal(size=mean.shape)
    capture = stack_capture(RIG, np.rint(50 + electrons).clip(0, 65535).astype(np.uint16), RIG.declared(*SHAPE))
    screened = run_estimator("poisson-ml", capture)
    module = import_module("beambench.estimators.gated.poisson_ml")
    fit, looked = module._fit_smooth, []

    def all_of_them(*args: Any) -> None:
        fit(*args)
        looked.append(float(args[-1][-1].mean()))
        args[-1][-1][:] = True

    monkeypatch.setattr(module, "_fit_smooth", all_of_them)
    whole = run_estimator("poisson-ml", capture)
    assert looked[0] < 0.9  # the screening did leave pixels out
    np.testing.assert_array_equal(screened["sigma"].values, whole["sigma"].values)
    monkeypatch.setattr(module, "LIMIT", np.inf)
    plain = run_estimator("poisson-ml", capture)["sigma"].values
    assert (np.nan_to_num(whole["sigma"].values) > np.nan_to_num(plain)).sum() > 10
