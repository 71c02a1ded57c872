"""Figures 3, 4 and 7 of Guo et al. 2017: the photodetector's pulse in closed form, by drawn fields and by captures."""

from __future__ import annotations

import math

import numpy as np
import pytest

from beambench.benchmarks.reproduce import (
    deviation,
    photodetector,
    ranger,
    reflection,
)
from beambench.optics.constants import C_M_PER_S
from beambench.optics.reflection.albedo import hemispherical_albedo
from beambench.optics.reflection.chua import chua


@pytest.mark.parametrize("slope", [0.15, 0.3, 0.5])
def test_surfaces_of_one_reflectivity_reflect_alike_however_rough(slope: float) -> None:
    """Half vectors beyond 45° lie below the horizon, so a lobe holds share·ρ·(1 − exp(−1/s²)) at normal incidence."""
    made = photodetector.surface("", 0.6, slope, glossy_share=0.5)
    law = {"slope": slope, "diffusivity": 1.0, "convention": "reciprocal"}
    lobe = hemispherical_albedo(lambda a: chua(a, k_s=made.k_s, k_d=0.0, **law), 0.0)  # type: ignore[arg-type]
    assert float(lobe) == pytest.approx(0.3 * (1.0 - math.exp(-1.0 / slope**2)), rel=2e-3)
    assert made.response(0.0) == pytest.approx(made.k_s + made.k_d)


def test_the_photodetectors_scatter_is_the_closed_form() -> None:
    """4,000 measurements: standard error of a standard deviation 1.1 %, tolerance 4 of them."""
    setup = photodetector.Setup()
    target = photodetector.surface("", 0.5, 0.5)
    for key, angle in ((0, 0.0), (1, 0.9)):
        signal = photodetector.mean_signal(setup, target, angle)
        errors = photodetector.measure(setup, signal, np.random.default_rng(key), count=4000)
        stated = photodetector.closed_form_std(setup, signal)
        assert np.std(errors) == pytest.approx(stated, rel=0.045)
        assert abs(errors.mean()) < 4.0 * stated / math.sqrt(4000)


def test_the_whole_record_errs_as_the_closed_form_says() -> None:
    """8,000 measurements of a strong echo: standard error of a standard deviation .8 %, tolerance 4 of them.

    The noise of all 401 samples enters, √(Σt²)·σ/S: 8 mm at 0°, 23 mm at 60°, while a window keeps it near 1 mm.
    """
    setup = photodetector.Setup()
    for key, angle in ((0, 0.0), (1, math.pi / 3)):
        signal = photodetector.mean_signal(setup, photodetector.surface("", 0.5, 0.5), angle)
        errors = photodetector.measure(setup, signal, np.random.default_rng(key), count=8000, windowed=False)
        assert np.std(errors) == pytest.approx(photodetector.whole_record_std(setup, signal), rel=0.04)
    assert 1e3 * deviation.noise_alone(setup, 0.0) == pytest.approx(8.1, abs=0.1)
    assert 1e3 * deviation.noise_alone(setup, 60.0) == pytest.approx(23.1, abs=0.1)


def test_only_possible_set_ups_are_used() -> None:
    """4kTRB at 295 K, 50 Ω and .35/.3 ns by hand; 1 MΩ with a picofarad is slower than 300 ps by four powers of ten."""
    noise = math.sqrt(4.0 * 1.380649e-23 * 295.0 * 50.0 * 0.35 / 300e-12)
    assert photodetector.thermal_noise_v(photodetector.Setup()) == pytest.approx(noise, rel=1e-12)
    assert noise == pytest.approx(0.0308e-3, rel=0.01)
    assert not photodetector.possible(photodetector.Setup(load_ohm=1e6, noise_v=1.0))
    assert not photodetector.possible(photodetector.Setup(noise_v=0.03e-3))
    used = reflection.setups()
    assert len(used) == 1 + 2 * 3 * 2
    for setup in used:
        assert setup.load_ohm * 1e-12 * 2.2 <= 300e-12 and setup.noise_v >= noise


