"""The choice between rungs: predicted against measured errors, and the record of the choice."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from beambench.generator.checked import checked
from beambench.generator.choice import Choice, Rtol
from beambench.generator.gated.pilot import pilot_scene
from beambench.generator.generate import generate
from beambench.generator.models import model_of
from beambench.generator.ranger.amcw_sizes import amcw_instrument
from beambench.generator.ranger.choose import ranger_sizes
from beambench.generator.ranger.waveform_sizes import waveform_instrument
from beambench.scenes.errors import InputError
from beambench.scenes.load import load_scene
from beambench.scenes.rigs.gated import gated_rig
from beambench.scenes.scene import Scene

SMALL = {"rig.camera.rows": 24, "rig.camera.cols": 24, "rig.camera.focal_length_m": 9e-4}


def corner(albedo: float) -> Scene:
    half = np.sqrt(0.125)
    walls = [
        {
            "name": name,
            "shape": {
                "kind": "rectangle", "center_m": [x, 0.0, 5.0 - half], "width_m": 1.0, "height_m": 1.0,
                "tilt_x_deg": 0.0, "tilt_y_deg": tilt,
            },
            "material": {"kind": "lambert", "albedo": albedo},
        }
        for name, x, tilt in (("left", -half, -45.0), ("right", half, 45.0))
    ]  # fmt: skip
    return load_scene("flat-wall", SMALL | {"target": walls, "rig.delays.start_s": 30e-9, "rig.delays.count": 40})


def water(absorption: float, scattering: float) -> Scene:
    medium = {
        "name": "water", "index": {"kind": "explicit", "phase": 1.34, "group": 1.36},
        "absorption_per_m": absorption, "scattering_per_m": scattering,
        "phase_function": {"kind": "fournier-forand", "index": 1.1, "slope": 3.58},
    }  # fmt: skip
    place = {"target.0.shape.center_m": [0.0, 0.0, 3.0], "rig.delays.start_s": 22e-9, "rig.delays.count": 40}
    return load_scene("flat-wall", SMALL | {"medium": medium} | place)


def choose(scene: Scene, rtol: Rtol, seed: int, key: int) -> Choice:
    """The choice of `generate`."""
    request = checked(scene, seed=seed, capture_key=key, fidelity="auto", rtol=rtol)
    return model_of(scene.modality).choose(scene, request)


def electrons(scene: Scene, rung: Any, seed: int, rtol: float) -> np.ndarray[Any, Any]:
    return generate(scene, seed=seed, fidelity=rung, rtol=rtol, truth_electrons=True)["truth_electrons"].values.astype(
        float
    )


def without_ambient(scene: Scene) -> Scene:
    rig = gated_rig(scene)
    dark = rig.detector.model_copy(update={"dark_current_e_per_s": 0.0})
    return scene.model_copy(update={"rig": rig.model_copy(update={"ambient_e_per_s": 0.0, "detector": dark})})


def test_convex_scene_in_air_needs_one_bounce_and_no_pilot() -> None:
    choice = choose(load_scene("flat-wall", SMALL), 1e-3, 1, 1)
    assert choice.rung == "direct" and choice.predicted == {"direct": 0.0}


@pytest.mark.parametrize(("albedo", "rtol", "rung"), [(0.8, 0.1, "full"), (0.02, 0.03, "direct"), (0.02, 2e-3, "full")])
def test_corner(albedo: float, rtol: float, rung: str) -> None:
    assert choose(corner(albedo), rtol, 1, 1).rung == rung


@pytest.mark.parametrize(
    ("absorption", "scattering", "rtol", "rung"),
    [(0.0445, 0.0017, 0.05, "direct"), (0.114, 0.037, 0.05, "scatter"), (0.366, 1.824, 0.005, "full")],
)
def test_water(absorption: float, scattering: float, rtol: float, rung: str) -> None:
    assert choose(water(absorption, scattering), rtol, 1, 1).rung == rung


@pytest.mark.parametrize("scene", [corner(0.8), corner(0.1), water(0.114, 0.037)], ids=["bright", "dark", "water"])
def test_predicted_error_is_the_measured_one(scene: Scene) -> None:
    """ε of the direct rung at full resolution against two independent full captures: within a fifth of the pilot's."""
    scene = without_ambient(scene)
    predicted = choose(scene, 0.01, 7, 7).predicted["direct"]
    x = electrons(scene, "direct", 1, 2e-3)
    one, two = (electrons(scene, "full", seed, 0.02) for seed in (1, 2))
    measured = np.sqrt(np.sum((x - one) * (x - two)) / np.sum(one * two))
    assert predicted == pytest.approx(measured, rel=0.2)


def test_auto_records_its_choice() -> None:
    scene = corner(0.8)
    capture = generate(scene, seed=2, fidelity="auto", rtol=0.05)
    told = json.loads(capture.attrs["fidelity"])
    assert told["rung"] == "full"
    assert told["chosen"]["predicted_error"]["direct"] > 0.05
    effects = {e["name"]: e for e in told["effects"]}
    assert effects["interreflection"]["modelled"] and effects["interreflection"]["predicted_relative_size"] > 0.05
    assert told["chosen"]["predicted_error"]["full"] < 0.05
    # the choice only adds its pilot: the capture equals that of the explicit rung
    same = generate(scene, seed=2, fidelity="full", rtol=0.05)
    assert np.array_equal(same["counts"].values, capture["counts"].values)


