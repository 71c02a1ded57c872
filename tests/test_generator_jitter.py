"""Jitter of single pulses: the mean of M pulses scatters by σ/√M, and over many draws the echo is broadened by all of σ."""

from __future__ import annotations

import warnings
from typing import Any

import numpy as np
import pytest
from scipy.special import ndtr

from beambench.generator.gated.stack import slice_coordinates, slice_settings
from beambench.generator.generate import GenerationWarning, generate
from beambench.optics.constants import C_M_PER_S
from beambench.scenes.load import load_scene
from beambench.scenes.medium_index import group_index

SLICES, SHOTS = 4000, 3000


def made(name: str, changes: dict[str, Any]) -> Any:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", GenerationWarning)
        return generate(load_scene(name, changes), seed=3, truth_electrons=True)


def gated(jitter_s: float, pulses: int, delays: dict[str, Any]) -> dict[str, Any]:
    return {
        "rig.camera.rows": 1, "rig.camera.cols": 1, "rig.laser.jitter_shot_s": jitter_s, "rig.pulses_per_slice": pulses,
        "rig.delays": delays, "rig.laser.energy_fluctuation": 0.0, "rig.laser.jitter_frame_s": 0.0, "rig.ambient_e_per_s": 0.0,
        "rig.detector.dark_current_e_per_s": 0.0, "rig.laser.pulse": {"kind": "gaussian", "fwhm_s": 1e-9},
        "rig.gates": [{"kind": "rectangular", "width_s": 3e-9, "transmission": 1.0}],
    }  # fmt: skip


@pytest.mark.parametrize("pulses", [1, 4, 100])
def test_the_mean_delay_of_a_slice_scatters_and_all_of_the_jitter_broadens_the_mean_stack(pulses: int) -> None:
    """Scatter σ/√M: within four standard errors, 4.5 %. Mean of 4000 slices at three delays on R's edge, where R is convex,
    straight and concave: that of a pulse broadened by σ, in closed form. At one pulse a slice, a pulse that is broadened and
    moved by all of σ is 2 % of the peak off where R bends, ten times what the test allows.
    """
    jitter = 3e-10
    scene = load_scene("flat-wall", gated(jitter, pulses, {"start_s": 0.0, "step_s": 1e-10, "count": 1}))
    n_g = group_index(scene.medium, scene.rig.laser.wavelength_m)  # type: ignore[union-attr]
    for u in (-8e-10, 0.0, 6e-10):
        start = 2 * n_g * 5.0 / C_M_PER_S - u
        changes = gated(jitter, pulses, {"start_s": start, "step_s": 1e-10, "count": 1, "repeats": SLICES})
        capture = made("flat-wall", changes)
        assert float(capture["truth_range"].values[0, 0]) == pytest.approx(5.0, abs=1e-5)
        light = capture["truth_electrons"].values[:, 0, 0] / capture["truth_amplitude"].values[0, 0]
        sigma = np.hypot(1e-9 / np.sqrt(8 * np.log(2)), jitter)
        expected = float(ndtr(u / sigma) - ndtr((u - 3e-9) / sigma))
        # What few pulses leave out, the scatter of their own spread, is of second order: no part of the mean.
        assert light.mean() == pytest.approx(expected, abs=4.5 * float(light.std()) / np.sqrt(SLICES) + 2e-4)
    scene = load_scene("flat-wall", changes)
    delay, _ = slice_settings(scene, slice_coordinates(scene), seed=3, key=0)
    assert delay.std() == pytest.approx(jitter / np.sqrt(pulses), rel=4 / np.sqrt(2 * SLICES))
    assert delay.mean() == pytest.approx(start + scene.rig.t0_s, abs=4.5 * jitter / np.sqrt(pulses * SLICES))


@pytest.mark.parametrize("pulses", [1, 9])
def test_the_mean_delay_of_a_record_scatters_and_all_of_the_jitter_broadens_the_mean_record(pulses: int) -> None:
    jitter = 2e-10
    base = {
        "rig.laser.illumination": {"profile": "flat-top", "half_angle_rad": 1e-5, "offset_rad": [0.0, 0.0]},
        "rig.laser.energy_fluctuation": 0.0, "rig.laser.jitter_shot_s": 0.0, "rig.record.shots": SHOTS,
        "rig.record.scan_half_angle_rad": 0.0, "rig.pulses_per_shot": pulses,
    }  # fmt: skip
    width = []
    for sigma in (0.0, jitter):
        capture = made("counter", base | {"rig.laser.jitter_pulse_s": sigma})
        light = capture["truth_electrons"].values - capture["truth_background"].values[:, None]
        time = capture["time"].values
        centre = (light * time).sum(axis=1) / light.sum(axis=1)
        assert centre.std() == pytest.approx(sigma / np.sqrt(pulses), rel=4 / np.sqrt(2 * SHOTS), abs=1e-13)
        mean = light.mean(axis=0)
        middle = (mean * time).sum() / mean.sum()
        width.append((mean * (time - middle) ** 2).sum() / mean.sum())
    # The sample's variance of the drawn part, and the exact rest.
    error = 4.5 * jitter**2 / pulses * np.sqrt(2 / SHOTS)
    assert width[1] - width[0] == pytest.approx(jitter**2, abs=error + 2e-3 * jitter**2)


def test_pulses_that_count_at_most_once_share_no_delay() -> None:
    """A detector that is blind for longer than the echo lasts takes each count from another pulse: nothing moves the record."""
    changes: dict[str, Any] = {
        "rig.record.shots": 8, "rig.pulses_per_shot": 50, "rig.laser.jitter_pulse_s": 3e-10, "rig.laser.jitter_shot_s": 0.0,
        "rig.laser.energy_fluctuation": 0.0, "rig.record.scan_half_angle_rad": 0.0,
    }  # fmt: skip
    blind = made("single-photon", changes)["truth_electrons"].values
    np.testing.assert_array_equal(blind, np.broadcast_to(blind[:1], blind.shape))
    awake = made("single-photon", changes | {"rig.detector.readout.dead_time_s": 0.0})["truth_electrons"].values
    assert np.abs(awake - awake[:1]).max() > 0.01 * awake.max()
