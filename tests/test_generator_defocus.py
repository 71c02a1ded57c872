"""Truth and stated errors of captures by a finite lens or lamp: amplitude and times of the light as they see it, against closed
forms; background that is none of it; standard errors against the scatter of seeds."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
import xarray as xr
from numpy.typing import NDArray
from scipy.stats import chi2

from beambench.benchmarks.judges.bound import cramer_rao_bound
from beambench.captures.hide import hide_truth
from beambench.estimators import run_estimator
from beambench.generator.gated.full import Limits, Remainder, render_remainder
from beambench.generator.gated.gates import response_width_s
from beambench.generator.generate import generate
from beambench.scenes.load import load_scene
from beambench.scenes.rigs.gated import gated_rig
from beambench.scenes.scene import Scene

from ._gate_closed_form import electrons_per_radiance, slices_of

C = 299_792_458.0
Float = NDArray[np.float64]

MATT = {"kind": "lambert", "albedo": 0.6}


def wall(name: str, x: float, z: float, width: float) -> dict[str, Any]:
    shape = {"kind": "rectangle", "center_m": [x, 0.0, z], "width_m": width, "height_m": 20.0}
    return {"name": name, "material": MATT, "shape": shape | {"tilt_x_deg": 0.0, "tilt_y_deg": 0.0}}


def edge(**more: Any) -> Scene:
    """A wall at 4.7 m on the left before one at 5 m on the right, a lens of f = 12.5 mm, f/8, in focus at 30 cm: the edge is
    blurred over 1.5 pixels on either side. R is about 1.2 m wide."""
    changes: dict[str, Any] = {
        "target": [wall("far", 0.0, 5.0, 20.0), wall("near", -5.0, 4.7, 10.0)],
        "rig.camera.rows": 8, "rig.camera.cols": 16, "rig.camera.focal_length_m": 0.0125, "rig.camera.f_number": 8.0,
        "rig.camera.pixel_pitch_m": 2e-5, "rig.camera.focus_distance_m": 0.3,
        "rig.laser.pulse_energy_j": 20 * 16 * gated_rig(load_scene("flat-wall")).laser.pulse_energy_j,
    }  # fmt: skip
    return load_scene("flat-wall", changes | more)


def blur_px(scene: Scene, z: float) -> float:
    """ρ = (f/2N) · |1/z − 1/z_f| · f/p."""
    camera = gated_rig(scene).camera
    assert camera.focus_distance_m is not None
    wide = 0.5 * camera.focal_length_m**2 / (camera.f_number * camera.pixel_pitch_m)
    return wide * abs(1 / z - 1 / camera.focus_distance_m)


def columns(scene: Scene) -> Float:
    """Distance of each column's middle from the edge [px]."""
    cols = gated_rig(scene).camera.cols
    return np.arange(cols) - 0.5 * (cols - 1)


@pytest.fixture(scope="module")
def blurred() -> list[xr.Dataset]:
    scene = edge()
    return [generate(scene, seed=seed, fidelity="full", rtol=5e-3, truth_electrons=True) for seed in range(4)]


def test_what_a_lens_moves_is_no_background(blurred: list[xr.Dataset]) -> None:
    """The walls show each other's backs: what there is beside ambient and dark light is what a pinhole's full rung finds, within
    six standard errors of both, and never below that light."""
    pinhole = generate(edge(**{"rig.camera.focus_distance_m": None}), seed=9, fidelity="full", rtol=5e-3)
    level = generate(edge(), seed=9, fidelity="direct")["truth_background"].values
    bare = level.reshape(-1, 1, 1)
    for capture in blurred:
        background = capture["truth_background"].values
        assert (background >= bare * (1 - 1e-6)).all()
        assert (capture["truth_electrons"].values >= background).all()
        error = np.hypot(capture["truth_standard_error"].values, pinhole["truth_standard_error"].values)
        assert (np.abs(background - pinhole["truth_background"].values) <= 6 * error + 1e-5 * bare).all()
        assert error.max() < 0.02 * capture["truth_amplitude"].values.max()


def test_pixels_are_mixed_as_far_as_the_blur_reaches(blurred: list[xr.Dataset]) -> None:
    """A column is mixed where a disc of ρ about a point of it crosses the edge; discs just touching it are left out, the walls'
    two radii and the sampling decide there."""
    scene = edge()
    near, far = (blur_px(scene, z) for z in (4.7, 5.0))
    x = np.abs(columns(scene))
    inside, outside = x < 0.5 + near - 0.4, x > 0.5 + far + 0.1
    assert 2 <= inside.sum() <= 6 and outside.sum() >= 10
    along = np.sqrt(1.0 + (columns(scene) * 2e-5 / 0.0125) ** 2)
    for capture in blurred:
        mixed = capture["truth_mixed"].values
        assert mixed[:, inside].all() and not mixed[:, outside].any()
        first, last = capture["truth_first"].values, capture["truth_last"].values
        # Slant within a pixel and row: 1.5 px of 1.6 mrad each way, at most 15 px off the axis.
        assert np.abs(first - 4.7 * along)[:, inside].max() < 5e-3
        assert np.abs(last - 5.0 * along)[:, inside].max() < 5e-3
        single = (last - first)[:, outside]
        assert single.min() >= 0.0 and single.max() < 5e-3