def test_noise_as_the_limit() -> None:
    """Ten times the light has √10 less relative noise, so a rung that passed may no longer."""
    scene = corner(0.3)
    limits = [
        choose(
            scene.model_copy(update={"rig": gated_rig(scene).model_copy(update={"pulses_per_slice": n})}), "noise", 1, 1
        ).limit
        for n in (1000, 10_000)
    ]
    assert limits[0] == pytest.approx(np.sqrt(10) * limits[1], rel=0.1)
    choice = choose(scene, "noise", 1, 1)
    assert choice.limit > 0.02 and choice.sampled == pytest.approx(0.06 * choice.limit)
    assert choice.rung == "full" or choice.task[choice.rung] <= 0.1
    with pytest.raises(InputError, match="noise"):
        generate(scene, seed=1, fidelity="direct", rtol="noise")


def test_pilot_sees_what_the_camera_sees() -> None:
    scene = load_scene("flat-wall")
    camera, small = gated_rig(scene).camera, gated_rig(pilot_scene(scene)).camera
    assert max(small.rows, small.cols) <= 12
    assert small.rows * small.pixel_pitch_m >= camera.rows * camera.pixel_pitch_m


def test_noise_needs_an_unbiased_answer_too() -> None:
    """A bright corner seen with few photons: light between the walls hides below the noise of a sample, yet moves the answer by
    more than a tenth of the bound with many slices; with a thousandth of the light it does not."""
    scene = corner(0.3)
    bright = choose(scene, "noise", 1, 1)
    assert bright.predicted["direct"] < bright.limit or bright.rung == "full"
    assert bright.task["direct"] > 0.1 and bright.rung == "full"
    dim = scene.model_copy(update={"rig": gated_rig(scene).model_copy(update={"pulses_per_slice": 1})})
    found = choose(dim, "noise", 1, 1)
    assert found.rung == "direct" and found.task["direct"] <= 0.08


def test_a_moving_rig_is_refused_what_its_only_rung_leaves_out() -> None:
    moving = load_scene(corner(0.8), {"rig.motion_m_per_s": [0.0, 0.0, 0.01]})
    with pytest.raises(InputError, match="direct rung only"):
        choose(moving, 0.01, 1, 1)
    assert choose(load_scene(corner(0.02), {"rig.motion_m_per_s": [0.0, 0.0, 0.01]}), 0.1, 1, 1).rung == "direct"


WATER = {
    "name": "water", "index": {"kind": "explicit", "phase": 1.34, "group": 1.36}, "absorption_per_m": 0.1,
    "phase_function": {"kind": "fournier-forand", "index": 1.1, "slope": 3.58},
}  # fmt: skip


@pytest.mark.parametrize(("name", "instrument"), [("photodetector-5m", waveform_instrument), ("amcw", amcw_instrument)])
def test_rangers_are_judged_by_closed_forms(name: str, instrument: Any) -> None:
    """Faint scattering passes, more needs the scatter rung; turbid water is refused with the largest effect named."""
    faint, turbid = (load_scene(name, {"medium": WATER | {"scattering_per_m": b}}) for b in (1e-6, 0.5))
    choice = choose(faint, 0.05, 1, 1)
    assert choice.rung == "direct" and choice.predicted["direct"] < 0.05
    names = {"interreflection", "forward-scattered light", "volume backscatter", "multiple scattering"}
    assert set(choice.sizes) == names
    between = choose(load_scene(name, {"medium": WATER | {"scattering_per_m": 0.05}}), 0.05, 1, 1)
    assert between.rung == "scatter" and between.predicted["scatter"] < 0.05 < between.predicted["direct"]
    with pytest.raises(InputError, match=r"upper rung of this modality, scatter, leaves out .*: "):
        choose(turbid, 0.05, 1, 1)
    twice = load_scene(name, {"medium": WATER | {"scattering_per_m": 2e-6}})
    more = ranger_sizes(twice, instrument(twice))
    for effect in ("forward-scattered light", "volume backscatter"):
        assert more[effect] == pytest.approx(2 * choice.sizes[effect], rel=0.01)


def test_ranger_in_clear_air_needs_one_bounce() -> None:
    choice = choose(load_scene("photodetector-5m"), "noise", 1, 1)
    assert choice.rung == "direct" and choice.predicted["direct"] == 0.0 and choice.limit > 0


def test_noise_from_the_front_door(tmp_path: Path) -> None:
    """`beambench generate --fidelity auto --rtol noise`, and the same again from the store's own records."""
    from beambench.cli import main

    store = str(tmp_path / "noise.zarr")
    small = ["--set", "rig.camera.rows=12", "--set", "rig.camera.cols=12"]
    assert main(["generate", "flat-wall", "--fidelity", "auto", "--rtol", "noise", *small, "-o", store]) == 0
    assert main(["generate", "--like", store]) == 0
    assert main(["generate", "flat-wall", "--rtol", "noise", *small, "-o", str(tmp_path / "no.zarr")]) == 2
