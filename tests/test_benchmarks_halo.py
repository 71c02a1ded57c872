"""In water the bound includes the information that the halo carries about a shift of the whole target."""

from __future__ import annotations

from typing import Any

import numpy as np
import xarray as xr

from beambench.benchmarks.bounds.gated import gated_bound
from beambench.benchmarks.judges.bound import bound_of
from beambench.benchmarks.peers.volume_cost import water_scene
from beambench.generator.generate import generate
from beambench.scenes.load import load_scene


def _capture(distance_m: float, fidelity: str = "scatter") -> xr.Dataset:
    scene = water_scene("harbour", 8).model_dump(mode="json")
    scene["target"][0]["shape"]["center_m"] = [0.0, 0.0, distance_m]
    scene["rig"]["detector"]["read_noise_e"] = 0.0
    return generate(load_scene(scene), seed=1, capture_key=1, fidelity=fidelity, rtol=0.02, truth_electrons=True)


def test_the_bound_is_the_information_on_a_shift_of_the_target() -> None:
    """Σ over slices of (dS/dr)²/μ, amplitude and the light that stands still profiled, by central differences of the
    noise-free stack. The halo is blurred over delays and ranges, which the bound leaves out: it is up to a quarter lower, and
    never higher."""
    step = 0.01
    captures = [_capture(0.9 + s) for s in (-step, 0.0, step)]
    inner = slice(2, -2)  # where the beam lights the wall
    near, mean, far = (c["truth_electrons"].values[:, inner, inner].astype(float) for c in captures)
    here = captures[1]
    slope = (far - near) / (2 * step)
    # The own return: the direction in which the amplitude changes.
    background = here["truth_background"].values[:, inner, inner].astype(float)
    moving = np.maximum(mean - background, 0.0) + 1e-12
    rows = np.stack([slope, moving, np.ones_like(mean)])
    information = np.einsum("akij,bkij,kij->ijab", rows, rows, 1.0 / mean)
    wanted = np.sqrt(np.linalg.inv(information)[..., 0, 0])
    found = gated_bound(here).sigma
    ratio = found[inner, inner] / wanted
    assert 0.75 < np.median(ratio) < 1.02, np.median(ratio)
    assert gated_bound(here).kind == "quasi"
    alone = gated_bound(here.drop_vars("truth_halo")).sigma
    assert np.median(alone / found) > 1.3  # without the halo no estimator could meet it


def test_both_rungs_tell_the_halo_and_the_threshold_counts_it() -> None:
    """The own light is what came unscattered, on both rungs alike and as the direct rung has it; the sum is the same light."""
    told: dict[str, Any] = {name: _capture(0.9, name) for name in ("scatter", "full")}
    light = {name: c["truth_amplitude"].values + c["truth_halo"].values for name, c in told.items()}
    np.testing.assert_allclose(light["full"], light["scatter"], rtol=0.03)
    direct = _capture(0.9, "direct")["truth_amplitude"].values
    assert np.array_equal(told["scatter"]["truth_amplitude"].values, direct)
    # The full rung samples its rays to a part of rtol of the whole image: .02 · .7.
    error = told["full"]["truth_amplitude"].values - direct
    assert np.sqrt(np.mean(error**2)) < 0.02 * np.sqrt(np.mean(direct**2))
    bounds = {name: bound_of(capture).sigma for name, capture in told.items()}
    np.testing.assert_allclose(bounds["full"], bounds["scatter"], rtol=0.1)
