"""Random wavefront scenes: light finite and nowhere negative, truth finite, equal seeds give equal bits, answers sound."""

from __future__ import annotations

import contextlib
import warnings
from typing import Any

import numpy as np
import pytest

from beambench.benchmarks.judges.bound import bounds_of, truths_of
from beambench.captures.hide import hide_truth
from beambench.captures.validate import validate
from beambench.estimators import run_estimator
from beambench.generator.generate import generate
from beambench.scenes.errors import InputError
from beambench.scenes.load import load_scene

RUNGS = ("geometric", "isolated", "coherent")
#: What generation may refuse: samples too coarse, too few cells, a field too wide, a flow that one screen cannot hold.
REFUSED = ("half a turn", "not independent", "spreads over too many", "flows too far", "for the speckle")
CHAINS = (
    "spot-centroid",
    "spot-ml",
    "spot-joint+slope-cell+zernike-ls[modes=4]",
    "spot-weighted+slope-cell+zonal-southwell[modes=4]",
)


def _turbulence(rng: np.random.Generator) -> dict[str, Any]:
    kind = rng.integers(0, 4)
    if kind == 0:
        return {"kind": "none"}
    if kind == 1:
        return {"kind": "flow", "flow_l_per_min": float(rng.uniform(0, 40))}
    layers = []
    for _ in range(int(rng.integers(1, 4))):
        layer: dict[str, Any] = {"range_m": float(rng.uniform(0.1, 5.0)), "r0_m": float(10 ** rng.uniform(-3.5, -1))}
        if rng.random() < 0.4:
            layer["outer_scale_m"] = float(10 ** rng.uniform(-2.5, 1))
        if kind == 3:
            layer["velocity_m_per_s"] = rng.uniform(-5e-3, 5e-3, 2).tolist()
        layers.append(layer)
    return {"kind": "layers", "layers": layers}


def _changes(seed: int) -> dict[str, Any]:
    """A rig, water and target of random values, of which some lenslets or gates see no light at all."""
    rng = np.random.default_rng(seed)
    across, pixel = int(rng.integers(4, 9)), float(rng.uniform(8e-6, 40e-6))
    pitch = float(rng.uniform(4.0, 12.0)) * pixel
    rows = int(np.ceil(1.5 * across * pitch / pixel)) + 8
    far = float(rng.uniform(0.5, 6.0))
    scattering = float(rng.choice([0.0, 0.05, 0.5]))
    medium: dict[str, Any] = {
        "name": "random water", "index": {"kind": "explicit", "phase": 1.33, "group": float(rng.uniform(1.33, 1.4))},
        "absorption_per_m": float(rng.uniform(0, 0.5)), "scattering_per_m": scattering,
    }  # fmt: skip
    if scattering:
        medium["phase_function"] = {"kind": "henyey-greenstein", "g": float(rng.uniform(0.5, 0.97))}
    tube = {
        "gain": 30.0,
        "excess_noise_factor": float(rng.uniform(1, 3)),
        "phosphor_sigma_px": float(rng.choice([0.0, 0.6])),
    }
    more = np.random.default_rng([seed, 1])
    reflection = str(rng.choice(["mirror", "diffuse"]))
    effects = {
        "speckle_looks": int(more.choice([1, 2, 5])) if reflection == "diffuse" and more.random() < 0.9 else None,
        "pointing_jitter_rad": float(more.choice([0.0, 3e-4])),
    }
    modes = int(rng.integers(4, 12))
    aberration = {"noll": list(range(2, modes)), "rad": rng.normal(0, 1, modes - 2).tolist()}
    return {
        "target.0.shape.center_m": [0.0, 0.0, far], "target.0.material.albedo": float(rng.uniform(0.01, 1)), "medium": medium,
        "rig.reflection": reflection, "rig.effects": effects if more.random() < 0.9 else None, "rig.turbulence": _turbulence(rng),
        "rig.ambient_e_per_s": float(rng.choice([0.0, 1e8])),
        "rig.lenslets": {
            "across": across, "pitch_m": pitch, "focal_length_m": float(rng.uniform(1e-3, 2e-2)),
            "fill": float(rng.uniform(0.5, 1)),
            "transmission": 0.9, "rotation_deg": float(rng.choice([0.0, rng.uniform(-2, 2)])),
            "offset_m": rng.uniform(-pitch, pitch, 2).tolist(), "missing": [[int(rng.integers(0, across)), 1]],
            "grid": str(more.choice(["square", "hexagonal"])), "missing_share": float(more.choice([0.0, 0.2])),
            "missing_seed": int(more.integers(0, 100)),
        },
        "rig.camera.rows": rows, "rig.camera.cols": rows + 3, "rig.camera.pixel_pitch_m": pixel,
        "rig.pupil": {
            "shape": str(rng.choice(["disc", "square"])), "diameter_m": float(rng.uniform(0.6, 1.0)) * across * pitch,
            "least_fill": float(rng.uniform(0.3, 1)), "samples": int(rng.integers(2, 9)), "modes": modes,
        },
        "rig.bench.beam_diameter_m": 1.5 * across * pitch, "rig.bench.magnification": float(rng.uniform(0.2, 2)),
        # One in six scintillates: its screens are wider, and take most of the time.
        "rig.propagation": "split-step" if seed % 6 == 5 else "phase-screens",
        "rig.aberration": aberration if rng.random() < 0.5 else None, "target.0.shape.width_m": 1.0, "target.0.shape.height_m": 1.0,
        "rig.laser.pulse_energy_j": float(10 ** rng.uniform(-13, -7)), "rig.laser.energy_fluctuation": 0.1,
        "rig.laser.jitter_frame_s": 1e-9, "rig.frames.start_s": float(2 * 1.36 * far / 3e8 + rng.uniform(-2e-8, 1e-8)),
        "rig.frames.step_s": float(rng.choice([0.0, 2e-9])), "rig.frames.count": 3, "rig.frames.reference_exposures": 4,
        "rig.detector.prnu": 0.01, "rig.detector.dsnu_e": 2.0, "rig.detector.intensifier": tube if rng.random() < 0.5 else None,
    }  # fmt: skip


