"""The stage `calibration`: the rig from one capture of a board, scored against the true one; refusals; the board's pitch."""

from __future__ import annotations

import json

import numpy as np
import numpy.typing as npt
import pytest
import xarray as xr

from beambench.benchmarks.judges.bound import bounds_of, truths_of
from beambench.benchmarks.scores.score import KEY, score_rows
from beambench.benchmarks.written.laser_line_board import board_capture, board_poses
from beambench.captures.hide import hide_truth
from beambench.captures.layouts import stage_of
from beambench.estimators import run_estimator
from beambench.estimators.laser_line.board import Board
from beambench.estimators.laser_line.board_scale import measured_scale
from beambench.estimators.laser_line.described import described
from beambench.estimators.laser_line.geometry import declared_geometry
from beambench.estimators.rig import DeclaredRig
from beambench.generator.laser_line.setting import poses_of
from beambench.scenes.declared import declared_rig
from beambench.scenes.errors import InputError
from beambench.scenes.load import load_scene
from beambench.scenes.rigs.laser_line import laser_line_rig

Float = npt.NDArray[np.float64]

_BOARD = Board(6, 9, 0.02, (0.095, 0.035))
_PLACES = {"air": (-0.03, 0.0, 0.6), "port": (-0.03, 0.0, 0.72)}


def _seen(medium: str, seed: int | None) -> xr.Dataset:
    return board_capture(load_scene(f"calibration-{medium}"), _BOARD, place_m=_PLACES[medium], seed=seed)


def _errors(capture: xr.Dataset, found: xr.Dataset) -> dict[str, tuple[Float, Float]]:
    """(error, stated error) of every quantity where it has a truth, by name."""
    made = {}
    for name, true in truths_of(capture).items():
        if name in found:
            sigma = found["sigma" if name == "node" else f"sigma_{name}"].values
            known = np.isfinite(true.value)
            made[name] = (found[name].values - true.value)[known], sigma[known]
    return made


@pytest.fixture(scope="module")
def noisy() -> xr.Dataset:
    return _seen("air", 5)


def test_a_capture_without_noise_gives_the_true_rig() -> None:
    """From first values 1 % off in focal length and .2° in the sheet. What is left is the drawing's: its edges are straight over a
    window of ±4 px, where those of a camera with distortion bend by k₁ (4/417)² of a pixel times some; corners miss by 2e-5 px,
    points of the line by 1e-5. That is less by 300 than noise of .007 px, whose errors are .15 mm, 2.4 µm, .15 px, .07 mrad and
    .03 mm."""
    capture = _seen("air", None)
    found = run_estimator("calibrate-board", hide_truth(capture))
    assert found.attrs["views"] == 8 and found.attrs["corner_rms_px"] < 1e-4
    most = {"node": 3e-5, "focal_length": 1e-6, "principal_point": 0.02, "plane_angle": 2e-5, "plane_offset": 1e-5}
    errors = _errors(capture, found)
    for name, limit in most.items():
        assert errors[name][0].size > 0 and np.abs(errors[name][0]).max() < limit, name
    assert not found["valid_stand_off"].values.any()  # in air the port does not tell it
    declared = declared_rig(load_scene("calibration-air"))
    off = described(declared_geometry(DeclaredRig(json.dumps(declared), declared)), 19.2e-6)
    assert abs(off["focal_length"][0] - 8e-3) > 9e-5 and abs(off["plane_offset"][0] - 0.2008) > 9e-4


def test_errors_of_a_noisy_capture_are_the_stated_ones(noisy: xr.Dataset) -> None:
    """Every number within 4 of its standard errors; the nodes share the five errors of camera and plane, so that
    their rms z is that of some numbers of unit variance: below 2 at 1e-3 for five of them."""
    errors = _errors(noisy, run_estimator("calibrate-board", hide_truth(noisy)))
    for name, (error, sigma) in errors.items():
        if name != "node":
            assert (np.abs(error) < 4.0 * sigma).all(), name
    error, sigma = errors["node"]
    assert np.sqrt(np.mean((error / sigma) ** 2)) < 2.0
    assert np.sqrt(np.mean(error**2)) < 5e-4


def test_the_camera_of_an_air_calibration_gives_the_port_in_water() -> None:
    """In water alone stand-off and focal length look alike: the stated error of the stand-off is over 1 cm, and true. With the
    camera held as a calibration in air left it, the stand-off is within 4 of its errors of 1 mm. Straight rays in its place
    miss the nodes by millimetres, more than ten times as much."""
    capture = _seen("port", 1)
    held = {
        label: _errors(capture, run_estimator(f"calibrate-board{label}", hide_truth(capture)))
        for label in ("", "[hold=camera]", "[port=none]")
    }
    assert 0.01 < held[""]["stand_off"][1][0] < 0.03
    assert abs(held[""]["stand_off"][0][0]) < 3.0 * held[""]["stand_off"][1][0]
    assert abs(held["[hold=camera]"]["stand_off"][0][0]) < 4e-3 < 4.1 * held["[hold=camera]"]["stand_off"][1][0]
    rms = {label: float(np.sqrt(np.mean(errors["node"][0] ** 2))) for label, errors in held.items()}
    assert rms["[hold=camera]"] < 3e-4 and rms["[port=none]"] > 10.0 * rms["[hold=camera]"], rms