def test_unmixed_pixels_reach_the_bound(blurred: list[xr.Dataset]) -> None:
    """Maximum likelihood over the near wall's unmixed pixels, four seeds: rms of error/bound 1 within 4/√(2n) and 2 % for the
    noise of the traced difference. (Light by way of the near wall's back makes the far wall look farther, with a pinhole too.)"""
    scores = []
    for capture in blurred:
        bound = cramer_rao_bound(capture)
        assert bound.kind == "quasi"
        error = (run_estimator("poisson-ml", hide_truth(capture))["range"] - capture["truth_range"]).values
        mine = ~capture["truth_mixed"].values & (columns(edge()) < 0)
        scores.append((error / bound.sigma)[mine])
    score = np.concatenate(scores)
    assert len(score) == 4 * 8 * 6
    assert np.sqrt(np.mean(score**2)) == pytest.approx(1.0, abs=4 / np.sqrt(2 * len(score)) + 0.02)


def test_amplitude_is_the_light_that_the_lens_lets_in() -> None:
    """A wall that ends at x = 0, at twice the focus, nothing behind it: the edge under a disc of radius aperture·|1 − z/z_f|;
    5 stated errors and .4 % for the cosines of rays through the lens. One surface is not mixed, however blurred."""
    z, aperture = 5.0, 0.05
    scene = edge(
        **{
            "target": [wall("half", 10.0, z, 20.0)], "rig.camera.rows": 1, "rig.camera.cols": 32,
            "rig.camera.focal_length_m": 0.1, "rig.camera.f_number": 1.0, "rig.camera.pixel_pitch_m": 1.2e-4,
            "rig.camera.focus_distance_m": 0.5 * z,
        },
    )  # fmt: skip
    capture = generate(scene, seed=1, fidelity="full", rtol=5e-3, truth_electrons=True, truth_components=True)
    whole = 0.6 / np.pi / z**2 * electrons_per_radiance(scene)
    x = (np.arange(32 * 50) + 0.5) / 50 - 16.0
    u = np.clip(x * 1.2e-4 / 0.1 * z / aperture, -1, 1)  # the edge in units of the disc's radius
    share = (0.5 + (u * np.sqrt(1 - u * u) + np.arcsin(u)) / np.pi).reshape(32, 50).mean(axis=1)
    error = capture["truth_standard_error"].values[0]
    got = capture["truth_amplitude"].values[0]
    assert error.max() < 0.02 * whole
    assert (np.abs(got - share * whole) < 5 * error + 4e-3 * whole).all()
    assert (got >= 0.0).all() and np.abs(share - (columns(scene) > 0)).max() > 0.4
    assert not capture["truth_mixed"].any()
    seen = share > 0.05
    assert np.isfinite(capture["truth_first"].values[0, seen]).all()
    # Kept apart, its light and the background are all there is.
    total = capture["truth_direct"].values + capture["truth_background"].values
    assert (
        np.allclose(total, capture["truth_electrons"].values, rtol=1e-5) and (capture["truth_direct"].values >= 0).all()
    )


def test_a_wide_lamp_spans_its_own_delays() -> None:
    """A disc of radius ρ before a wall at z: light from s comes z + √(z² + s²) far with (z/√(z² + s²))³ of the weight. Paths
    end at ρ; a ten-thousandth of the lamp's points lie within ρ·5e-5 of its rim."""
    z, radius = 3.0, 0.9
    scene = edge(
        **{
            "target": [wall("wall", 0.0, z, 20.0)], "rig.camera.cols": 4, "rig.camera.focus_distance_m": None,
            "rig.laser.source_radius_m": radius, "rig.laser.illumination.half_angle_rad": 0.8, "rig.gates.0.width_s": 0.4e-9,
            "rig.camera.pixel_pitch_m": 1e-6,
        },
    )  # fmt: skip
    capture = generate(scene, seed=1, fidelity="full", rtol=5e-3)
    s2 = radius**2 * (np.arange(2000) + 0.5) / 2000
    far = np.sqrt(z * z + s2)
    expected = 0.6 / np.pi * electrons_per_radiance(scene) * float(np.mean(z / far**3))
    error = capture["truth_standard_error"].values
    assert np.abs(capture["truth_amplitude"].values - expected).max() < 5 * error.max() + 1e-3 * expected
    assert expected < 0.95 * 0.6 / np.pi * electrons_per_radiance(scene) / z**2
    assert capture["truth_first"].values == pytest.approx(np.full((8, 4), z), abs=1e-4)
    assert capture["truth_last"].values == pytest.approx(np.full((8, 4), 0.5 * (z + np.hypot(z, radius))), abs=1e-3)
    half = 0.5 * C / 1.00028
    wide = 0.5 * (np.hypot(z, radius) - z) > 0.05 * response_width_s(scene)[1] * half
    assert (capture["truth_mixed"].values == wide).all()


