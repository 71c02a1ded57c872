"""Design of delays: closed forms of two and three delays, the exchange, the guard against ambiguity, and what is refused."""

from __future__ import annotations

import importlib.util
import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.optimize import minimize

import beambench
from beambench.benchmarks.design.exchange import (
    bias_square,
    exchanged,
    expected_square,
    mean_square,
    profiled_variance,
)
from beambench.benchmarks.design.gated_light import Bank
from beambench.benchmarks.design.run import designs_of
from beambench.benchmarks.judges import JUDGES, judge_of
from beambench.optics.correlation import response as correlation
from beambench.optics.correlation import waveforms
from beambench.optics.likelihood.fisher_table import information_table
from beambench.optics.likelihood.model import NoiseModel
from beambench.scenes.errors import InputError
from beambench.scenes.load import load_scene

SIGMA_S = 0.5e-9
NOISE = NoiseModel(read_noise_e=0.5, gain_dn_per_e=8.0, offset_dn=100.0, full_well_e=1e6, adc_max_dn=2**24 - 1)


def _gaussian(light: float = 1e4, still: float = 0.0) -> Bank:
    """One element whose response is a Gaussian of `SIGMA_S` over the delay, greatest at 10 ns."""
    half = SIGMA_S / np.sqrt(2.0)
    full = 2.0 * np.sqrt(2.0 * np.log(2.0)) * half
    pulse, gate = waveforms.GaussianPulse(full), waveforms.GaussianGate(full, 1.0)
    table = correlation.tabulate(pulse, gate, 1e-6)
    grid = 10e-9 + np.linspace(-3, 3, 241) * SIGMA_S
    one = np.ones(1)
    return Bank(
        (10e-9 + 0.5 * full) * one,
        one,
        light * one,
        0.0 * one,
        grid,
        np.full((1, 1), still),
        0.0,
        table,
        information_table(NOISE),
        100,
    )


def test_two_delays_of_a_gaussian_lie_where_light_tells_most() -> None:
    """Poisson light without background: J R'² = α R (u/σ²)² is greatest at u = ±√2 σ, the best two delays; with the amplitude
    unknown too, as their changes with it are alike and with the range opposite. Read noise of half an electron moves that by less
    than a step of the grid (σ/40) in an echo of 10,000."""
    bank = _gaussian()
    parts = bank.parts(bank.grid_s, 100.0)
    at, best = exchanged(parts, np.ones(1), np.array([60, 70]))
    u = (bank.grid_s[at] - 10e-9) / SIGMA_S
    np.testing.assert_allclose(u, [-np.sqrt(2.0), np.sqrt(2.0)], atol=0.05)
    peak = bank.table.value.max()
    # Σ J R'² = 2 α R(√2σ) 2/σ².
    expected = SIGMA_S / np.sqrt(2 * 1e4 * peak * np.exp(-1.0) * 2.0)
    assert np.sqrt(best) == pytest.approx(expected, rel=0.01)


def test_strong_background_moves_two_delays_to_the_steepest_slopes() -> None:
    """Background that is known and stronger than the light: J is constant, and J R'² is greatest where R is steepest, at ±σ."""
    bank = _gaussian(light=10.0, still=1e4)
    parts = bank.parts(bank.grid_s, 100.0)
    parts[[2, 4, 5]] = 0.0  # the background is known
    at, _ = exchanged(parts, np.ones(1), np.array([60, 70]))
    np.testing.assert_allclose((bank.grid_s[at] - 10e-9) / SIGMA_S, [-1.0, 1.0], atol=0.05)


