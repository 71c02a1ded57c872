"""Changes from slice to slice and within a pixel: a moving platform, and a screen in front of the target."""

from __future__ import annotations

import json

import numpy as np
import pytest

from beambench.generator.gated.motion import moved
from beambench.generator.generate import generate
from beambench.optics.constants import C_M_PER_S
from beambench.optics.correlation.response import correlation
from beambench.scenes.errors import InputError
from beambench.scenes.load import load_scene
from beambench.scenes.medium_index import group_index
from beambench.scenes.rigs.gated import gated_rig
from beambench.scenes.sampling import optics_gate, optics_pulse
from beambench.scenes.scene import Scene

SMALL = {
    "rig.camera.rows": 5,
    "rig.camera.cols": 5,
    "rig.ambient_e_per_s": 0.0,
    "rig.detector.dark_current_e_per_s": 0.0,
}
SCREEN = {"distance_m": 4.7, "coverage": 0.4, "albedo": 0.2}


def _expected(scene: Scene) -> np.ndarray:
    capture = generate(scene, seed=1, capture_key=1, truth_electrons=True)
    return np.asarray(capture["truth_electrons"].values, dtype=np.float64)


def test_absent_options_leave_no_trace_in_the_data() -> None:
    data = load_scene("flat-wall").model_dump(mode="json")
    assert "motion_m_per_s" not in data["rig"] and "screen" not in data["rig"]
    still = load_scene("flat-wall", {"rig.motion_m_per_s": [0.0, 0.0, 3.0], "rig.screen": SCREEN})
    assert load_scene(still.model_dump(mode="json")) == still


def test_a_platform_at_rest_gives_the_still_stack() -> None:
    still = load_scene("flat-wall", SMALL)
    rest = load_scene("flat-wall", {**SMALL, "rig.motion_m_per_s": [0.0, 0.0, 0.0]})
    # Slice by slice the table is read from another origin: single precision, a few 1e-5 of the peak.
    np.testing.assert_allclose(_expected(rest), _expected(still), atol=5e-5 * _expected(still).max())


def test_approach_follows_the_closed_form() -> None:
    # Pixel on the axis: S_k = α (r₀/r_k)² R(2 n_g r_k/c − t_k), r_k = r₀ − v (T_k − T̄). R's table errs by 1e-5 of its
    # peak and is read linearly with 2e-6 more; float32 and the pixel's own spread of range add a few 1e-5.
    speed = 8.0
    scene = load_scene("flat-wall", {**SMALL, "rig.motion_m_per_s": [0.0, 0.0, speed]})
    rig = gated_rig(scene)
    got = _expected(scene)[:, 2, 2]
    number = rig.delays.count
    delay = rig.delays.start_s + rig.delays.step_s * np.arange(number)
    time = rig.detector.exposure_s * np.arange(number)
    r = 5.0 - speed * (time - time.mean())
    index = group_index(scene.medium, rig.laser.wavelength_m)
    u = 2 * index * r / C_M_PER_S - delay
    shape = np.asarray(correlation(optics_pulse(rig.laser.pulse), optics_gate(rig.gates[0]), u)) * (5.0 / r) ** 2
    alpha = float(generate(load_scene("flat-wall", SMALL), seed=1)["truth_amplitude"].values[2, 2])
    np.testing.assert_allclose(got, alpha * shape, atol=2e-4 * got.max())


def test_truth_is_that_of_the_middle_and_sideways_motion_moves_the_picture() -> None:
    sideways = {"rig.motion_m_per_s": [1.0, 0.0, 0.0]}
    scene = load_scene("step", {"rig.camera.rows": 4, "rig.camera.cols": 64, **sideways})
    capture = generate(scene, seed=1)
    still = generate(load_scene("step", {"rig.camera.rows": 4, "rig.camera.cols": 64}), seed=1)
    np.testing.assert_array_equal(capture["truth_range"], still["truth_range"])
    # The rig goes to +x: later the edge of the near wall is seen farther to the left.
    edge = [float(moved(scene, t).target[0].shape.center_m[0]) for t in (-0.01, 0.01)]
    assert edge[1] - edge[0] == pytest.approx(-0.02)
    effects = {e["name"]: e for e in json.loads(capture.attrs["fidelity"])["effects"]}
    assert effects["motion between slices"]["modelled"]


