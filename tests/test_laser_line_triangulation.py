"""Triangulations on true columns with stated noise: no error of a finder takes part."""

from __future__ import annotations

import numpy as np
import pytest

from beambench.benchmarks.checks.triangulation_alone import point_errors
from beambench.scenes.load import load_scene


def test_exact_refraction_finds_the_true_points_and_states_the_error_of_its_columns() -> None:
    """The points are the generator's own, traced to the wall; z of 4096 draws has a standard error of .011. It would see a
    stand-off, an index or a turn of the sheet that is read wrongly, and a slope ∂X/∂c that is wrong by 5 %."""
    scene = load_scene("spotscan-wall")
    assert point_errors("triangulate-refractive", scene, 0.0)["rms_m"] < 1e-9
    noisy = point_errors("triangulate-refractive", scene, 0.1)
    assert noisy["valid"] == 1.0 and noisy["z_rms"] == pytest.approx(1.0, abs=0.045)
    # Depth of a tenth of a column, p z²/(n f b), at 1 m and b = 150 mm; the leaning wall is up to 5 cm nearer and farther.
    depth_m = 0.1 * 57.8125e-6 / 25e-3 / 0.15 / 1.335
    assert noisy["rms_m"] * np.sqrt(3.0) == pytest.approx(depth_m, rel=0.08)


def test_models_that_leave_refraction_out_keep_their_bias_without_any_noise() -> None:
    scene = load_scene("spotscan-wall")
    pinhole, air = (point_errors(f"triangulate-{name}", scene, 0.0)["rms_m"] for name in ("pinhole-port", "air"))
    assert 5e-4 < pinhole < 2e-3 and 0.03 < air < 0.06
