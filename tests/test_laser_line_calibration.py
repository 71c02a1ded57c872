"""Calibration of laser lines: corners of a board, adjustment through refraction, its error in the points, and real images."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import numpy.typing as npt
import pytest
import xarray as xr
from scipy.ndimage import gaussian_filter
from scipy.stats import chi2

from beambench.benchmarks.checks.laser_stereo15 import LINES, found_lines, read_image, seen_lines
from beambench.benchmarks.judges import laser_line_boards
from beambench.benchmarks.judges.calibrate import calibrated_rig
from beambench.benchmarks.suites.spec import Calibration
from beambench.captures.hide import hide_truth
from beambench.estimators import run_estimator
from beambench.estimators.laser_line.board import Board, SeenBoard, find_board
from beambench.estimators.laser_line.bundle import View, adjust
from beambench.estimators.laser_line.calibrate import board_view, calibrate, with_calibration
from beambench.estimators.laser_line.declared import CALIBRATED
from beambench.estimators.laser_line.deviations import STEPS, deviated
from beambench.estimators.laser_line.geometry import declared_geometry
from beambench.estimators.laser_line.saddles import fit_saddles
from beambench.estimators.laser_line.triangulate import (
    triangulate_air,
    triangulate_pinhole_port,
    triangulate_refractive,
)
from beambench.estimators.result import stage_result
from beambench.estimators.rig import DeclaredRig
from beambench.generator.generate import generate
from beambench.optics.rotation import rotation_matrix
from beambench.scenes.declared import declared_rig
from beambench.scenes.errors import InputError
from beambench.scenes.load import load_scene
from beambench.scenes.medium_index import phase_index
from beambench.scenes.rigs.laser_line import laser_line_rig
from beambench.scenes.rigs.laser_line_geometry import line_camera
from beambench.scenes.scene import Scene

Float = npt.NDArray[np.float64]

# ---------------------------------------------------------------- corners

_FINE = 10


def _drawn(
    turn_deg: float, square_px: float, middle: tuple[float, float], blur_px: float, shape: tuple[int, int]
) -> Float:
    """A board of 6 x 9 inner corners, by counting which of 100 points within each pixel lie on black squares: no formula of the
    fit is used here."""
    part = (np.arange(_FINE) + 0.5) / _FINE - 0.5
    row = (np.arange(shape[0])[:, None] + part).ravel()
    col = (np.arange(shape[1])[:, None] + part).ravel()
    y, x = np.meshgrid(row - middle[0], col - middle[1], indexing="ij")
    c, s = np.cos(np.deg2rad(turn_deg)), np.sin(np.deg2rad(turn_deg))
    u, v = (c * x + s * y) / square_px + 5.0, (-s * x + c * y) / square_px + 3.5
    black = ((np.floor(u) + np.floor(v)) % 2 == 0) & (u > 0) & (u < 10) & (v > 0) & (v < 7)
    fine = gaussian_filter(np.where(black, 100.0, 1000.0), blur_px * _FINE)
    return np.asarray(fine.reshape(shape[0], _FINE, shape[1], _FINE).mean(axis=(1, 3)))


def _corners(turn_deg: float, square_px: float, middle: tuple[float, float]) -> Float:
    c, s = np.cos(np.deg2rad(turn_deg)), np.sin(np.deg2rad(turn_deg))
    v, u = (part.ravel() for part in np.meshgrid(np.arange(-2.5, 3.0), np.arange(-4.0, 4.5), indexing="ij"))
    return np.stack([middle[0] + square_px * (s * u + c * v), middle[1] + square_px * (c * u - s * v)], axis=1)


@pytest.mark.parametrize("turn_deg", [0.0, 17.0, 75.0, 200.0])
def test_corners_of_a_drawn_board(turn_deg: float) -> None:
    """Without noise within .01 px: the drawing's grid of a tenth of a pixel errs by .03/√(edge's points). A window or an order that
    is wrong gives whole squares. Either end of the board may come first."""
    middle = (118.3, 131.7)
    image = _drawn(turn_deg, 20.0, middle, 0.7, (240, 260))
    seen = find_board(image, Board(6, 9, 0.02), blur_px=1.0, radius_px=5.0)
    true = _corners(turn_deg, 20.0, middle)
    miss = min(np.abs(seen.place - true).max(), np.abs(seen.place - true[::-1]).max())
    assert miss < 0.01, miss


def test_the_stated_error_of_a_corner_is_true() -> None:
    """z over 54 corners of 12 noisy images: rms of 1296 numbers of unit variance errs by .02, and the fit's own variance by as
    much; allowed .9 to 1.1. Noise of 10 against a contrast of 900."""
    rng = np.random.default_rng(4)
    image = _drawn(17.0, 20.0, (118.3, 131.7), 0.7, (240, 260))
    true = _corners(17.0, 20.0, (118.3, 131.7))
    z = []
    for _ in range(12):
        found = fit_saddles(image + rng.normal(0.0, 10.0, image.shape), np.rint(true), np.full(len(true), 6))
        assert found.good.all()
        z.append((found.place - true) / found.sigma)
    assert 0.9 < np.sqrt(np.mean(np.square(z))) < 1.1


def test_images_without_a_whole_board_are_refused() -> None:
    image = _drawn(17.0, 20.0, (118.3, 131.7), 0.7, (240, 260))
    for bad, board in (
        (np.full((240, 260), 500.0), Board(6, 9, 0.02)),
        (image[:, 100:], Board(6, 9, 0.02)),  # cut
        (image, Board(6, 8, 0.02)),  # another board: two blocks would fit
        (np.random.default_rng(1).normal(500.0, 50.0, (240, 260)), Board(6, 9, 0.02)),
    ):
        with pytest.raises(InputError, match="whole board"):
            find_board(bad, board, blur_px=1.0, radius_px=5.0)
    with pytest.raises(InputError, match="cannot be used"):
        Board(6, 6, 0.02)  # which way round would be open


# ---------------------------------------------------------------- adjustment


@pytest.fixture
def small(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(laser_line_boards, "_VIEWS", 5)
    monkeypatch.setattr(laser_line_boards, "_POINTS", 20)


_SUITE = Calibration(corner_sigma_px=0.03, line_sigma_px=0.03)


def _deviation(found: dict[str, object], true: Scene) -> Float:
    """Values of a calibrated rig less the true ones, in the order of its parameters."""
    now = declared_geometry(DeclaredRig("a" + json.dumps(found), found))
    text = json.dumps(declared_rig(true))
    then = declared_geometry(DeclaredRig(text, json.loads(text)))
    assert now.camera.port is not None and then.camera.port is not None
    by = {
        "focal_px": now.camera.focal_px - then.camera.focal_px, "principal_row_px": now.camera.row0 - then.camera.row0,
        "principal_col_px": now.camera.col0 - then.camera.col0,
        "stand_off_m": now.camera.port.stand_off_m - then.camera.port.stand_off_m,
    }  # fmt: skip
    by |= {
        name: now.camera.distortion[k] - then.camera.distortion[k] for k, name in enumerate(("k1", "k2", "p1", "p2"))
    }
    # n' = n + turn × n for a small turn; axis × n = fan direction, fan direction × n = −axis.
    away = now.sheet.normal - then.sheet.normal
    by["turn_about_axis_rad"] = float(away @ then.sheet.frame[:, 1])
    by["turn_about_fan_rad"] = -float(away @ then.sheet.frame[:, 2])
    by["shift_m"] = float(now.sheet.normal @ (now.sheet.source - then.sheet.source))
    names = found["calibration"]["parameters"]  # type: ignore[index]
    return np.array([by[name] for name in names])


@pytest.mark.slow
def test_calibrations_err_as_their_covariance_says(small: None) -> None:
    """eᵀC⁻¹e of 6 calibrations with 11 parameters each is χ² of 66 degrees; two-sided at 1e-3. A covariance that is too small
    or a bias of one standard error in each parameter fails."""
    scene = load_scene("spotscan-wall")
    text = json.dumps(declared_rig(scene))
    total, count = 0.0, 0
    for seed in range(6):
        found = json.loads(calibrated_rig(scene, text, _SUITE, seed=seed))
        error = _deviation(found, scene)
        covariance = np.array(found["calibration"]["covariance"])
        total += float(error @ np.linalg.solve(covariance, error))
        count += error.size
    assert count == 66
    assert chi2.ppf(5e-4, count) < total < chi2.ppf(1 - 5e-4, count), total


def test_the_same_seed_gives_the_same_calibration(small: None) -> None:
    scene = load_scene("spotscan-wall")
    text = json.dumps(declared_rig(scene))
    one, again, other = (calibrated_rig(scene, text, _SUITE, seed=seed) for seed in (3, 3, 4))
    assert one == again != other
    with pytest.raises(InputError, match="lacks a value"):
        calibrated_rig(scene, text, Calibration(pulse_photoelectrons=1e5, gate_photoelectrons=1e3), seed=3)


def test_views_that_leave_something_open_are_refused() -> None:
    """Boards all square to the view do not tell the focal length from the distance; nor does a view without a line tell the
    plane, or one without a port the stand-off."""
    scene = load_scene("spotscan-wall")
    text = json.dumps(declared_rig(scene))
    start = declared_geometry(DeclaredRig(text, json.loads(text)))
    board, empty = Board(6, 9, 0.02), np.zeros(0)
    middle = np.array([0.08, 0.05, 0.0])
    bare = replace(start.camera, port=None)

    def view(depth: float) -> View:
        point = (board.points() - middle).T + np.array([[0.0], [0.0], [depth]])
        place = np.stack(bare.project(point), axis=1)
        return View(SeenBoard(place, np.full(place.shape, 0.03)), None, empty, empty, empty)

    views = [view(0.7)] * 3
    with pytest.raises(InputError, match="undetermined"):
        adjust(start, board, views, ["focal_px", "k1"])
    with pytest.raises(InputError, match="no view shows the line"):
        adjust(start, board, views, ["shift_m"])
    with pytest.raises(InputError, match="no view looks through a port"):
        adjust(start, board, views, ["stand_off_m"])
    with pytest.raises(InputError, match="no such parameters"):
        adjust(start, board, views, ["zoom"])


# ---------------------------------------------------------------- the error of points


def test_the_error_of_a_calibration_is_in_the_error_of_points(small: None) -> None:
    """σ of points against 400 instruments drawn from the covariance: a standard deviation of 400 draws errs by 3.5 %, three times
    that allowed. The line itself is exact here, so that all of σ is the calibration's."""
    scene = load_scene("spotscan-wall")
    text = json.dumps(declared_rig(scene))
    calibrated = calibrated_rig(scene, text, _SUITE, seed=1)
    values = json.loads(calibrated)
    rig = DeclaredRig(calibrated, values)
    row, col = np.arange(256.0), np.full(256, 100.0)
    lines = stage_result(
        "line", column=col[None, :, None], sigma=np.full((1, 256, 1), 1e-9), valid=np.ones((1, 256, 1), bool)
    )
    stated = triangulate_refractive(lines, rig)["sigma"].values[0, ::64, 0]
    geometry = declared_geometry(rig)
    rng = np.random.default_rng(2)
    names = values["calibration"]["parameters"]
    draws = rng.multivariate_normal(np.zeros(len(names)), np.array(values["calibration"]["covariance"]), 400)
    points = [deviated(geometry, dict(zip(names, draw, strict=True))).points(row[::64], col[::64]) for draw in draws]
    assert np.abs(stated.T / np.std(points, axis=0) - 1.0).max() < 0.105
    plain = triangulate_refractive(lines, DeclaredRig(text, json.loads(text)))["sigma"].values[0, ::64, 0]
    assert plain.max() < 1e-6 < 1e-5 < stated.max()