def test_the_schur_complement_is_that_of_the_inverse() -> None:
    rng = np.random.default_rng(3)
    a = rng.standard_normal((3, 3, 7))
    f = np.einsum("ikn,jkn->ijn", a, a)
    flat = np.stack([f[0, 0], f[0, 1], f[0, 2], f[1, 1], f[1, 2], f[2, 2]])
    inverse = np.linalg.inv(np.moveaxis(f, 2, 0))[:, 0, 0]
    np.testing.assert_allclose(profiled_variance(flat), inverse, rtol=1e-9)
    weight = np.full(7, 1 / 7)
    assert mean_square(flat, weight) == pytest.approx(inverse.mean())
    # Two parameters from one slice cannot be told apart.
    single = np.outer([1.0, 2.0, 0.0], [1.0, 2.0, 0.0])[np.triu_indices(3)][:, None]
    assert np.isinf(profiled_variance(single)).all()


def test_gradients_by_range_are_those_of_finite_differences() -> None:
    """dμ/dr of the parts, √F₀₀/J, against μ moved by a thousandth of the width."""
    bank = _gaussian(light=300.0, still=3.0)
    delay = 10e-9 + np.linspace(-2, 2, 9) * SIGMA_S
    parts = bank.parts(delay, 100.0)
    step = 1e-3 * SIGMA_S

    def mean(by: float) -> np.ndarray:
        return 300.0 * correlation.lookup(bank.table, bank.time_s[0] + by - delay) + 3.0

    slope = (mean(step) - mean(-step)) / (2 * step)
    j = np.asarray(information_table(NOISE)(mean(0.0)))
    np.testing.assert_allclose(parts[0, 0], j * slope**2, rtol=2e-3, atol=1e-3 * parts[0, 0].max())


def test_an_exchange_does_not_end_above_its_start() -> None:
    bank = _gaussian(still=2.0)
    parts = bank.parts(bank.grid_s, 100.0)
    for start in (np.array([20, 90, 120, 200]), np.array([0, 1, 2, 3])):
        before = profiled_variance(parts[:, :, start].sum(axis=2))[0]
        at, best = exchanged(parts, np.ones(1), start)
        assert best <= before * (1 + 1e-9) and (np.diff(at) >= 0).all()


def test_delays_on_one_flank_of_a_wide_window_are_ambiguous() -> None:
    """Ranges beyond the reach of all delays cannot be told from each other: d is 0 there; even delays over the window tell them."""
    one = _gaussian(still=2.0)
    many = np.linspace(10e-9, 16e-9, 13)
    every = np.ones(many.size)
    bank = replace(
        one,
        time_s=many + one.time_s - 10e-9,
        slope=every,
        own=1e4 * every,
        halo=0 * every,
        still=np.full((many.size, 1), 2.0),
    )
    assert bank.distance(10e-9 + np.array([-1.0, -0.5, 0.5, 1.0]) * SIGMA_S, 100.0, 0.0) < 1.0
    assert bank.distance(np.linspace(9e-9, 17e-9, 33), 100.0, 0.0) > 6.0


def test_every_modality_has_designs_or_is_told(tmp_path: Path) -> None:
    having = [name for name in JUDGES if judge_of(name).design]
    assert len(having) >= 3
    for name in JUDGES:
        scene = load_scene(judge_of(name).scenes[0])
        if name in having:
            knobs = designs_of(scene).knobs(scene)
            assert knobs and all(knob.values and knob.what for knob in knobs)
        else:
            with pytest.raises(InputError, match="Nothing is known"):
                beambench.design(scene, out=tmp_path / "no")
    assert not (tmp_path / "no").exists()


@pytest.mark.parametrize(
    ("bad", "word"),
    [({"budget": 0.0}, "range"), ({"margin_m": -1.0}, "range"), ({"allow": ["slice=4"]}, "no such setting"),
     ({"allow": ["slices=four"]}, "numbers"), ({"allow": ["slices=4.5"]}, "numbers"), ({"allow": ["slices=1e9"]}, "numbers"),
     ({"allow": ["slices=inf"]}, "numbers"), ({"margin_m": 1e9}, "to the camera"),
     ({"margin_m": 900.0, "overrides": {"target.0.shape.center_m": [0, 0, 1000.0]}}, "too long")],
)  # fmt: skip
def test_bad_arguments_are_refused(bad: dict[str, object], word: str, tmp_path: Path) -> None:
    with pytest.raises(InputError, match=word):
        beambench.design("flat-wall", out=tmp_path / "no", **bad)  # type: ignore[arg-type]
    assert not (tmp_path / "no").exists()