def test_a_screen_shares_each_pixel_with_the_target() -> None:
    wall = _expected(load_scene("flat-wall", SMALL))
    alone = {"target.wall.shape.center_m": [0.0, 0.0, 4.7], "target.wall.material.albedo": 0.2}
    screen = _expected(load_scene("flat-wall", {**SMALL, **alone}))
    both = generate(load_scene("flat-wall", {**SMALL, "rig.screen": SCREEN}), seed=1, truth_electrons=True)
    np.testing.assert_allclose(both["truth_electrons"], 0.6 * wall + 0.4 * screen, atol=1e-5 * wall.max())
    # Truth and amplitude are the wall's; the screen's light is background, slice by slice.
    np.testing.assert_allclose(both["truth_background"], 0.4 * screen, atol=1e-5 * wall.max())
    bare = generate(load_scene("flat-wall", SMALL), seed=1)
    np.testing.assert_allclose(both["truth_amplitude"], 0.6 * bare["truth_amplitude"], rtol=1e-6)
    np.testing.assert_array_equal(both["truth_range"], bare["truth_range"])


def test_a_screen_is_what_fine_slats_are() -> None:
    # One slat per column, 40 % of the column wide at its range, seen by a camera ten times finer whose pixels are added up:
    # the fine pixels' borders are the slats' edges.
    pitch = 13.0e-6 / 2.5e-3
    slat = {"kind": "rectangle", "width_m": 0.4 * pitch * 4.7, "height_m": 3.0, "tilt_x_deg": 0.0, "tilt_y_deg": 0.0}
    fine = {**SMALL, "rig.camera.rows": 50, "rig.camera.cols": 50, "rig.camera.pixel_pitch_m": 13.0e-7}
    base = load_scene("flat-wall", fine).model_dump(mode="json")
    base["target"] += [
        {
            "name": f"slat{c}",
            "shape": {**slat, "center_m": [(c - 2) * pitch * 4.7, 0.0, 4.7]},
            "material": {"kind": "lambert", "albedo": 0.2},
        }
        for c in range(5)
    ]
    slats = _expected(load_scene(base)).reshape(-1, 5, 10, 5, 10).sum(axis=(2, 4))
    net = _expected(load_scene("flat-wall", {**SMALL, "rig.screen": SCREEN}))
    # Light falls by (1 + x²)² toward a pixel's border, and rays on a slat's very edge may miss it: 1 % of the peak.
    np.testing.assert_allclose(slats, net, atol=0.01 * net.max())


@pytest.mark.parametrize(
    ("changes", "fidelity", "told"),
    [({"rig.screen": SCREEN}, "scatter", "direct rung"), ({"rig.motion_m_per_s": [0.0, 0.0, 1.0]}, "full", "direct rung"),
     ({"rig.screen": SCREEN, "rig.motion_m_per_s": [0.0, 0.0, 1.0]}, "direct", "not both"),
     ({"rig.screen": SCREEN, "rig.laser.position_m": [0.1, 0.0, 0.0]}, "direct", "one axis"),
     ({"rig.motion_m_per_s": [0.0, 0.0, 1000.0]}, "direct", "past its target")],
)  # fmt: skip
def test_what_is_not_modelled_is_refused(changes: dict[str, object], fidelity: str, told: str) -> None:
    with pytest.raises(InputError, match=told):
        generate(load_scene("flat-wall", {**SMALL, **changes}), seed=1, fidelity=fidelity)  # type: ignore[arg-type]
