"""Predicted change of the direct light by a finite lens and lamp against the full rung, and the choice that follows."""

from __future__ import annotations

import json
from typing import Any

import numpy as np
import pytest

from beambench.generator.gated.choose import choose
from beambench.generator.gated.direct import render_direct
from beambench.generator.gated.effects import catalogue
from beambench.generator.gated.finite_size import defocus_size, finite_size, lamp_size
from beambench.generator.gated.full import Limits, Slices, render_remainder
from beambench.generator.gated.stack import expected_electrons, slice_coordinates
from beambench.generator.generate import generate
from beambench.scenes.load import load_scene
from beambench.scenes.scene import Scene

FLAT: dict[str, Any] = {"kind": "rectangle", "tilt_x_deg": 0.0, "tilt_y_deg": 0.0}
MATT = {"kind": "lambert", "albedo": 0.5}


def scene_of(focus: float | None = None, lamp: float = 0.0, apart: float = 0.0, **more: Any) -> Scene:
    """A half wall at 3 m before a wall at 5 m, in air; pixels of 10 mrad, a lens 50 mm wide: surfaces side by side that do not
    face each other."""
    target = [
        {"name": "near", "material": MATT, "shape": FLAT | {"center_m": [2.0, 0.0, 3.0], "width_m": 4.0, "height_m": 8.0}},
        {"name": "far", "material": MATT, "shape": FLAT | {"center_m": [0.0, 0.0, 5.0], "width_m": 8.0, "height_m": 8.0}},
    ]  # fmt: skip
    changes: dict[str, Any] = {
        "target": target, "rig.camera.rows": 24, "rig.camera.cols": 24, "rig.camera.focal_length_m": 0.05,
        "rig.camera.f_number": 1.0, "rig.camera.pixel_pitch_m": 5e-4, "rig.laser.source_radius_m": lamp,
        "rig.laser.position_m": [apart, 0.0, 0.0], "rig.delays.start_s": 16e-9, "rig.delays.step_s": 0.25e-9,
        "rig.delays.count": 96, "rig.laser.illumination.half_angle_rad": 0.3,
    }  # fmt: skip
    if focus is not None:
        changes["rig.camera.focus_distance_m"] = focus
    return load_scene("flat-wall", changes | more)


def traced(scene: Scene, samples: int = 4096) -> float:
    """ε of the direct stack by the full rung's own difference between finite and point, two halves against each other."""
    coords = slice_coordinates(scene)
    direct = render_direct(scene, 1e-3)
    light, ambient = expected_electrons(scene, direct, coords, 0, 0)
    light -= ambient.astype(np.float32)[:, None, None]
    slices = Slices(coords["actual"], np.ones(len(light)), coords["gate"], None)
    found = render_remainder(scene, light, slices, 1e-9, 1, 0, limits=Limits(most_samples=samples), parts=True)
    one, two = (half.astype(float) for half in found.halves)
    # Nothing bounces between parallel walls side by side, so that the remainder is the finite lens and lamp alone.
    assert not found.parts["interreflection"].any()
    return float(np.sqrt(max(np.sum(one * two), 0.0) / np.sum((light + one) * (light + two))))


@pytest.mark.parametrize("focus", [1.0, 1.8, 20.0])
def test_defocus_is_predicted(focus: float) -> None:
    """Within a fifth: what the near wall hides, and light from outside the image, are not followed."""
    scene = scene_of(focus)
    predicted, radius = defocus_size(scene, render_direct(scene, 1e-3))
    # ρ = f/2N · |1/z − 1/z_f| · f/p, at the wall that is farther out of focus
    assert radius == pytest.approx(2.5 * max(abs(1 / z - 1 / focus) for z in (3.0, 5.0)), rel=1e-3)
    assert predicted == pytest.approx(traced(scene), rel=0.2)
    assert predicted > 0.01


@pytest.mark.parametrize(("radius", "apart"), [(0.4, 0.0), (0.15, 0.6)], ids=["wide", "penumbra"])
def test_a_wide_lamp_is_predicted(radius: float, apart: float) -> None:
    """Within a fifth of what is traced: delays and the beam's width of a coaxial lamp, the penumbra of one apart."""
    scene = scene_of(None, radius, apart)
    predicted = lamp_size(scene, render_direct(scene, 1e-3))
    assert predicted == pytest.approx(traced(scene), rel=0.2)
    assert predicted > 0.003


def test_points_change_nothing_and_the_catalogue_says_so() -> None:
    for scene, rung, size, modelled in (
        (scene_of(), "direct", 0.0, False),
        (scene_of(1.8), "direct", None, False),
        (scene_of(1.8), "full", None, True),
    ):
        direct = render_direct(scene, 1e-2)
        told = {e["name"]: e for e in catalogue(scene, direct, rung)}["finite source and aperture"]
        assert told["modelled"] is modelled
        if size == 0.0:
            assert told["predicted_relative_size"] == 0.0
            assert told["basis"] == "point source and pinhole, as the scene says"
        else:
            assert told["predicted_relative_size"] == finite_size(scene, direct)[0] > 0.01
            assert "circle of confusion" in told["basis"]


def test_the_choice_goes_by_the_defocus() -> None:
    """In air, side by side: blur is all that one bounce leaves out. Strong defocus at 1 % takes the full rung; a focus near the
    walls, or a limit above the blur, does not; the error of the full rung is then below the requested one."""
    strong, slight = scene_of(1.8), scene_of(4.0, **{"rig.camera.f_number": 16.0})
    assert choose(strong, 0.01, 1, 1).rung == "full"
    assert choose(strong, 0.5, 1, 1).rung == "direct"
    few = choose(slight, 0.01, 1, 1)
    assert few.rung == "direct" and 0.0 < few.predicted["direct"] < 0.01
    assert choose(scene_of(), 0.01, 1, 1).predicted == {"direct": 0.0}
    capture = generate(strong, seed=1, fidelity="auto", rtol=0.02)
    told = json.loads(capture.attrs["fidelity"])
    assert told["rung"] == "full" and told["chosen"]["predicted_error"]["direct"] > 0.02
    assert choose(strong, "noise", 1, 1).rung == "full"


def test_the_pilot_adds_it() -> None:
    """A scene that needs a pilot (it might bounce light) and is out of focus."""
    tilted = scene_of(1.8, **{"target.0.shape.tilt_y_deg": 5.0})
    sharp = scene_of(None, **{"target.0.shape.tilt_y_deg": 5.0})
    blurred, plain = (choose(scene, 0.01, 1, 1) for scene in (tilted, sharp))
    assert blurred.rung == "full" and plain.rung == "direct"
    size = finite_size(tilted, render_direct(tilted, 1e-2))[0]
    assert blurred.predicted["direct"] == pytest.approx(float(np.hypot(plain.predicted["direct"], size)), rel=0.02)