def test_a_length_is_above_zero(tmp_path: Path) -> None:
    for scene, allow in (
        ("gated-turbulence", "pitch=0"),
        ("spotscan-wall", "baseline=-0.1"),
        ("flat-wall", "gate-width=0"),
    ):
        with pytest.raises(InputError, match="numbers") as found:
            beambench.design(scene, allow=[allow], out=tmp_path / "no")
        assert "above 0" in found.value.allowed


def test_a_design_is_written_and_its_overrides_make_a_scene(tmp_path: Path) -> None:
    if importlib.util.find_spec("mitsuba") is None:
        pytest.skip("Mitsuba is not installed")
    small = {"rig.camera.rows": 12, "rig.camera.cols": 12}
    made = beambench.design("flat-wall", overrides=small, allow=["slices=6"], out=tmp_path / "d")
    best = made.found.best
    assert best.name.startswith("chosen 6") and best.guard >= 6.0 and made.found.gain > 1.5
    held = json.loads((tmp_path / "d" / "overrides.json").read_text())
    rig = load_scene("flat-wall", held).rig
    assert rig.delays.count == 6 and rig.pulses_per_slice == 6400 // 6  # type: ignore[union-attr]
    # No more light than the scene's own 64 slices of 100 pulses.
    assert rig.pulses_per_slice * 6 <= 6400  # type: ignore[union-attr]
    written = {path.name for path in (tmp_path / "d").iterdir()}
    assert {"design.csv", "run.json", "design.png", "overrides.json", "set.txt"} <= written
    beambench.design("flat-wall", overrides=small, allow=["slices=6"], out=tmp_path / "d", overwrite=True)
    assert "--set 'rig.delays=" in (tmp_path / "d" / "set.txt").read_text()


def test_a_model_that_lacks_light_is_biased_as_a_fit_of_it_shows() -> None:
    """Light that comes late and is no multiple of R: β² of nine sums against the fit of A R(u − x) + b to the true means by
    another search of the expected likelihood itself."""
    bank = _gaussian(light=1e4, still=50.0)
    delay = 10e-9 + np.linspace(-3, 3, 25) * SIGMA_S
    late = 300.0 * np.exp(-0.5 * ((bank.grid_s - 9.4e-9) / (1.4 * SIGMA_S)) ** 2)
    lacking = replace(bank, still=50.0 + late[None])
    found = lacking.read(delay, 100.0)
    assert found.settled.all()
    # To first order about the fit, the nine sums have the same bias.
    sums = lacking.reading(delay, 100.0).parts(delay, 100.0, exact=False).sum(axis=2)
    variance, bias = bias_square(sums)
    assert expected_square(sums)[0] == pytest.approx(variance[0] + bias[0])
    assert np.sqrt(bias[0]) == pytest.approx(abs(found.shift_s[0]), rel=1e-3)

    def model(x: np.ndarray) -> np.ndarray:
        return x[0] * correlation.lookup(bank.table, bank.time_s[0] + x[2] * SIGMA_S - delay) + x[1]

    mean = model(np.array([1e4, 50.0, 0.0])) + np.interp(delay, bank.grid_s, late)

    # Poisson's likelihood itself, expected: read noise is small here.
    def divergence(x: np.ndarray) -> float:
        m = model(x * np.array([1e4, 50.0, 1.0])) + 0.25
        return float((m - (mean + 0.25) * np.log(m)).sum())

    fitted = minimize(
        divergence, [1.0, 1.0, 0.0], method="Nelder-Mead", options={"xatol": 1e-7, "fatol": 1e-9, "maxiter": 4000}
    ).x
    assert abs(fitted[2]) > 0.01
    assert found.shift_s[0] == pytest.approx(fitted[2] * SIGMA_S, rel=0.01)
    # Without the light that is lacking there is no bias, and the variance is that of six sums.
    true = bank.reading(delay, 100.0).parts(delay, 100.0, exact=False).sum(axis=2)
    variance, bias = bias_square(true)
    assert np.sqrt(bias[0]) < 1e-4 * SIGMA_S
    exact = profiled_variance(bank.parts(delay, 100.0).sum(axis=2))
    np.testing.assert_allclose(variance, exact, rtol=1e-3)