def test_speckle_on_the_detector_against_drawn_fields() -> None:
    """Random phases on a Gaussian spot, their field on a disc by a sum over the spot: 1/M is the variance of the mean light.

    500 spots of 1,500 points: the relative variance of 500 gamma variables is known to about 8 %; tolerance 4 of them.
    """
    setup = photodetector.Setup()
    spot = setup.beam_half_angle_rad * photodetector.RANGE_M
    rng = np.random.default_rng(8)
    axis = np.linspace(-0.5, 0.5, 13) * setup.diameter_m
    x, y = (v[np.hypot(*np.meshgrid(axis, axis)) <= 0.5 * setup.diameter_m] for v in np.meshgrid(axis, axis))
    wave = 2.0 * math.pi / (setup.wavelength_m * photodetector.RANGE_M)
    light = []
    for _ in range(500):
        at = rng.normal(0.0, 0.5 * spot, (2, 1500))  # I ∝ exp(−2ρ²/w²): standard deviation w/2
        field = np.exp(1j * (wave * (np.outer(x, at[0]) + np.outer(y, at[1])) + rng.uniform(0.0, 2.0 * math.pi, 1500)))
        light.append(float(np.mean(np.abs(field.sum(axis=1)) ** 2)))
    found = np.var(light) / np.mean(light) ** 2
    assert found == pytest.approx(1.0 / photodetector.speckle_cells(setup), rel=0.32)
    # One speckle over a small detector, area over coherence area πL² on a large one.
    assert photodetector.speckle_cells(photodetector.Setup(beam_half_angle_rad=1e-5)) == pytest.approx(1.0, abs=1e-3)
    wide = photodetector.Setup(beam_half_angle_rad=20e-3)
    scale = wide.wavelength_m / (math.pi * 20e-3)
    assert photodetector.speckle_cells(wide) == pytest.approx((0.5 * wide.diameter_m / scale) ** 2, rel=0.05)
    # Two gamma variables of shape 1: P(4X > Y) = 4/5.
    assert reflection.share_in_order(4.0, 1.0, rng) == pytest.approx(0.8, abs=0.004)


def test_the_photodetector_sees_the_light_of_eq3() -> None:
    setup = photodetector.Setup()
    signal = photodetector.mean_signal(setup, photodetector.Surface("", 0.0, 0.5 / math.pi, 0.3), 0.0)
    photons = setup.energy_j * setup.wavelength_m / (6.62607015e-34 * C_M_PER_S)
    share = 0.25 * math.pi * setup.diameter_m**2 / photodetector.RANGE_M**2 * 0.5 / math.pi
    assert signal.sum() == pytest.approx(setup.quantum_efficiency * photons * share, rel=1e-6)


def test_a_baseline_pulls_the_average_to_the_middle_of_the_record() -> None:
    """(t̄ − τ)·KB/(S + KB) without noise."""
    setup = photodetector.Setup(noise_v=1e-12)
    early = 4e-9
    signal = photodetector.mean_signal(setup, photodetector.surface("", 0.5, 0.5), 0.0, -early)
    level = 500.0
    share = signal.size * level / (signal.sum() + signal.size * level)
    found = photodetector.measure(setup, 1e6 * signal, np.random.default_rng(0), windowed=False, baseline_e=1e6 * level)
    expected = 0.5 * C_M_PER_S * early * (share - 1.0)
    assert found.mean() == pytest.approx(expected, rel=1e-3)  # photon noise of 1e12 electrons: 1e-6


def test_generated_waveforms_agree_with_their_own_sigma() -> None:
    """Mean |error| over mean σ is √(2/π) for a correct σ: standard error 14 % with 30 shots, tolerance 3 of them."""
    from beambench.estimators import run_estimator
    from beambench.generator.generate import generate
    from beambench.scenes.load import load_scene

    capture = generate(load_scene("photodetector-5m"), seed=3)
    found = run_estimator("waveform-average", capture)
    error = np.abs(found["range"] - capture["truth_range"]).values
    assert error.mean() / found["sigma"].values.mean() == pytest.approx(math.sqrt(2 / math.pi), rel=0.42)
    # A third of the light, all else equal: electronic noise makes the error three times as large.
    strong, weak = (ranger.shots(photodetector.Surface("", 0.0, k, 0.3), 0.0, 3) for k in (0.3, 0.1))
    assert np.abs(weak).mean() / np.abs(strong).mean() == pytest.approx(3.0, rel=0.6)