def _check(seed: int) -> bool:
    """Whether the random scene could be set up; all that it gives is checked."""
    try:
        scene = load_scene("gated-turbulence", _changes(seed))
    except InputError as error:
        assert any(
            word in error.what
            for word in ("No lenslet", "No sample", "outside the image", "too few pixels", "not cover", "narrower")
        ), error
        return False
    rung: Any = RUNGS[seed % 3]
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        try:
            capture = generate(scene, seed=seed, fidelity=rung, truth_electrons=True)
        except InputError as error:
            assert any(word in error.what for word in REFUSED), error
            return False
        again = generate(scene, seed=seed, fidelity=rung)
    assert np.array_equal(capture["counts"], again["counts"]) and np.array_equal(
        capture["reference"], again["reference"]
    )
    validate(capture)
    electrons = capture["truth_electrons"].values
    assert np.isfinite(electrons).all() and electrons.min() >= 0.0
    for name in ("truth_slope", "truth_zernike", "truth_field", "truth_flux"):
        assert np.isfinite(capture[name].values).all(), name
    inside = np.isfinite(capture["truth_phase"].values)
    assert inside.any() and np.abs(capture["truth_phase"].values[inside]).max() < 1e6
    truths = truths_of(capture)
    for name, bound in (bounds_of(capture) if seed % 4 == 0 else {}).items():
        known = np.isfinite(truths[name].value)
        told = bound.kind == "none" or not np.isnan(bound.sigma[known]).any()
        assert told and bound.scale > 0 and bound.window > 0, name
    for label in CHAINS:
        # A reference without light, and too few lenslets, are refused.
        with contextlib.suppress(InputError):
            found = run_estimator(label, hide_truth(capture))
            first = next(name for name in ("spot", "zernike") if name in found)
            good = found["valid"].values
            assert np.isfinite(found[first].values[good]).all() and (found["sigma"].values[good] > 0).all()
    return True


@pytest.mark.parametrize("first", range(0, 20, 10))
def test_random_scenes_are_sound(first: int) -> None:
    assert sum(_check(seed) for seed in range(first, first + 10)) >= 3


@pytest.mark.slow
@pytest.mark.parametrize("first", range(1000, 1500, 100))
def test_five_hundred_random_scenes_are_sound(first: int, long_run: None) -> None:
    assert sum(_check(seed) for seed in range(first, first + 100)) >= 50