def test_an_unknown_model_of_who_reads_is_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="such a model"):
        beambench.design("spotscan-wall", estimator_model="direct", out=tmp_path / "no")
    assert not (tmp_path / "no").exists()


def test_derivatives_by_range_in_scattering_water_are_those_of_generated_stacks() -> None:
    """A wall in harbour water, nearer and farther by 4 mm: what its stacks differ by is the bank's derivative, up to the own
    light's change with distance, a multiple of R. As if the halo were as sharp as R, it would be 7 to 13 % too large."""
    if importlib.util.find_spec("mitsuba") is None:
        pytest.skip("Mitsuba is not installed")
    from beambench.benchmarks.design.gated_light import bank_of
    from beambench.benchmarks.design.kind import Ask
    from beambench.generator.generate import generate

    wall = {
        "target.0.shape.width_m": 30.0,
        "target.0.shape.height_m": 30.0,
        "target.1.shape.center_m": [40.0, 0.0, 1.0],
    }
    small = {"rig.camera.rows": 8, "rig.camera.cols": 8, "rig.camera.pixel_pitch_m": 60e-6, **wall}
    scene = load_scene("harbour-wall", small)
    gate = scene.rig.gates[0].model_dump(mode="json")  # type: ignore[union-attr]
    bank = bank_of(scene, Ask(1.0, 0.0, {}, "scatter", 1), gate)
    middle = float(np.median(bank.time_s)) - (bank.table.start_s + bank.table.step_s * np.argmax(bank.table.value))
    places = np.flatnonzero(np.abs(bank.grid_s - middle) < 1.5 * bank.width_s)
    delay = bank.grid_s[places]
    even = {"start_s": float(delay[0]), "step_s": float(delay[1] - delay[0]), "count": delay.size}
    z = scene.target[0].shape.center_m[2]
    stacks = []
    for by in (-4e-3, 4e-3):
        moved = load_scene(scene, {"rig.delays": even, "target.0.shape.center_m": [0.0, 0.0, z + by]})
        seen = generate(moved, seed=1, fidelity="scatter", truth_electrons=True, rtol=1e-3)
        stacks.append((seen["truth_electrons"].values.reshape(delay.size, -1), seen["truth_range"].values.ravel()))
    (near, r0), (far, r1) = stacks
    u = bank.time_s[:, None] - delay
    r = np.maximum(correlation.lookup(bank.table, u), 0.0)
    step = 0.02 * bank.width_s
    rise = (correlation.lookup(bank.table, u + step) - correlation.lookup(bank.table, u - step)) / (2 * step)
    assert bank.moving is not None
    ours = bank.own[:, None] * bank.slope[:, None] * rise + bank.moving[:, places]
    sharp = (bank.own + bank.halo)[:, None] * bank.slope[:, None] * rise
    measured = (far - near).T / (r1 - r0)[:, None]
    pixel = np.argmin(np.abs(0.5 * (r0 + r1) - (bank.time_s / bank.slope)[:, None]), axis=1)
    for i, p in enumerate(pixel):
        a = np.stack([ours[i], r[i]], axis=1)
        share, left = np.linalg.lstsq(a, measured[p], rcond=None)[:2]
        assert 0.985 < share[0] < 1.015
        assert left[0] < 1e-3 * (measured[p] ** 2).sum()
        old = np.linalg.lstsq(np.stack([sharp[i], r[i], np.ones(delay.size)], axis=1), measured[p], rcond=None)[0][0]
        assert old < 0.96
    assert bank.time_s.size >= 50
