"""Stress axes: the changes of a scene at a level, neutral levels, units, and messages about invalid axes."""

from __future__ import annotations

import math
import warnings

import numpy as np
import pytest

from beambench.benchmarks.suites.stress import AXES, axis_overrides, axis_unit, list_axes, stressed
from beambench.benchmarks.suites.suite import SUITES, cells_of, list_suites, load_suite
from beambench.generator.generate import GenerationWarning, generate
from beambench.scenes.declared import declared_rig
from beambench.scenes.errors import InputError
from beambench.scenes.load import load_scene

#: A level of every axis that is not neutral and fits the flat wall.
LEVELS = {
    "photons": 0.1,
    "background": 1e6,
    "incidence": 30.0,
    "distance": 0.1,
    "turn": 3.0,
    "delay-step": 2.0,
    "window-start": 1e-9,
    "pulse-width": 2.0,
    "jitter": 1e-10,
    "shot-jitter": 1e-10,
    "fluctuation": 0.05,
    "read-noise": 10.0,
    "gain": 0.5,
    "absorption": 0.1,
    "wrong-index": 0.01,
    "wrong-phase-index": 0.01,
    "wrong-stand-off": -0.01,
    "wrong-baseline": 1e-3,
    "wrong-t0": 1e-10,
    "wrong-pulse": 0.2,
    "wrong-gate": 0.2,
    "wrong-pitch": 0.005,
    "attenuation-lengths": 2.0,
    "turbidity": 2.0,
    "specular": 0.5,
    "full-well": 0.5,
    "motion": 1.0,
    "phosphor": 1.5,
    "screen-coverage": 0.7,
    "screen-gap": 0.2,
}

#: Every stress that the project promises a suite for.
STRESSES = (
    "photons", "background", "attenuation-lengths", "incidence", "specular", "saturation", "delay-step", "jitter", "energy",
    "motion", "phosphor", "window", "two-surfaces", "gate", "index",
)  # fmt: skip

#: What a few axes need of the scene.
NEEDS = {
    "attenuation-lengths": ("harbour-wall", {}),
    "turbidity": ("harbour-wall", {}),
    "wrong-stand-off": ("spotscan-wall", {}),
    "wrong-baseline": ("spotscan-wall", {}),
    "wrong-pitch": ("gated-turbulence", {}),
    "phosphor": (
        "flat-wall",
        {"rig.detector.intensifier": {"gain": 50.0, "excess_noise_factor": 2.0, "phosphor_sigma_px": 0.0}},
    ),
    "screen-coverage": ("flat-wall", {"rig.screen": {"distance_m": 4.7, "coverage": 0.5, "albedo": 0.5}}),
    "screen-gap": ("flat-wall", {"rig.screen": {"distance_m": 4.7, "coverage": 0.5, "albedo": 0.5}}),
}


def test_every_axis_changes_the_scene() -> None:
    assert set(LEVELS) == set(AXES) and list_axes()
    for axis, level in LEVELS.items():
        name, needs = NEEDS.get(axis, ("flat-wall", {}))
        scene = load_scene(name, needs)
        changed, overrides = stressed(scene, [(axis, level)])
        assert changed != scene, axis
        # What was changed is written down as overrides: the same scene comes of them, as `--set` would make it.
        assert load_scene(name, needs | overrides) == changed, axis
        if axis in NEEDS:
            with pytest.raises(InputError, match="does not apply"):
                stressed(load_scene("flat-wall"), [(axis, level)])


def test_neutral_levels_change_nothing() -> None:
    for name in ("flat-wall", "relief-tank", "photodetector-5m", "amcw"):
        scene = load_scene(name)
        neutral = [
            (a.name, a.neutral) for a in AXES.values() if a.neutral is not None and not a.name.startswith("wrong")
        ]
        for axis, level in neutral:
            if axis == "incidence":  # sets the tilt, which 0 leaves for untilted objects only
                continue
            try:
                assert stressed(scene, [(axis, level)])[0] == scene, (name, axis)
            except InputError as error:
                assert "does not apply" in error.what or "does not fit" in error.what, (name, axis)


def test_what_named_axes_mean() -> None:
    scene = load_scene("flat-wall")
    rig = scene.rig
    coarse = stressed(scene, [("delay-step", 4.0)])[0].rig
    assert coarse.delays.step_s == pytest.approx(4 * rig.delays.step_s)  # type: ignore[union-attr]
    span = (coarse.delays.count - 1) * coarse.delays.step_s  # type: ignore[union-attr]
    whole = (rig.delays.count - 1) * rig.delays.step_s  # type: ignore[union-attr]
    assert whole - coarse.delays.step_s < span <= whole * (1 + 1e-12)  # type: ignore[union-attr]
    far = stressed(scene, [("distance", 0.5)])[0]
    assert far.target[0].shape.center_m[2] == pytest.approx(scene.target[0].shape.center_m[2] + 0.5)
    # A wrong declaration leaves the true rig alone, and two of them add up.
    wrong, overrides = stressed(scene, [("wrong-index", 0.01), ("wrong-t0", 1e-10)])
    assert wrong.rig == scene.rig and wrong.medium == scene.medium
    assert set(wrong.declared) == {"medium.index", "t0_s"} and set(overrides) == {"declared"}