def test_a_calibrated_stand_off_alone_leaves_models_without_one_as_they_are() -> None:
    """The stand-off is no parameter of straight rays and of a port at the pupil: their errors are those of the line."""
    rig = declared_rig(load_scene("spotscan-wall"))
    values = rig | {"calibration": {"parameters": ["stand_off_m"], "covariance": [[1e-6]]}}
    lines = stage_result(
        "line", column=np.full((1, 4, 1), 90.0), sigma=np.full((1, 4, 1), 0.1), valid=np.ones((1, 4, 1), bool)
    )
    for triangulate in (triangulate_air, triangulate_pinhole_port):
        stated, plain = (triangulate(lines, DeclaredRig(json.dumps(v), v))["sigma"].values for v in (values, rig))
        assert stated.shape == (1, 4, 1, 3) and np.array_equal(stated, plain)


def test_every_parameter_has_a_step_and_deviates() -> None:
    assert set(CALIBRATED) == set(STEPS)
    text = json.dumps(declared_rig(load_scene("spotscan-wall")))
    geometry = declared_geometry(DeclaredRig(text, json.loads(text)))
    still = geometry.points(np.array([10.0, 200.0]), np.array([30.0, 150.0]))
    for name in CALIBRATED:
        moved = deviated(geometry, {name: 1e-2 if name.startswith(("k", "p1", "p2")) else 1e-3})
        assert np.abs(moved.points(np.array([10.0, 200.0]), np.array([30.0, 150.0])) - still).max() > 1e-7, name


