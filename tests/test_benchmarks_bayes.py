"""The Bayesian bound against stacks drawn one by one: rare wrong cells, and the local error of the posterior mean."""

from __future__ import annotations

import math

import numpy as np
import pytest

from beambench.benchmarks.bounds.bayes import posterior_bound, posterior_square
from beambench.benchmarks.checks.bounds import gaussian_stack
from beambench.benchmarks.judges.bound import bound_of, elements_of
from beambench.benchmarks.written.gated import written_capture
from beambench.scenes.load import load_scene


@pytest.mark.parametrize("photons", [8.0, 24.0, 40.0, 64.0])
def test_rare_wrong_cells_are_drawn_often_and_weighted_rightly(photons: float) -> None:
    made = gaussian_stack(16.0, photons, 1.0, 481)
    mu, step = made["mu"], made["step"]
    plain = posterior_bound(mu, step, draws=8000, seed=9, family=False)
    square = posterior_square(mu, step, (np.arange(8000) * 481) // 8000, seed=2)
    # Both are simulated: four standard errors, of rms values (half of those of the squares). 24 photoelectrons make wrong
    # cells once in hundreds of stacks, 40 and 64 less often.
    error = math.hypot(plain.error, float(square.std()) / math.sqrt(8000) / (2.0 * plain.mmse))
    assert math.sqrt(square.mean()) == pytest.approx(plain.mmse, abs=4.0 * error)
    few = [math.sqrt(posterior_square(mu, step, (np.arange(600) * 481) // 600, seed=k).mean()) for k in range(20)]
    assert np.std(few) < 0.1 * np.mean(few)


@pytest.mark.parametrize("amplitude", [80.0, 130.0, 161.0])
def test_bright_background_is_bounded_by_what_the_posterior_mean_attains(amplitude: float) -> None:
    """1,000 photoelectrons of ambient light in each slice of the flat wall: the threshold lies at an amplitude of 100."""
    changes = {"rig.camera.rows": 60, "rig.camera.cols": 100, "rig.ambient_e_per_s": 1e10}
    capture = written_capture(load_scene("flat-wall", changes), amplitude, 1000.1, 5.0, seed=3)
    bound = bound_of(capture)
    scan, elements = elements_of(capture)
    theta = scan.grid(24.0)
    mean = scan.poisson_mean(amplitude * scan.shapes(theta)[0] + 1000.1 * scan.share)
    light = capture["counts"].values.reshape(64, -1).T - 100.0 + 4.0 + 1.0 / 12.0
    like = light @ np.log(mean).T - mean.sum(axis=1)
    weight = np.exp(like - like.max(axis=1, keepdims=True))
    error = (weight @ theta) / weight.sum(axis=1) * elements.scale_m_per_s - 5.0
    spread = (error**2).std() / math.sqrt(error.size) / (2.0 * (error**2).mean())
    # The bound is of places within a width, read from nodes: 5 % and four standard errors of 6,000 pixels.
    ratio = float(bound.sigma.mean()) / math.sqrt((error**2).mean())
    assert ratio == pytest.approx(1.0, abs=0.05 + 4.0 * spread)