def test_the_scores_of_a_calibration_have_units(noisy: xr.Dataset) -> None:
    """A row per quantity, in its unit; the stand-off has no truth in air, and the nodes are those at the depths of the boards."""
    stage = stage_of("calibration")
    found = run_estimator("calibrate-board", hide_truth(noisy))
    arrays = {name: found[name].values for name in stage.dims()}
    key = dict.fromkeys(KEY, "")
    scored = score_rows(key, stage, truths_of(noisy), bounds_of(noisy), arrays, status="ok", wall_s=1.0)
    rows = {row["quantity"]: row for row in scored}
    units = {name: row["unit"] for name, row in rows.items()}
    assert units == {
        "node": "m", "focal_length": "m", "principal_point": "px", "stand_off": "m", "plane_angle": "rad", "plane_offset": "m",
    }  # fmt: skip
    assert rows["stand_off"]["n"] == 0 and 100 < rows["node"]["n"] < 768
    for name in ("node", "focal_length", "principal_point", "plane_angle", "plane_offset"):
        row = rows[name]
        assert row["coverage"] == 1.0 and row["failure_rate"] == 0.0 and row["bound_kind"] == "none", name
        assert np.isnan(row["bound"]) and np.isnan(row["efficiency"]), name
    assert rows["focal_length"]["failure_at"] == pytest.approx(8e-5)
    assert rows["plane_angle"]["failure_at"] == pytest.approx(2.4e-3)


# ---------------------------------------------------------------- refusals


def _refusal(capture: xr.Dataset, label: str = "calibrate-board") -> str:
    found = run_estimator(label, hide_truth(capture))
    names = [name for name in found if str(name).startswith("valid")]
    assert len(names) == 6 and not any(found[name].values.any() for name in names)
    return str(found.attrs["refused"])


def test_one_pose_is_no_calibration(noisy: xr.Dataset) -> None:
    assert "Too few views" in _refusal(noisy.isel(frame=[0, 8]))


def test_boards_from_poses_alike_are_no_calibration(noisy: xr.Dataset) -> None:
    """Three times the same view under other names of its pose: nothing new is seen."""
    frames = noisy.isel(frame=[0, 0, 0, 8, 8, 8])
    pose = frames["pose"].values.copy()
    pose[:, 0] += np.tile([0.0, 1e-3, 2e-3], 2)
    assert "undetermined" in _refusal(frames.assign_coords(pose=(frames["pose"].dims, pose)))


def test_dark_frames_are_no_calibration(noisy: xr.Dataset) -> None:
    dark = noisy.assign(counts=noisy["counts"] * np.uint16(0) + np.uint16(60))
    assert "Too few views" in _refusal(dark)


def test_full_pixels_near_a_corner_are_no_data(noisy: xr.Dataset) -> None:
    """White squares at the top of the converter: corners between them are not read from clipped edges."""
    top = noisy.assign(counts=noisy["counts"].clip(max=900))
    rig = json.loads(noisy.attrs["rig"])
    rig["detector"]["full_well_e"] = (900 - 60) / rig["detector"]["gain_dn_per_e"] + 4 * rig["detector"]["read_noise_e"]
    assert "Too few views" in _refusal(top.assign_attrs(rig=json.dumps(rig)))


def test_squares_of_another_size_are_refused_by_the_rigs_poses(noisy: xr.Dataset) -> None:
    """The board's images are alike for squares of 20 and 20.2 mm; the way between the stations is not."""
    assert "not as large as stated" in _refusal(noisy, "calibrate-board[square_m=0.0202]")


def test_a_board_of_another_number_of_squares_is_refused(noisy: xr.Dataset) -> None:
    assert "Too few views" in _refusal(noisy, "calibrate-board[cols=8]")
    with pytest.raises(InputError, match="cannot be used"):
        run_estimator("calibrate-board[cols=6]", hide_truth(noisy))


def test_the_scale_of_a_board_by_closed_form() -> None:
    """Poses of a board whose squares are 3 % larger than stated: all places are 3 % too near, and s = 1.03 to rounding."""
    stations = np.asarray(laser_line_rig(load_scene("calibration-air")).stations)
    stated, true = Board(6, 9, 0.02), Board(6, 9, 0.0206)
    poses = board_poses(true, stations, np.array([0.0, 0.0, 0.6]))
    near = [type(pose)(pose.turn, pose.place / 1.03) for pose in poses]
    scale, sigma = measured_scale(stated, near, stations)
    assert abs(scale - 1.03) < 1e-12 and sigma < 1e-12
    blurred = np.eye(48) * 1e-8  # 1e-4 m and rad in each pose
    assert 1e-5 < measured_scale(stated, near, stations, blurred)[1] < 1e-3
    assert np.isnan(measured_scale(stated, near, stations * 0.0)[0])


# ---------------------------------------------------------------- stations of the rig


def test_frames_are_taken_at_the_stations() -> None:
    """Frame k of either kind at station k modulo their number, in the coordinate `pose` as written."""
    stations = [[0.0, 0.0, 0.0, 0.0, 0.0, 0.0], [0.1, -0.2, 0.3, 0.0, 0.1, 0.0]]
    scene = load_scene("spotscan-wall", {"rig.stations": stations, "rig.frames.lit": 3, "rig.frames.laser_off": 2})
    poses, coords = poses_of(laser_line_rig(scene))
    assert np.array_equal(coords["pose"], np.array(stations)[[0, 1, 0, 0, 1]])
    assert np.array_equal(poses[1].place, [0.1, -0.2, 0.3]) and list(coords["laser_on"]) == [True] * 3 + [False] * 2
    for other in ({"rig.motion_m_per_s": [0.1, 0.0, 0.0]}, {"rig.turn_rad_per_s": [0.1, 0.0, 0.0]}):
        with pytest.raises(InputError, match="stands still"):
            load_scene("spotscan-wall", {"rig.stations": stations} | other)
    assert "stations" not in load_scene("spotscan-wall").rig.model_dump(mode="json")
