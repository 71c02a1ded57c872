"""generate(): the contents of a capture, and its exact repetition."""

from __future__ import annotations

import json
import subprocess
import sys
import warnings

import numpy as np
import pytest
import xarray as xr

from beambench.captures.validate import validate
from beambench.generator.generate import GenerationWarning, capture_key_of, generate
from beambench.scenes.errors import InputError
from beambench.scenes.load import list_scenes, load_scene
from beambench.scenes.rigs import RIGS
from beambench.scenes.rigs.gated import gated_rig
from beambench.scenes.scene import Scene

SMALL = {"rig.camera.rows": 24, "rig.camera.cols": 20}


def test_the_library_holds_scenes_of_every_kind() -> None:
    assert {load_scene(name).modality for name in list_scenes()} == set(RIGS)


@pytest.mark.parametrize("name", [name for name in list_scenes() if load_scene(name).modality == "gated"])
def test_every_library_scene_gives_a_valid_lit_capture_without_warnings(name: str) -> None:
    scene = load_scene(name, SMALL)
    scatters = scene.medium.scattering_per_m > 0.01
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        if scatters:  # murky waters say what even the scatter rung leaves out
            warnings.simplefilter("ignore", GenerationWarning)
        capture = generate(scene, seed=1, truth_electrons=True, fidelity="scatter" if scatters else "direct")
    validate(capture)
    assert capture.sizes["row"] == 24 and capture.sizes["col"] == 20
    assert np.isfinite(capture.truth_range).any()
    light = capture.truth_electrons.values
    assert np.isfinite(light).all() and (light >= 0).all()
    detector = gated_rig(scene).detector
    gain = detector.gain_dn_per_e
    noise = np.sqrt(gain**2 * (light + detector.read_noise_e**2) + 1 / 12)
    z = (capture.counts.values - detector.offset_dn - gain * light) / noise
    # Counts scatter about the truth with the noise that the rig declares: mean z of n samples is 0 ± 1/√n.
    assert abs(z.mean()) < 4 / np.sqrt(z.size)
    assert z.var() == pytest.approx(1.0, abs=6 * np.sqrt(2 / z.size) + 0.01)


def test_truth_amplitude_and_background_explain_the_expectation() -> None:
    capture = generate(load_scene("flat-wall", SMALL), seed=1, truth_electrons=True)
    assert capture.truth_background.dims == ("slice",)
    light = capture.truth_electrons.values - capture.truth_background.values[:, None, None]
    peak = light.max(axis=0) / capture.truth_amplitude.values
    # A Gaussian of 1 ns through a gate of 1 ns passes erf(√(ln 2)) = 76.1 % at the best delay, sampled every .15 ns.
    assert peak.max() == pytest.approx(0.7609, abs=2e-3)


def same(a: xr.Dataset, b: xr.Dataset) -> bool:
    return all(np.array_equal(a[name].values, b[name].values, equal_nan=a[name].dtype.kind == "f") for name in a)


def test_equal_seeds_give_equal_bits_and_others_do_not() -> None:
    scene = load_scene("step", SMALL | {"rig.laser.energy_fluctuation": 0.05, "rig.laser.jitter_frame_s": 2e-11})
    first = generate(scene, seed=3)
    assert same(first, generate(scene, seed=3))
    assert not np.array_equal(first.counts, generate(scene, seed=4).counts)
    assert not np.array_equal(first.counts, generate(scene, seed=3, capture_key=1).counts)
    again = Scene.model_validate_json(first.attrs["truth_scene"])
    assert same(first, generate(again, seed=first.attrs["seed"], capture_key=int(first.attrs["capture_key"])))


@pytest.mark.parametrize("threads", ["1", "2"])
def test_bits_are_the_same_in_another_process_with_other_threads(threads: str) -> None:
    code = (
        "import hashlib, os; from beambench.generator.generate import generate;"
        "from beambench.scenes.load import load_scene;"
        f"c = generate(load_scene('sphere', {SMALL!r}), seed=8);"
        "print(hashlib.sha256(c.counts.values.tobytes() + c.truth_amplitude.values.tobytes()).hexdigest())"
    )
    import hashlib
    import os

    env = os.environ | {"NUMBA_NUM_THREADS": threads, "OMP_NUM_THREADS": threads}
    told = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, env=env, check=True).stdout
    mine = generate(load_scene("sphere", SMALL), seed=8)
    assert (
        told.strip() == hashlib.sha256(mine.counts.values.tobytes() + mine.truth_amplitude.values.tobytes()).hexdigest()
    )


def test_delay_is_the_optical_delay_and_a_wrong_t0_shows_in_it_only() -> None:
    base = load_scene("flat-wall", SMALL | {"rig.t0_s": 3e-10, "rig.delays.start_s": 29.2e-9})
    plain = generate(load_scene("flat-wall", SMALL | {"rig.delays.start_s": 29.5e-9}), seed=1, capture_key=0)
    shifted = generate(base, seed=1, capture_key=0)
    assert np.allclose(plain.delay, shifted.delay, atol=1e-18)
    assert np.mean(plain.counts.values != shifted.counts.values) < 1e-3  # delays equal to rounding
    told = load_scene("flat-wall", SMALL | {"declared": {"t0_s": 1e-10}})
    wrong = generate(told, seed=1, capture_key=0)
    assert np.allclose(wrong.delay - plain.delay, 1e-10)
    assert np.array_equal(wrong.counts, plain.counts)


