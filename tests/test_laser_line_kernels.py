"""The compiled kernels of laser lines against their plain twins, and against the NumPy geometry."""

from __future__ import annotations

import json
from typing import Any

import numpy as np
import pytest
from scipy.special import ndtr

from beambench.benchmarks.written.laser_line import written_capture
from beambench.estimators import run_estimator
from beambench.estimators.laser_line.geometry import declared_geometry
from beambench.estimators.laser_line.profile_fit import fit_profiles
from beambench.estimators.laser_line.profile_model import normal_table, profile
from beambench.estimators.laser_line.ray_kernel import meet_sheet
from beambench.estimators.laser_line.row_scan import scan_rows
from beambench.estimators.laser_line.three_point_kernel import three_points
from beambench.estimators.laser_line.three_points import log_gaussian, parabola
from beambench.estimators.laser_line.windows import Formula, line_windows, with_locking
from beambench.estimators.rig import DeclaredRig
from beambench.scenes.declared import declared_rig
from beambench.scenes.load import load_scene

from ._line_twins import fitted, scanned


def _frames(kind: str, cols: int, rng: np.random.Generator) -> np.ndarray:
    """60 rows of noise and a line, some with dead, clipped or missing pixels; as 16-bit counts or as real numbers."""
    level = rng.uniform(100, 900, (60, 1))
    x = np.arange(cols) - rng.uniform(0, cols, (60, 1))
    counts = level + rng.choice([0.0, 3.0, 60.0], (60, 1)) * rng.standard_normal((60, cols))
    counts += 800 * np.exp(-0.5 * (x / 1.2) ** 2)
    counts[::7, rng.integers(0, cols, 4)] = 0.0
    counts[3::11, rng.integers(0, cols, 9)] = 2000.0
    counts[5] = 2000.0
    if kind == "uint16":
        return np.clip(np.rint(counts), 0, 2000).astype(np.uint16)
    counts[8, rng.integers(0, cols, 5)] = np.nan
    counts[9], counts[10, 0] = np.nan, np.inf
    return counts.astype(kind)


@pytest.mark.parametrize("kind", ["uint16", "float32", "float64"])
@pytest.mark.parametrize("cols", [40, 255, 640, 1277])
@pytest.mark.parametrize("returns", [1, 3])
def test_the_scan_is_its_twin_bit_for_bit(kind: str, cols: int, returns: int) -> None:
    """Peaks, windows, medians and soundness, of even and odd numbers of pixels, plain rows and rows with bad pixels."""
    counts = _frames(kind, cols, np.random.default_rng(cols))
    ours, twin = (scan(counts, 5, returns, 1990.0, 0.0) for scan in (scan_rows, scanned))
    for one, other in zip(ours, twin, strict=True):
        np.testing.assert_array_equal(one, other)
    assert ours[3].any() and not ours[3].all()


def test_the_table_gives_the_normal_distribution() -> None:
    """μ and its derivatives of lines of any place and width against `ndtr`, to 1e-10 of the light."""
    rng = np.random.default_rng(1)
    made, edge = np.empty((4, 15)), np.empty((2, 16))
    x = np.arange(16) - 7.5
    for c, s in zip(rng.uniform(-3, 3, 200), np.exp(rng.uniform(np.log(0.12), np.log(40), 200)), strict=True):
        profile(c, 2.0, 0.5, s, normal_table(), edge, made[0], made[1], made[2], made[3])
        u = (x - c) / s
        g = np.exp(-0.5 * u * u) / np.sqrt(2 * np.pi)
        truth = [0.5 + 2 * np.diff(ndtr(u)), -2 * np.diff(g) / s, np.diff(ndtr(u)), -2 * np.diff(u * g)]
        np.testing.assert_allclose(made, truth, rtol=0, atol=2e-10 * max(1.0, 1 / s))