def test_a_covariance_that_is_none_is_refused() -> None:
    rig = declared_rig(load_scene("spotscan-wall"))
    lines = stage_result(
        "line", column=np.full((1, 4, 1), 90.0), sigma=np.full((1, 4, 1), 0.1), valid=np.ones((1, 4, 1), bool)
    )
    for parameters, covariance, match in (
        (["shift_m", "focal_px"], [[1.0, 2.0], [2.0, 1.0]], "cannot be one"),
        (["shift_m", "focal_px"], [[1.0, 0.5], [0.0, 1.0]], "cannot be one"),
        (["shift_m", "shift_m"], [[1.0, 0.0], [0.0, 1.0]], "cannot be one"),
        (["zoom"], [[1.0]], "cannot be used"),
        (["shift_m"], [[1.0, 0.0]], "cannot be used"),
    ):
        values = json.loads(json.dumps(rig)) | {"calibration": {"parameters": parameters, "covariance": covariance}}
        with pytest.raises(InputError, match=match):
            triangulate_refractive(lines, DeclaredRig(json.dumps(values), values))


# ---------------------------------------------------------------- generated boards

_HALF = {
    "rig.camera.rows": 256, "rig.camera.cols": 320, "rig.camera.pixel_pitch_m": 19.2e-6, "rig.principal_offset_px": [1.5, -2.0],
}  # fmt: skip
_BOARD = Board(6, 9, 0.02, (0.095, 0.035))
_POSES = (((0.0, 0.0, 0.6), 15.0, -20.0), ((0.0, -0.02, 0.7), 20.0, 20.0), ((0.01, 0.02, 0.65), -15.0, -25.0))
#: What the laboratory believes at first.
_DECLARED = {
    "camera.focal_length_m": 8.1e-3, "principal_offset_px": [0.0, 0.0], "port.stand_off_m": 0.027,
    "distortion.k1": 0.0, "distortion.k2": 0.0, "distortion.p1": 0.0, "distortion.p2": 0.0,
    "laser.rotation_deg": [0.2, -7.8, 0.3], "laser.position_m": [0.199, 0.0, 0.02],
}  # fmt: skip


