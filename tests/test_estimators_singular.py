"""Singular stacks: every estimator of gated captures gives finite or invalid answers and no warning.

The laws (`test_estimators_laws`) hold what is singular for every modality. Here: light at the ends of the window, ties, slices
that are NaN or infinite, counts below the offset, numbers near the largest of their type, few slices, odd delays, and rigs
with extreme values. Division by zero and overflow inside numpy are errors here, so that none passes unseen.
"""

from __future__ import annotations

import json
import math
import warnings
from typing import Any

import numpy as np
import pytest
import xarray as xr

from beambench.benchmarks.written.gated_stack import GaussianRig, stack_capture
from beambench.estimators import list_estimators, run_estimator
from beambench.optics.reflection.chua import chua_printed
from beambench.scenes.errors import InputError

RIG = GaussianRig(offset_dn=20.0, gain_dn_per_e=2.0, read_noise_e=1.0)
SHAPE = (3, 12)
NAMES = list_estimators("gated")
#: Estimators that leave clipped and NaN samples out, as documented, and read the rest.
LEAVES_OUT = ("poisson-ml",)
TOP = float(np.finfo(np.float32).max)


def _light(signal_e: float = 3e3) -> np.ndarray:
    rng = np.random.default_rng(5)
    tau = rng.uniform(RIG.delay_s[20], RIG.delay_s[-20], SHAPE) + RIG.centre_s
    return np.asarray(np.rint(20 + 2 * rng.poisson(RIG.electrons(tau, signal_e, 3.0))).clip(0, 65535).astype(np.uint16))


def _stacks() -> dict[str, np.ndarray]:
    base = _light()
    single = base.astype(np.float32)
    made: dict[str, np.ndarray] = {}

    def one(name: str, values: Any, at: Any, start: np.ndarray = base) -> None:
        made[name] = start.copy()
        made[name][at] = values

    dark = np.full_like(base, 20)
    made["offset everywhere"] = dark
    made["no count in one pixel"] = base.copy()
    made["no count in one pixel"][:, 2, 5] = 0
    one("light in the first slice only", 5000, 0, dark)
    one("light in the last slice only", 5000, -1, dark)
    one("two equal slices", 5000, slice(30, 32), dark)
    one("two equal peaks far apart", 5000, [5, 55], dark)
    one("all slices equal but one dark", 20, 32, np.full_like(base, 3000))
    one("a full slice beside empty ones", 65535, 31, np.zeros_like(base))
    one("every other slice full", 65535, slice(None, None, 2), np.zeros_like(base))
    one("one DN above the offset", 21, 31, dark)
    one("below the offset", 0, slice(None, 30))
    one("a slice of NaN", np.nan, 31, single)
    one("an infinite slice", np.inf, 31, single)
    one("a slice at minus infinity", -np.inf, 31, single)
    one("a NaN in every pixel", np.nan, (np.arange(SHAPE[1]) * 5, slice(None), np.arange(SHAPE[1])), single)
    one("a pixel of NaN", np.nan, (slice(None), 1, 4), single)
    made["far below the offset"] = np.full_like(single, -1e6)
    made["largest float"] = np.full_like(single, TOP)
    made["smallest float"] = np.full_like(single, np.finfo(np.float32).tiny)
    return made


STACKS = _stacks()
LOST = (
    "a slice of NaN", "an infinite slice", "a NaN in every pixel", "a full slice beside empty ones", "every other slice full",
)  # fmt: skip


def _checked(name: str, capture: xr.Dataset) -> xr.Dataset:
    kept = capture.copy(deep=True)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        result = run_estimator(name, capture)  # the contract, finite where valid, is checked there
    valid = result["valid"].values
    assert np.isnan(result["range"].values[~valid]).all() and np.isnan(result["sigma"].values[~valid]).all()
    assert (result["range"].values[valid] > 0).all()
    xr.testing.assert_identical(capture, kept)
    return result


@pytest.mark.parametrize("name", NAMES)
def test_singular_stacks(name: str) -> None:
    for kind, counts in STACKS.items():
        result = _checked(name, stack_capture(RIG, counts))
        valid = result["valid"].values
        if kind in ("far below the offset", "largest float", "offset everywhere"):
            assert not valid.any(), kind
        elif kind == "no count in one pixel":
            assert not valid[2, 5] and valid.any(), kind
        elif kind == "a pixel of NaN":
            assert not valid[1, 4] and valid.any(), kind
        elif kind in LOST and name not in LEAVES_OUT:
            assert not valid.any(), kind  # a sample is clipped, or no number


@pytest.mark.parametrize("name", NAMES)
def test_few_slices_and_other_orders(name: str) -> None:
    base = stack_capture(RIG, _light())
    _checked(name, base.isel(slice=slice(20, 21)).copy(deep=True))
    _checked(name, base.isel(slice=slice(20, 22)).copy(deep=True))
    same = base.copy(deep=True)
    same["delay"].values[:] = 33e-9
    _checked(name, same)
    uneven = base.copy(deep=True)
    uneven["delay"].values[:] = 30e-9 + 16e-9 * np.sort(np.random.default_rng(0).random(RIG.slices))
    _checked(name, uneven)
    turned = base.isel(slice=slice(None, None, -1)).copy(deep=True)
    xr.testing.assert_allclose(_checked(name, turned), _checked(name, base), rtol=1e-9)