@pytest.mark.parametrize("weighted", [True, False])
@pytest.mark.parametrize(("electrons", "width"), [(400.0, 0.6), (4e3, 0.4), (4e3, 1.5), (2e5, 0.9)])
def test_the_fit_is_that_of_a_general_solver(weighted: bool, electrons: float, width: float) -> None:
    """8 noisy windows: the minimum of SciPy to a hundredth of the standard error, and that error to 1 %."""
    rng = np.random.default_rng(5)
    x = np.arange(15) - 7.5
    c = rng.uniform(-0.5, 0.5, 8)
    mean = 20.0 + electrons * (ndtr((x + 1 - c[:, None]) / width) - ndtr((x - c[:, None]) / width))
    z = rng.poisson(mean) + 5.0 * rng.standard_normal(mean.shape) - 20.0
    begin = np.full(8, 1.2 * width)
    place, sigma, good = fit_profiles(z, np.full(8, 20.0), 25.0, begin, weighted=weighted, free_width=True)
    assert good.all()
    twin = np.array([fitted(row, 45.0, 1.2 * width, weighted=weighted) for row in z])
    assert np.abs(place - twin[:, 0]).max() < 0.01 * sigma.min()
    np.testing.assert_allclose(sigma, twin[:, 1], rtol=0.01)


@pytest.mark.parametrize(
    ("name", "changes"),
    [("spotscan-wall", {}), ("spotscan-deep", {}), ("line-scanner", {}), ("spotscan-wall", {"rig.port": {"kind": "none"}}),
     ("line-scanner", {"rig.distortion": None})],
)  # fmt: skip
def test_compiled_rays_meet_the_sheet_where_those_of_numpy_do(name: str, changes: dict[str, Any]) -> None:
    """Points to 1e-12 of their distance, NaN in the same places, and the slope by the column to 1e-6."""
    rig = declared_rig(load_scene(name, changes))
    text = rig if isinstance(rig, str) else json.dumps(rig)
    geometry = declared_geometry(DeclaredRig(text, json.loads(text)))
    rng = np.random.default_rng(2)
    row, col = rng.uniform(0, geometry.rows - 1, 500), rng.uniform(0, geometry.cols - 1, 500)
    point, slope = meet_sheet(geometry.camera, geometry.sheet, row, col)
    twin = geometry.points(row, col).T
    distance = np.linalg.norm(twin, axis=1, keepdims=True)
    assert np.isfinite(twin).any()
    np.testing.assert_array_equal(np.isnan(point), np.isnan(twin))
    near = (distance < 5).ravel()
    assert np.nanmax(np.abs(point - twin)[near] / distance[near]) < 1e-12
    along = np.abs(geometry.points(row, col + 1e-3) - geometry.points(row, col - 1e-3)).T / 2e-3
    np.testing.assert_allclose(slope[near], along[near], rtol=1e-6, atol=1e-9)


@pytest.mark.parametrize(("name", "formula"), [("line-parabola", parabola), ("line-log-gaussian", log_gaussian)])
def test_three_point_formulas_are_their_twin(name: str, formula: Formula) -> None:
    """Lines from far below the noise to bright ones, narrow and wide: column, sigma and valid of the compiled pass are those of the
    formula in whole arrays, to rounding, in rows that it answers itself and in those that it leaves to them."""
    rng = np.random.default_rng(1)
    scene = load_scene("spotscan-wall", {"rig.frames.lit": 2, "rig.camera.rows": 128, "rig.lens_sigma_px": 1.5})
    light = np.exp(rng.uniform(np.log(50), np.log(5e4), (2, 128)))
    width, column = rng.uniform(0.3, 2.0, (2, 128)), rng.uniform(20, 170, (2, 128))
    capture = written_capture(scene, light, width, 20.0, column, seed=3)
    windows = line_windows(capture)
    known = three_points(
        windows.z, windows.level, windows.floor_e2, windows.excess, *windows.shares(), windows.locking(formula),
        log=formula is log_gaussian,
    )[2]  # fmt: skip
    assert (windows.sound & known).sum() > 20 and (windows.sound & ~known).sum() > 20
    ours, twin = run_estimator(name, capture), with_locking(windows, formula, reach=1, follows_peak="free")
    np.testing.assert_array_equal(ours["valid"], twin["valid"])
    np.testing.assert_array_equal(ours["column"], twin["column"])
    np.testing.assert_allclose(ours["sigma"], twin["sigma"], rtol=1e-12)
