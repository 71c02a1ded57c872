"""The derivative of light by a share by which all ranges grow: drjit's, of traced paths, against finite differences of stacks."""

from __future__ import annotations

import importlib.util
from typing import Any

import numpy as np
import pytest

from beambench.scenes.errors import InputError
from beambench.scenes.grown import grown_scene
from beambench.scenes.load import load_scene
from beambench.scenes.scene import Scene

pytestmark = pytest.mark.skipif(importlib.util.find_spec("mitsuba") is None, reason="Mitsuba is not installed")


def _corner(lamp: list[float]) -> Scene:
    """Two bright plates that face each other at a right angle, in absorbing air."""
    material = {"kind": "lambert", "albedo": 0.8}
    plates = [
        {
            "name": name,
            "material": material,
            "shape": {
                "kind": "rectangle", "center_m": [side * 0.35, 0, 1.65], "width_m": 1.0, "height_m": 1.0, "tilt_x_deg": 0,
                "tilt_y_deg": -45 * side,
            },
        }
        for name, side in (("left", -1), ("right", 1))
    ]  # fmt: skip
    base = load_scene("flat-wall", {"medium.absorption_per_m": 0.1}).model_dump(mode="json")
    base["target"] = plates
    camera, laser = base["rig"]["camera"], base["rig"]["laser"]
    camera |= {"rows": 8, "cols": 8, "pixel_pitch_m": 0.05 * camera["focal_length_m"]}
    laser |= {
        "position_m": lamp,
        "illumination": {"profile": "gaussian", "half_angle_rad": 0.25, "offset_rad": [0.0, 0.0]},
    }
    base["rig"]["delays"] = {"start_s": 4e-9, "step_s": 0.6e-9, "count": 20}
    return load_scene(base)


def _background(scene: Scene, seed: int, rtol: float) -> tuple[np.ndarray, int]:
    """(background of the full rung (slice, row, col), paths per pixel)."""
    from beambench.generator.gated.expected import expect
    from beambench.generator.request import Request

    made = expect(scene, Request(seed, 5, "full", rtol))
    return np.asarray(made.truth["truth_background"], np.float64), int(made.traced["samples_per_pixel"])


def _paired(scene: Scene, share: float, rtol: float, seeds: range) -> tuple[np.ndarray, np.ndarray]:
    """(drjit's derivative, central difference of generated stacks) (seed, slice, row, col), with the same paths."""
    from beambench.generator.gated.growth import background_growth

    ours, other = [], []
    for seed in seeds:
        (far, samples), (near, _) = (_background(grown_scene(scene, by), seed, rtol) for by in (share, -share))
        other.append((far - near) / (2.0 * share))
        ours.append(background_growth(scene, "full", seed=seed, key=5, rtol=rtol, samples=samples).by_share)
    return np.array(ours), np.array(other)


def _scale(ours: np.ndarray, other: np.ndarray) -> tuple[float, float]:
    """(drjit's derivative over the difference, as one number; its standard error over the seeds)."""
    mean = other.mean(axis=0)
    top, bottom = ((each * mean).sum(axis=(1, 2, 3)) for each in (ours, other))
    ratio = float(top.sum() / bottom.sum())
    left = top - ratio * bottom
    return ratio, float(np.sqrt(len(left)) * left.std(ddof=1) / bottom.sum())


def test_the_gradient_through_interreflection_is_that_of_stacks() -> None:
    """Two facing plates, and the lamp beside the camera."""
    ours, other = _paired(_corner([0.2, 0.0, 0.0]), 0.005, 0.0005, range(1, 4))
    assert np.abs(other.mean(axis=0)).max() > 1e4
    ratio, error = _scale(ours, other)
    assert error < 0.01 and abs(ratio - 1.0) < 4.0 * error + 0.003
    left = np.sqrt(((ours - other) ** 2).sum() / (other**2).sum())
    assert left < 0.25  # by paths that begin or end at an edge in the difference, of either sign


def test_the_gradient_through_harbour_water_is_that_of_stacks() -> None:
    """Nearly all light is scattered here. The difference of stacks a hundredth nearer and farther is a per cent too small itself:
    (2 r h/width of R)²/6."""
    from beambench.generator.gated.growth import background_growth

    small = {
        "rig.camera.rows": 4, "rig.camera.cols": 4, "rig.camera.pixel_pitch_m": 208e-6,
        "rig.delays": {"start_s": 8e-9, "step_s": 0.5e-9, "count": 9},
    }  # fmt: skip
    scene = load_scene("harbour-wall", small)
    ours, other = _paired(scene, 0.012, 0.03, range(1, 4))
    ratio, error = _scale(ours, other)
    assert error < 0.03 and abs(ratio - 1.01) < 4.0 * error
    # And the scatter rung's, which is rendered by other code, without paths: rungs differ by some per cent here.
    scattered = background_growth(scene, "scatter", seed=9, key=5, rtol=2e-3)
    assert not scattered.sigma.any()
    apart = ours.mean(axis=0) - scattered.by_share
    assert np.sqrt((apart**2).sum() / (scattered.by_share**2).sum()) < 0.12


def test_traced_light_is_the_same_to_the_bit_where_nothing_grows() -> None:
    from beambench.generator.gated.full import Limits, Slices, render_remainder
    from beambench.generator.gated.stack import slice_coordinates, slice_settings

    scene = _corner([0.0, 0.0, 0.0])
    coords = slice_coordinates(scene)
    delay, scale = slice_settings(scene, coords, 1, 5)
    nothing = np.zeros((20, 8, 8), np.float32)

    def light(grown: float) -> Any:
        slices = Slices(delay, scale, coords["gate"], None)
        return render_remainder(scene, nothing, slices, 1e-9, 1, 5, limits=Limits(256), grown=grown).light

    still, moved = light(0.0), light(1e-7)
    assert still.sum() > 0
    np.testing.assert_allclose(moved, still, rtol=1e-4, atol=1e-5 * float(still.max()))


def test_grown_targets_keep_their_image_and_lengthen_every_range() -> None:
    from beambench.generator.generate import generate

    scene = load_scene("step", {"rig.camera.rows": 12, "rig.camera.cols": 12})
    one, two = (
        generate(each, seed=1, capture_key=1)["truth_range"].values for each in (scene, grown_scene(scene, 0.1))
    )
    np.testing.assert_allclose(two, 1.1 * one, rtol=1e-5)
    with pytest.raises(InputError, match="smaller"):
        grown_scene(scene, -1.0)


@pytest.mark.parametrize(("rung", "samples", "word"), [("direct", 8, "nothing that grows"), ("full", 0, "needs paths")])
def test_what_has_no_derivative_is_refused(rung: str, samples: int, word: str) -> None:
    from beambench.generator.gated.growth import background_growth

    with pytest.raises(InputError, match=word):
        background_growth(load_scene("flat-wall"), rung, seed=1, key=1, rtol=0.01, samples=samples)