@pytest.mark.parametrize("name", NAMES)
def test_odd_delays(name: str) -> None:
    base = stack_capture(RIG, _light())
    step = RIG.step_s
    for delay in (
        -RIG.delay_s,  # before the pulse left: no range is positive
        np.linspace(-8e-9, 8e-9, RIG.slices),
        RIG.delay_s * 1e-6,  # all within a part of the response
        RIG.delay_s * 1e6,  # steps of microseconds
        np.r_[np.full(32, RIG.delay_s[0]), np.full(32, RIG.delay_s[0] + 40 * step)],
        np.where(np.arange(RIG.slices) % 7 == 0, np.nan, RIG.delay_s),
    ):
        capture = base.copy(deep=True)
        capture["delay"].values[:] = delay
        try:
            result = _checked(name, capture)
        except InputError as error:  # a window of milliseconds is more than a table of the response can hold
            assert "too wide a window" in error.what and np.ptp(delay) > 1e-4
            continue
        if (delay < -20e-9).all():
            assert not result["valid"].values.any()


@pytest.mark.parametrize("name", NAMES)
def test_rigs_at_their_ends(name: str) -> None:
    counts = _light()
    for path, value in (
        ("detector.read_noise_e", 0.0), ("detector.read_noise_e", 1e6), ("detector.gain_dn_per_e", 1e-9),
        ("detector.gain_dn_per_e", 1e9), ("detector.full_well_e", 1e-3), ("detector.adc_bits", 1),
        ("laser.energy_fluctuation", 1.0), ("laser.jitter_shot_s", 1e-7), ("camera.focal_length_m", 1e-9),
        ("camera.pixel_pitch_m", 1.0), ("medium.group_index", 4.0), ("laser.half_angle_rad", 1.499),
        ("ambient_e_per_s", 1e18), ("t0_s", 1.0),
    ):  # fmt: skip
        rig = RIG.declared(*SHAPE)
        *parents, last = path.split(".")
        node = rig
        for key in parents:
            node = node[key]
        node[last] = value
        result = _checked(name, stack_capture(RIG, counts, rig))
        if path in ("detector.full_well_e", "detector.adc_bits"):
            assert not result["valid"].values.any(), path
    for dead in (0.0, 1e-300):
        rig = RIG.declared(*SHAPE)
        rig["gates"][0]["value"] = [dead] * len(rig["gates"][0]["value"])
        try:
            result = run_estimator(name, stack_capture(RIG, counts, json.loads(json.dumps(rig))))
        except InputError:  # refused: the gate never opens
            continue
        assert np.isfinite(result["range"].values[result["valid"].values]).all()


def test_equation_4_up_to_grazing() -> None:
    # cos⁻⁶θ overflows while exp(−tan²θ/s²) underflows: their product is 0 at 90°, and finite everywhere before.
    theta = np.r_[np.linspace(0, 89.999, 2000), 90 - np.geomspace(1e-3, 1e-12, 200), 90.0]
    cosine = np.maximum(np.cos(np.radians(theta)), 0.0)
    for slope in (1e-3, 0.05, 0.4, 1.0, 30.0):
        for diffusivity in (0.0, 1.0, 2.5):
            with np.errstate(over="raise", divide="raise", invalid="raise"):
                value = chua_printed(cosine, k_s=0.5, k_d=0.2, slope=slope, diffusivity=diffusivity)
            assert np.isfinite(value).all() and (value >= 0).all()
            if diffusivity > 0:
                assert value[-1] < 1e-15  # cos 90° is 6e-17 in double precision
    assert math.isclose(float(chua_printed(np.ones(1), k_s=0.5, k_d=0.2, slope=1.0, diffusivity=1.0)[0]), 0.7)


@pytest.mark.parametrize("angle_deg", [89.0, 89.9, 89.999])
def test_grazing_walls_of_equation_4_are_generated_and_read(angle_deg: float) -> None:
    import importlib.util

    if importlib.util.find_spec("mitsuba") is None:
        pytest.skip("Mitsuba is not installed")
    from beambench.captures.hide import hide_truth
    from beambench.generator.generate import GenerationWarning, generate
    from beambench.scenes.load import load_scene

    material = {"kind": "chua", "k_s": 0.5, "k_d": 0.16, "slope": 0.4, "diffusivity": 1.0}
    scene = load_scene(
        "flat-wall",
        {"rig.camera.rows": 4, "rig.camera.cols": 6, "target.wall.shape.tilt_y_deg": angle_deg,
         "target.wall.material": material | {"convention": "as-printed-radiance"}},
    )  # fmt: skip
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", GenerationWarning)
        capture = hide_truth(generate(scene, seed=1))
    for name in ("radiometric-average", "chua-2017", "chua-2017-orthogonal", "weighted-average", "poisson-ml"):
        _checked(name, capture)