def test_energy_fluctuation_and_laser_off_slices() -> None:
    scene = load_scene("flat-wall", SMALL | {"rig.laser.energy_fluctuation": 0.2, "rig.delays.laser_off": 3})
    capture = generate(scene, seed=2, truth_electrons=True)
    assert capture.sizes["slice"] == 67 and (~capture.laser_on).sum() == 3
    signal = capture.truth_electrons - capture.truth_background
    assert np.abs(signal[-3:]).max() < 1e-4
    calm = generate(load_scene("flat-wall", SMALL), seed=2, truth_electrons=True)
    quiet = (calm.truth_electrons - calm.truth_background).values
    ratio = signal.values[:64][quiet.max(axis=(1, 2)) > 1].sum(axis=(1, 2)) / quiet[quiet.max(axis=(1, 2)) > 1].sum(
        axis=(1, 2)
    )
    assert 0.1 < ratio.std() < 0.35


def test_several_gates_and_a_gate_map() -> None:
    gate = {"kind": "rectangular", "width_s": 1e-9, "transmission": 1.0}
    scene = load_scene(
        "flat-wall",
        SMALL
        | {"rig.gates": [gate, gate | {"transmission": 0.5}], "rig.gate_map": {"iris_s": 3e-10, "skew_s": [0.0, 0.0]}},
    )
    capture = generate(scene, seed=1, truth_electrons=True)
    signal = (capture.truth_electrons - capture.truth_background).values
    assert capture.sizes["slice"] == 128
    assert np.allclose(signal[64:], 0.5 * signal[:64], rtol=1e-5, atol=1e-3)
    from beambench.benchmarks.bounds import gated_instrument

    flat = generate(load_scene("flat-wall", SMALL), seed=1, truth_electrons=True)
    calm = (flat.truth_electrons - flat.truth_background).values
    t = capture.delay.values[:64]
    later = (signal[:64] * t[:, None, None]).sum(0) / signal[:64].sum(0) - (calm * t[:, None, None]).sum(0) / calm.sum(
        0
    )
    # R(u − o) has its echo at delays earlier by o: the stack's centroid over the delays moves by −o.
    # The map itself is shared by generator, estimators and bounds, so it is written here anew, pixel by pixel.
    corner = 12.0**2 + 10.0**2
    twin = np.array(
        [[3e-10 * ((row - 11.5) ** 2 + (col - 9.5) ** 2) / corner for col in range(20)] for row in range(24)]
    )
    assert np.abs(later + twin).max() < 2e-12
    assert np.abs(gated_instrument.gate_offsets(gated_rig(scene), (24, 20)) - twin).max() < 1e-20


def test_a_target_outside_every_gate_is_warned_about() -> None:
    with pytest.warns(GenerationWarning, match="outside every gate"):
        generate(load_scene("flat-wall", SMALL | {"rig.delays.start_s": 60e-9}), seed=1)


def test_neglected_scatter_is_warned_about_and_listed() -> None:
    murky = load_scene("flat-wall", SMALL | {"medium.scattering_per_m": 0.2, "medium.absorption_per_m": 0.1})
    with pytest.warns(GenerationWarning, match="forward-scattered"):
        capture = generate(murky, seed=1)
    effects = {e["name"]: e for e in json.loads(capture.attrs["fidelity"])["effects"]}
    assert not effects["forward-scattered light"]["modelled"]
    assert effects["forward-scattered light"]["predicted_relative_size"] == pytest.approx(
        np.expm1(2 * 0.2 * 5.0), rel=0.05
    )
    assert effects["photon noise"]["modelled"]


def test_arguments_are_checked() -> None:
    scene = load_scene("flat-wall", SMALL)
    for bad in ({"fidelity": "fuller"}, {"rtol": 0.0}, {"rtol": float("nan")}):
        with pytest.raises(InputError):
            generate(scene, seed=1, **bad)  # type: ignore[arg-type]
    with pytest.raises(InputError):
        generate(scene, seed=-1)
    inside = {"kind": "sphere", "center_m": [0.0, 0.0, 0.1], "radius_m": 0.5}
    with pytest.raises(InputError, match="inside"):
        generate(load_scene("flat-wall", SMALL | {"target.0.shape": inside}), seed=1)


def test_capture_keys_name_scene_stress_and_level() -> None:
    scene = load_scene("flat-wall")
    keys = {capture_key_of(scene), capture_key_of(scene, "photons", 10), capture_key_of(scene, "photons", 100)}
    assert len(keys) == 3 and all(0 <= k < 2**63 for k in keys)
    assert capture_key_of(scene) == capture_key_of(load_scene("flat-wall"))
