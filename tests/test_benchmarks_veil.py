"""Bounds of rangers in turbid water, where backscattered light adds noise, against an independent likelihood."""

from __future__ import annotations

import warnings
from typing import Any

import numpy as np
import pytest
import xarray as xr
from numpy.typing import NDArray
from scipy.stats import norm, poisson

from beambench.benchmarks.bounds.amcw import amcw_bound
from beambench.benchmarks.bounds.waveform import waveform_bound
from beambench.captures.validate import validate
from beambench.generator.generate import GenerationWarning, generate
from beambench.optics.constants import C_M_PER_S
from beambench.scenes.load import load_scene
from beambench.scenes.medium_index import group_index
from beambench.scenes.rigs.amcw import amcw_rig
from beambench.scenes.rigs.waveform import waveform_rig
from beambench.scenes.scene import Scene

Float = NDArray[np.float64]

WATER: dict[str, Any] = {
    "medium.scattering_per_m": 0.25, "medium.absorption_per_m": 0.08,
    "medium.phase_function": {"kind": "henyey-greenstein", "g": 0.7},
}  # fmt: skip


def made(scene: Scene, rung: str = "scatter") -> xr.Dataset:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", GenerationWarning)
        return generate(scene, seed=1, fidelity=rung, truth_electrons=True)  # type: ignore[arg-type]


def information(mean: Float, read: float, gain: float, offset: float) -> Float:
    """Fisher information about the mean of every sample, by central differences of the chances of its codes:
    J = Σ_y (∂P/∂μ)²/P, y = round(gain (n + read·g) + offset), n ~ Poisson(μ)."""
    found = np.empty(mean.size)
    for k, mu in enumerate(mean):
        wide = 8.0 * np.sqrt(mu + read**2) + 8.0
        n = np.arange(max(int(mu - wide), 0), int(mu + wide) + 1)
        y = np.arange(int(gain * (mu - wide) + offset) - 1, int(gain * (mu + wide) + offset) + 2)
        edge = (np.append(y - 0.5, y[-1] + 0.5) - offset) / gain
        code = np.diff(norm.cdf((edge[:, None] - n) / read), axis=0)
        step = 1e-3 * np.sqrt(mu + read**2)
        high, low = (code @ poisson.pmf(n, mu + sign * step) for sign in (1, -1))
        chance = 0.5 * (high + low)
        kept = chance > 1e-12
        found[k] = np.sum(((high - low) / (2 * step))[kept] ** 2 / chance[kept])
    return found


def sigma_of(gradient: Float, j: Float) -> float:
    """√(F⁻¹)₀₀ of F = Σ J a aᵀ, gradient (parameter, sample)."""
    return float(np.sqrt(np.linalg.inv(gradient @ (j[:, None] * gradient.T))[0, 0]))


def test_an_amcw_bound_counts_what_the_water_sends_back() -> None:
    changes = WATER | {"rig.shots": 1, "rig.scan_half_angle_rad": 0.0, "rig.laser.power_w": 1e-4,
                       "medium.scattering_per_m": 0.02}  # fmt: skip
    scene = load_scene("amcw", changes)
    rig = amcw_rig(scene)
    capture = made(scene)
    validate(capture)
    detector = rig.detector
    mean = capture["truth_electrons"].values[0].ravel().astype(float)
    j = information(mean, detector.read_noise_e, detector.gain_dn_per_e, detector.offset_dn)
    omega = 2 * np.pi * np.repeat(rig.modulation.frequencies_hz, rig.modulation.phase_steps)
    phase = np.tile(capture["phase"].values, len(rig.modulation.frequencies_hz))
    metres = 2 * group_index(scene.medium, rig.laser.wavelength_m) / C_M_PER_S
    r = float(capture["truth_range"].values[0])
    depth = 0.5 * rig.laser.modulation_depth * detector.demodulation_contrast * float(capture["truth_amplitude"][0])

    def turned(r: float) -> Float:
        return np.asarray(depth * np.cos(omega * metres * r - phase))

    slope = (turned(r + 1e-5) - turned(r - 1e-5)) / 2e-5
    exact = sigma_of(np.stack([slope, np.ones(omega.size), turned(r)]), j)
    found = float(amcw_bound(capture).sigma[0])
    # The bound takes the echo as a point's; the beam of .5 mrad is 4 mm wide, and float32 expectations.
    assert found == pytest.approx(exact, rel=2e-3)
    # The veil is most of the light here, and the bound is larger for it by about the root of all light over the rest.
    veil = capture["truth_background"].values[0].ravel() - (0.5 * rig.ambient_e_per_s + 1e5) * 5e-6
    assert veil.mean() > 0.5 * mean.mean()
    without = float(amcw_bound(capture.drop_vars("truth_background")).sigma[0])
    assert found / without > 1.3
    grown = np.sqrt((mean + 29.0).mean() / (mean - veil + 29.0).mean())  # 5² + (1/.5)²/12, and the dark current's share
    assert found / without == pytest.approx(grown, rel=0.1)


def test_a_direct_amcw_capture_tells_its_background_and_has_the_same_bound() -> None:
    capture = made(load_scene("amcw", {"rig.shots": 2}), "direct")
    np.testing.assert_allclose(capture["truth_background"], 3.0)
    np.testing.assert_array_equal(
        amcw_bound(capture).sigma, amcw_bound(capture.drop_vars("truth_background")).sigma
    )  # fmt: skip


def test_a_waveform_bound_counts_what_the_water_sends_back() -> None:
    changes = WATER | {
        "rig.record.shots": 1, "rig.record.scan_half_angle_rad": 0.0, "rig.laser.energy_fluctuation": 0.0,
        "rig.laser.pulse_energy_j": 4e-8, "rig.ambient_e_per_s": 0.0, "target.0.material.albedo": 0.002,
        "rig.detector.readout.read_noise_e": 0.5, "rig.detector.readout.gain_dn_per_e": 4.0,
    }  # fmt: skip
    scene = load_scene("counter", changes)
    rig = waveform_rig(scene)
    readout = rig.detector.readout
    capture = made(scene)
    early, late = (made(load_scene("counter", changes | {"rig.record.start_s": 30e-9 + s})) for s in (-1e-11, 1e-11))

    def echo(c: xr.Dataset) -> Float:
        return c["truth_electrons"].values[0].astype(float) - c["truth_background"].values[0]

    metres = 2 * group_index(scene.medium, rig.laser.wavelength_m) / C_M_PER_S
    slope = (echo(early) - echo(late)) / 2e-11 * metres
    mean = capture["truth_electrons"].values[0].astype(float)
    j = information(mean, readout.read_noise_e, readout.gain_dn_per_e, readout.offset_dn)  # type: ignore[union-attr]
    exact = sigma_of(np.stack([slope, echo(capture) / float(capture["truth_amplitude"][0]), np.ones(mean.size)]), j)
    found = float(waveform_bound(capture).sigma[0])
    # The footprint's light is a point's to 1e-3; float32 expectations, and the bound's table of J.
    assert found == pytest.approx(exact, rel=1e-2)
    dark = capture.assign(truth_background=capture["truth_background"] * 0.0 + rig.detector.dark_e_per_s * 2.5e-10)
    assert found > 1.05 * float(waveform_bound(dark).sigma[0])
