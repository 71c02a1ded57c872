"""A beam turned about both axes has one direction in all models: camera, footprint, backscatter, path tracer."""

from __future__ import annotations

import numpy as np
import pytest

from beambench.generator.gated.view import view_of
from beambench.generator.ranger import footprint
from beambench.generator.rays.lamp import RoundBeam
from beambench.optics import illumination
from beambench.scenes.load import load_scene
from beambench.scenes.rigs.gated import gated_rig
from beambench.scenes.rigs.parts import Illumination

OFFSET = (0.31, -0.22)
#: The beam's axis by hand: azimuth .31 to the right, then .22 up from the horizontal plane (y points down).
AXIS = np.array([np.sin(0.31) * np.cos(0.22), -np.sin(0.22), np.cos(0.31) * np.cos(0.22)])


def test_the_axis_and_its_rotation() -> None:
    np.testing.assert_allclose(illumination.beam_axis(OFFSET), AXIS, atol=1e-15)
    turn = illumination.beam_rotation(OFFSET)
    np.testing.assert_allclose(turn @ turn.T, np.eye(3), atol=1e-15)
    np.testing.assert_allclose(turn @ [0.0, 0.0, 1.0], AXIS, atol=1e-15)
    assert np.linalg.det(turn) == pytest.approx(1.0)
    # It is not the axis (tan a, tan b, 1), which lies off by half an angle of the field here.
    other = np.array([np.tan(0.31), np.tan(-0.22), 1.0])
    assert float(illumination.off_axis_angle(other, AXIS)) > 5e-3


def test_echo_footprint_and_path_tracer_agree_with_it() -> None:
    spec = Illumination(profile="gaussian", half_angle_rad=0.05, offset_rad=OFFSET)
    rng = np.random.default_rng(3)
    direction = rng.normal(size=(3, 200)) * 0.1 + AXIS[:, None]
    direction /= np.linalg.norm(direction, axis=0)
    exact = np.arccos(np.clip(AXIS @ direction, -1.0, 1.0))
    # arccos loses digits near the axis: 1e-7.
    np.testing.assert_allclose(RoundBeam(spec).angle(direction), exact, atol=1e-7)
    # A footprint that fills the beam, narrower than the field, is centred on the axis.
    local, _ = footprint._cone(RoundBeam(spec.model_copy(update={"half_angle_rad": 0.01})), 0.5, 4096)
    centre = local.mean(axis=1)
    # The lattice of 4096 rays balances to 1e-2 of its radius of .026.
    np.testing.assert_allclose(centre / np.linalg.norm(centre), AXIS, atol=3e-4)
    scene = load_scene("flat-wall", {"rig.laser.illumination": spec.model_dump(mode="json")})
    lamp = view_of(scene).lamp.on_device()
    np.testing.assert_allclose(np.asarray([float(v[0]) for v in lamp.axis]), AXIS, atol=1e-6)


def test_the_brightest_pixel_and_the_brightest_veil_lie_on_it() -> None:
    from beambench.generator.gated.gates import gate_tables
    from beambench.generator.gated.stack import slice_coordinates, slice_settings
    from beambench.generator.water.ramp import backscatter_electrons

    changes = {
        "rig.laser.illumination": {"profile": "gaussian", "half_angle_rad": 0.06, "offset_rad": list(OFFSET)},
        "rig.camera.rows": 101, "rig.camera.cols": 101, "rig.camera.focal_length_m": 1.5e-3, "rig.delays.count": 1,
        "rig.delays.start_s": 20e-9,
        "medium.scattering_per_m": 0.1, "medium.phase_function": {"kind": "henyey-greenstein", "g": 0.0},
    }  # fmt: skip
    scene = load_scene("flat-wall", changes)
    coords = slice_coordinates(scene)
    delay, scale = slice_settings(scene, coords, 0, 0)
    veil = backscatter_electrons(
        scene, view_of(scene), scene.medium.phase, gate_tables(scene), coords["gate"], delay, scale,
        np.full((101, 101), np.nan), None, forward=False,
    )[0]  # fmt: skip
    row, col = np.unravel_index(int(np.argmax(veil)), veil.shape)
    camera = gated_rig(scene).camera
    pixels = camera.focal_length_m / camera.pixel_pitch_m
    assert col == pytest.approx(50 + pixels * AXIS[0] / AXIS[2], abs=1.0)
    assert row == pytest.approx(50 + pixels * AXIS[1] / AXIS[2], abs=1.0)