def scatter(scene: Scene, seeds: int, samples: int) -> tuple[list[Remainder], Float]:
    """Runs over seeds, and the standard deviation (slices, rows, cols) of their light."""
    slices, camera = slices_of(scene), gated_rig(scene).camera
    nothing = np.zeros((len(slices.delay_s), camera.rows, camera.cols), dtype=np.float32)
    limits = Limits(most_samples=samples)
    runs = [render_remainder(scene, nothing, slices, 1e-9, seed, 0, limits=limits) for seed in range(seeds)]
    return runs, np.stack([run.light for run in runs]).std(axis=0, ddof=1, dtype=float)


def assert_stated(actual: Float, stated: Float, seeds: int, slack: float) -> None:
    """No pixel's scatter is above its stated error by more than χ² of seeds − 1 allows (1e-5 over all), and the stated ones are
    not idle: below `slack` times the scatter, in the rms."""
    limit = np.sqrt(chi2.ppf(1 - 1e-5 / actual.size, seeds - 1) / (seeds - 1))
    floor = 1e-5 * actual.max()  # float32
    assert (actual <= limit * stated + floor).all(), float((actual / np.maximum(stated, floor)).max())
    assert np.sqrt(np.mean(actual**2)) < 1.1 * np.sqrt(np.mean(stated**2))
    assert np.sqrt(np.mean(stated**2)) < slack * np.sqrt(np.mean(actual.max(axis=0) ** 2))


def test_stated_error_holds_what_the_lens_adds() -> None:
    """Scatter of 12 seeds in every slice, and at an open gate. An edge between walls as bright as each other: what the lens moves
    shows in slices, hardly at an open gate."""
    runs, actual = scatter(edge(), 12, 256)
    stated = np.sqrt(np.mean([run.sigma**2 for run in runs], axis=0))
    assert_stated(actual, np.broadcast_to(stated, actual.shape), 12, 4.0)
    finite = [run.finite for run in runs]
    whole = np.stack([one.amplitude for one in finite if one is not None]).std(axis=0, ddof=1)
    assert_stated(whole[None], stated[None], 12, 20.0)


def test_stated_error_holds_the_shadow_in_the_water() -> None:
    """A dark post beside the view keeps the lamp from half of the water in it: in thin water the traced shadow is nearly all
    of the noise (12 seeds)."""
    index = 1.36
    medium = {
        "name": "water", "index": {"kind": "explicit", "phase": 1.34, "group": index}, "absorption_per_m": 0.05,
        "scattering_per_m": 0.002, "phase_function": {"kind": "henyey-greenstein", "g": 0.5},
    }  # fmt: skip
    post = wall("post", 0.32, 1.2, 0.3)
    post["material"] = {"kind": "lambert", "albedo": 0.001}
    scene = edge(
        **{
            "medium": medium, "target": [post], "rig.camera.cols": 4, "rig.camera.focus_distance_m": None,
            "rig.camera.pixel_pitch_m": 1e-3, "rig.laser.position_m": [0.5, 0.0, 0.0],
            "rig.laser.illumination.half_angle_rad": 0.5, "rig.delays.start_s": 2.6 * index / C,
            "rig.delays.step_s": 0.25 * index / C, "rig.delays.count": 8,
        },
    )  # fmt: skip
    runs, actual = scatter(scene, 12, 256)
    stated = np.sqrt(np.mean([run.sigma**2 for run in runs], axis=0))
    assert_stated(actual, np.broadcast_to(stated, actual.shape), 12, 6.0)


@pytest.mark.parametrize(
    ("more", "kind"),
    [
        ({}, "exact"),
        ({"rig.motion_m_per_s": [0.0, 0.0, 0.1]}, "quasi"),
        ({"rig.screen": {"distance_m": 2.0, "coverage": 0.3, "albedo": 0.2}}, "quasi"),
        ({"rig.laser.source_radius_m": 0.01}, "quasi"),
        ({"rig.camera.focus_distance_m": 3.0}, "quasi"),
    ],
)
def test_a_bound_is_exact_for_what_its_mean_is_of(more: dict[str, Any], kind: str) -> None:
    size = {"rig.camera.rows": 2, "rig.camera.cols": 2}
    capture = generate(load_scene("flat-wall", size | more), seed=1)
    assert cramer_rao_bound(capture).kind == kind