def _scene(medium: str, number: int) -> Scene:
    centre, tilt_x, tilt_y = _POSES[number]
    shape = {
        "center_m": [c * (1.0 if medium == "air" else 1.15) for c in centre],
        "tilt_x_deg": tilt_x,
        "tilt_y_deg": tilt_y,
    }
    overrides = {f"target.0.shape.{name}": value for name, value in shape.items()}
    return load_scene(f"checkerboard-{medium}", _HALF | overrides | {"declared": _DECLARED})


@pytest.fixture(scope="module")
def boards() -> list[xr.Dataset]:
    return [
        hide_truth(generate(_scene(medium, k), seed=k + 1, rtol=1e-2))
        for medium in ("air", "port")
        for k in range(len(_POSES))
    ]


@pytest.mark.slow
def test_generated_corners_lie_where_the_board_is(boards: list[xr.Dataset]) -> None:
    """Ray-traced texture against the projection of the board's corners: the mean miss of 54 corners within 4 standard errors and
    .002 px. A texture that is mirrored, or moved by half a texel (.3 px), fails."""
    for k, capture in enumerate(boards):
        scene = _scene("air" if k < len(_POSES) else "port", k % len(_POSES))
        seen = board_view(capture, _BOARD).corners
        rig, shape = laser_line_rig(scene), scene.target[0].shape
        _, tilt_x, tilt_y = _POSES[k % len(_POSES)]
        turn = rotation_matrix((tilt_x, tilt_y, 0.0))
        point = turn @ (_BOARD.points() + np.array([-0.11, -0.05, 0.0])).T + np.array(shape.center_m)[:, None]
        true = np.stack(line_camera(rig, phase_index(scene.medium, rig.wavelength_m)).project(point), axis=1)
        miss = min((seen.place - true, seen.place - true[::-1]), key=lambda m: float(np.abs(m).max()))
        assert np.all(np.abs(miss.mean(axis=0)) < 4.0 * seen.sigma.mean() / np.sqrt(54) + 0.002)
        assert np.abs(miss).max() < 0.05