def test_murkier_water_keeps_its_kind() -> None:
    scene = load_scene("harbour-wall")
    for level in (0.0, 3.0):
        murky = stressed(scene, [("attenuation-lengths", level)])[0].medium
        assert murky.attenuation_per_m * 1.2 == pytest.approx(level)
        assert murky.phase == scene.medium.phase
    ratio = scene.medium.scattering_per_m / scene.medium.attenuation_per_m
    assert murky.scattering_per_m / murky.attenuation_per_m == pytest.approx(ratio)


def test_turbidity_is_a_scattering_coefficient_of_one_per_metre_and_ntu() -> None:
    """Twelve NTU scatter 12 1/m, and light that is scattered away is missing along both ways: exp(-Δb (|L − P| + |P|)).

    A wrong conversion, absorption scaled along, or one way left out would show: at Δb = .8 1/m the paths of 4.7 m take 98 %.
    """
    scene = load_scene("spotscan-deep", {"rig.port": {"kind": "none"}})
    waters = [stressed(scene, [("turbidity", level)])[0] for level in (0.0, 0.2, 1.0, 12.0)]
    assert [water.medium.scattering_per_m for water in waters] == pytest.approx([0.0, 0.2, 1.0, 12.0])
    assert all(water.medium.absorption_per_m == scene.medium.absorption_per_m for water in waters)
    assert all(water.medium.phase == scene.medium.phase for water in waters)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", GenerationWarning)  # the light that is scattered is left out on purpose
        clear, turbid = (generate(water, seed=1, fidelity="direct") for water in waters[1:3])
    rows = slice(40, 216)  # the fan ends beyond
    point = clear["truth_point"].values[0, rows, 0].astype(float)
    path = np.linalg.norm(point, axis=-1) + np.linalg.norm(point - scene.rig.laser.position_m, axis=-1)  # type: ignore[union-attr]
    left = turbid["truth_amplitude"].values[0, rows, 0] / clear["truth_amplitude"].values[0, rows, 0]
    # A pixel's width of the sheet changes the path by 1e-4 of itself.
    np.testing.assert_allclose(-np.log(left) / 0.8, path, rtol=1e-3)


def test_specular_matter_keeps_its_albedo_and_a_wrong_gate_its_rig() -> None:
    scene = load_scene("flat-wall")
    material = stressed(scene, [("specular", 0.75)])[0].target[0].material
    assert material.diffuse_albedo + material.specular_albedo == pytest.approx(0.5)  # type: ignore[union-attr]
    wrong = stressed(scene, [("wrong-gate", 0.5)])[0]
    assert wrong.rig == scene.rig
    declared, true = declared_rig(wrong), declared_rig(scene)
    areas = [g["step_s"] * sum(g["value"]) for rig in (declared, true) for g in rig["gates"]]
    assert areas[0] / areas[1] == pytest.approx(1.5, abs=0.05)


def test_paths_are_axes_too() -> None:
    scene = load_scene("flat-wall")
    changed = stressed(scene, [("rig.pulses_per_slice", 50.0), ("target.wall.material.albedo", 0.25)])[0]
    assert changed.rig.pulses_per_slice == 50  # type: ignore[union-attr]
    assert changed.target[0].material.albedo == 0.25  # type: ignore[union-attr]


@pytest.mark.parametrize(
    ("axis", "unit"),
    [("photons", "1"), ("background", "e/s"), ("rig.detector.read_noise_e", "e"), ("rig.ambient_e_per_s", "e/s"),
     ("medium.absorption_per_m", "1/m"), ("rig.t0_s", "s"), ("target.0.shape.tilt_y_deg", "deg"),
     ("rig.pulses_per_slice", "1")],
)  # fmt: skip
def test_units(axis: str, unit: str) -> None:
    assert axis_unit(axis) == unit


@pytest.mark.parametrize(
    ("axis", "says"),
    [("phootns", "did you mean photons"), ("rig.detectr.read_noise_e", "did you mean detector"),
     ("rig.camera.vignetting", "lead to a number")],
)  # fmt: skip
def test_bad_axes_are_refused(axis: str, says: str) -> None:
    with pytest.raises(InputError, match=says):
        axis_overrides(load_scene("flat-wall"), axis, 0.3)


def test_a_level_that_no_scene_can_have_is_refused() -> None:
    with pytest.raises(InputError, match="does not fit"):
        stressed(load_scene("flat-wall"), [("background", -1.0)])
    with pytest.raises(InputError, match="does not apply"):
        stressed(load_scene("amcw"), [("delay-step", 2.0)])


def test_five_lines_make_a_suite() -> None:
    loaded = load_suite(
        {
            "suite": "my-axis",
            "scenes": ["flat-wall"],
            "estimators": ["peak"],
            "stresses": [{"axis": "photons", "values": [1.0, 0.1]}],
            "seeds": {"test": [1]},
        }
    )
    cells = cells_of(loaded)
    assert [cell.level for cell in cells[1:]] == [1.0, 0.1] and math.isnan(cells[0].level)
    assert cells[1].scene == cells[0].scene and cells[2].scene != cells[0].scene


def test_the_stress_suites_load_and_hold_their_seeds_apart() -> None:
    names = [name for name in list_suites() if name.startswith("stress-")]
    assert {f"stress-{what}" for what in STRESSES} <= set(names)
    for name in names:
        suite = load_suite(name).suite
        assert suite.suite == name and (SUITES / f"{name}.toml").is_file()
        assert suite.stresses and suite.seeds.dev and not set(suite.seeds.dev) & set(suite.seeds.test)
