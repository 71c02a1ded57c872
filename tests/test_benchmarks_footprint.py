"""Bounds of rangers where the footprint spreads the echo: the spread itself, and what a bound is then called."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest

from beambench.benchmarks.bounds.amcw import amcw_bound
from beambench.benchmarks.bounds.footprint import LARGEST_SHARE, first_hits, footprint_std_s, is_wide
from beambench.benchmarks.bounds.waveform import waveform_bound
from beambench.estimators import run_estimator
from beambench.generator.generate import generate
from beambench.generator.rays.trace import Tracer
from beambench.optics.constants import C_M_PER_S
from beambench.scenes.load import load_scene
from beambench.scenes.rigs.waveform import waveform_rig

STARING = {"rig.laser.energy_fluctuation": 0.0, "rig.record.scan_half_angle_rad": 0.0, "target.0.shape.width_m": 40.0,
           "target.0.shape.height_m": 20.0}  # fmt: skip


def _tilted(tilt_deg: float, half_angle_rad: float, **changes: Any) -> Any:
    wide = {"rig.laser.illumination.half_angle_rad": half_angle_rad, "target.0.shape.tilt_y_deg": tilt_deg,
            "rig.detector.active_diameter_m": 4e-3}  # fmt: skip
    return load_scene("counter", STARING | wide | changes)


def _spread(scene: Any) -> float:
    rig = waveform_rig(scene)
    field = math.atan2(0.5 * rig.detector.active_diameter_m, rig.receiver.focal_length_m)
    found = footprint_std_s(scene, rig.laser.illumination, rig.laser.wavelength_m, field, np.zeros(3))
    assert found.shape == (1,)
    return float(found[0])


@pytest.mark.parametrize("tilt_deg", [30.0, 60.0, 75.0])
def test_a_tilted_wall_spreads_a_gaussian_beam_by_its_closed_form(tilt_deg: float) -> None:
    """Range r + r θ_x tanα with θ_x of standard deviation w/2: σ = 2 n r (w/2) tanα/c. Cut at 2 w, it is 4 % less:
    1 − 8 e⁻⁸/(1 − e⁻⁸) of the variance is 1 to 3e-3; a lattice of 64 rays errs by a few per cent."""
    scene = _tilted(tilt_deg, 1e-3)
    metres = 4.0 * 0.5e-3 * math.tan(math.radians(tilt_deg))
    assert _spread(scene) == pytest.approx(2.0 * 1.34 * metres / C_M_PER_S, rel=0.05)


def test_own_rays_meet_what_the_generator_s_meet() -> None:
    rng = np.random.default_rng(5)
    for name in ("step", "sphere", "relief-tank", "panel"):
        scene = load_scene(name)
        local = np.append(rng.uniform(-0.25, 0.25, (400, 2)), np.ones((400, 1)), axis=1)
        local /= np.linalg.norm(local, axis=1)[:, None]
        theirs = Tracer(scene).trace((0.0, 0.0, 0.0), local.T)
        expected = np.where(theirs.target >= 0, theirs.distance, np.inf)
        found = first_hits(scene, local)
        near = np.isclose(found, expected, rtol=1e-5) | (np.isinf(found) & np.isinf(expected))
        assert near.mean() > 0.985  # rays along an edge may pass either surface


def test_a_wide_footprint_makes_the_bound_quasi() -> None:
    """4 mrad at 75°: an estimator that knows only the point's response is above its bound, which is too small; the same
    wall face on, or a narrow beam, keeps "exact"."""
    light = {"rig.laser.pulse_energy_j": 2e-8, "rig.record.shots": 400}
    wide = generate(_tilted(75.0, 4e-3, **light), seed=1)
    bound = waveform_bound(wide)
    assert bound.kind == "quasi"
    found = run_estimator("waveform-ml", wide)
    error = (found["range"] - wide["truth_range"]).values[found["valid"].values]
    # 400 errors: the rms is known to 3.5 %.
    assert np.std(error) > 1.1 * np.nanmean(bound.sigma)
    for tilt, half_angle in ((0.0, 4e-3), (30.0, 5e-4)):
        assert waveform_bound(generate(_tilted(tilt, half_angle, **{"rig.record.shots": 2}), seed=1)).kind == "exact"


def test_a_step_in_the_footprint_makes_the_bound_quasi() -> None:
    near = {"name": "board", "shape": {"kind": "rectangle", "center_m": [1.0, 0.0, 3.8], "width_m": 2.0, "height_m": 2.0,
                                       "tilt_x_deg": 0.0, "tilt_y_deg": 0.0},
            "material": {"kind": "lambert", "albedo": 0.4}}  # fmt: skip
    plain = load_scene("counter", STARING | {"rig.record.shots": 2})
    both = plain.model_dump(mode="json")
    both["target"].append(near)
    stepped = type(plain).model_validate(both)
    assert waveform_bound(generate(plain, seed=1)).kind == "exact"
    assert waveform_bound(generate(stepped, seed=1)).kind == "quasi"


def test_an_amcw_bound_is_quasi_where_the_phase_spreads() -> None:
    still = {
        "rig.shots": 2,
        "rig.scan_half_angle_rad": 0.0,
        "rig.laser.power_fluctuation": 0.0,
        "target.0.shape.width_m": 40.0,
    }
    assert amcw_bound(generate(load_scene("amcw", still | {"target.0.shape.tilt_y_deg": 0.0}), seed=1)).kind == "exact"
    wide = still | {"target.0.shape.tilt_y_deg": 70.0, "rig.laser.illumination.half_angle_rad": 2e-2,
                    "rig.detector.active_diameter_m": 4e-3}  # fmt: skip
    assert amcw_bound(generate(load_scene("amcw", wide), seed=1)).kind == "quasi"


def test_the_share_costs_half_a_per_cent() -> None:
    """A Gaussian echo of σ_R broadened by σ_f: its bound grows by √(1 + σ_f²/σ_R²)."""
    assert math.sqrt(1.0 + LARGEST_SHARE**2) - 1.0 == pytest.approx(0.005, abs=1e-4)
    assert is_wide(np.array([np.nan, 1.1e-10]), 1e-9) and not is_wide(np.array([np.nan, 0.9e-10]), 1e-9)
    assert is_wide(np.array([np.inf]), 1e-9)