@pytest.mark.slow
def test_a_rig_is_calibrated_from_captures_in_air_and_through_the_port(boards: list[xr.Dataset]) -> None:
    """All parameters within 5 of their standard errors of the true ones, from first values that are some hundred of them away; and
    points of a calibrated rig nearer to the truth than those of the declared one."""
    found = calibrate(boards, _BOARD)
    text = with_calibration(str(boards[-1].attrs["rig"]), found)
    error = _deviation(json.loads(text), _scene("port", 0).model_copy(update={"declared": {}}))
    sigma = np.sqrt(np.diag(found.covariance))
    assert np.abs(error / sigma).max() < 5.0, dict(zip(found.names, error / sigma, strict=True))
    assert found.sigma("stand_off_m") < 3e-3 and found.corner_rms_px < 0.03
    capture = generate(_scene("port", 2), seed=9, rtol=1e-2)
    true = capture["truth_point"].values[0]
    lit = hide_truth(capture)
    off = {}
    for name, rig in (("declared", str(lit.attrs["rig"])), ("calibrated", text)):
        points = run_estimator("line-erf+triangulate-refractive", lit.assign_attrs(rig=rig))
        miss = np.linalg.norm(points["point"].values[0, :, 0] - true[:, 0], axis=1)
        off[name] = float(np.nanmedian(miss))
        stated = float(np.nanmedian(np.linalg.norm(points["sigma"].values[0, :, 0], axis=1)))
    assert off["calibrated"] < 3.0 * stated < 1e-2 < off["declared"], (off, stated)


def test_even_light_of_a_white_surface() -> None:
    """Photoelectrons of a board without texture: N ρ t e^{−cr} cos⁴θ, r from the port's outer surface; to 1e-4:
    the lens and the pixel, which spread a curved profile, change it by 4e-5."""
    scene = load_scene(
        "checkerboard-port",
        {
            "rig.camera.rows": 32, "rig.camera.cols": 40, "rig.camera.pixel_pitch_m": 38.4e-6, "rig.principal_offset_px": None,
            "target.0.texture": None, "target.0.shape.width_m": 3.0, "target.0.shape.height_m": 3.0,
            "target.0.shape.tilt_x_deg": 0.0, "target.0.shape.tilt_y_deg": 0.0, "rig.distortion": None,
            "rig.laser.position_m": [5.0, 0.0, 0.02],
        },
    )  # fmt: skip
    capture = generate(scene, seed=1, rtol=1e-2, truth_electrons=True)
    rig = laser_line_rig(scene)
    index = phase_index(scene.medium, rig.wavelength_m)
    slope = (np.stack(np.meshgrid(np.arange(32) - 15.5, np.arange(40) - 19.5, indexing="ij"))) * 38.4e-6 / 8e-3
    square = (slope**2).sum(axis=0)
    sine = np.sqrt(square / (1.0 + square)) * 1.00027 / index
    way = (0.6 - 0.038) / np.sqrt(1.0 - sine**2)
    assert rig.even_light_e_per_s is not None
    white = rig.even_light_e_per_s * 0.8 * np.exp(-scene.medium.attenuation_per_m * way) / (1.0 + square) ** 2
    expected = (white + 2.0e3 + 50.0) * 5.0e-3
    got = capture["truth_electrons"].values[1]
    inner = (slice(2, -2), slice(2, -2))
    assert np.abs(got[inner] / expected[inner] - 1.0).max() < 1e-4


# ---------------------------------------------------------------- a piece of a real image


def test_fifteen_lines_are_found_on_a_real_image() -> None:
    """48 rows of a real image. The lines are 37 px apart at this distance, evenly to 1.5 px, and straight: each leaves its own
    straight line by less than .35 px rms (.2 px of speckle and noise); a finder that merges or loses lines fails the count."""
    image = read_image(Path(__file__).parent / "laser_stereo15" / "lines.png")
    row, col = found_lines(2.0 * image[..., 1] - image[..., 0], 25, 20)
    lines = seen_lines(row, col, least=24)
    assert len(lines) == LINES
    places = []
    for at, column in lines:
        assert at.size >= 36
        fit = np.polyfit(at, column, 1)
        assert np.sqrt(np.mean((column - np.polyval(fit, at)) ** 2)) < 0.35
        places.append(float(np.polyval(fit, 24.0)))
    assert np.abs(np.diff(places) - 37.0).max() < 1.5


def test_frames_of_different_exposures_are_no_view_of_a_board(boards: list[xr.Dataset]) -> None:
    one = boards[0]
    exposure = np.linspace(1e-3, 2e-3, one.sizes["frame"])
    mixed = one.assign_coords(exposure=("frame", exposure), gain=("frame", np.ones(exposure.size)))
    with pytest.raises(InputError, match="one exposure and gain"):
        board_view(mixed, _BOARD)
