"""The procedure `boards`: planted values of a laser line come back in a scene's own paths, with errors that are true; its rig file
in scenes, estimators and twins; what it refuses."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import xarray as xr

import beambench
from beambench import InputError, cli
from beambench.benchmarks.twin.clause import Ask
from beambench.benchmarks.twin.rig_file import TwinRig
from beambench.benchmarks.twin.run import certified
from beambench.benchmarks.twin.uncertain import perturbed, uncertain_of
from beambench.benchmarks.written.laser_line_board import board_capture
from beambench.captures import write
from beambench.captures.hide import hide_truth
from beambench.estimators import run_estimator
from beambench.estimators.calibration.procedure import Calibrated, procedure_of
from beambench.estimators.laser_line.board import Board
from beambench.estimators.laser_line.calibrate import calibrate
from beambench.estimators.laser_line.geometry import declared_covariance, declared_geometry
from beambench.estimators.rig import DeclaredRig
from beambench.generator.generate import generate
from beambench.optics.rotation import rotation_angles_deg, rotation_matrix
from beambench.scenes.declared import declared_rig
from beambench.scenes.load import load_scene
from beambench.scenes.rig_files import RigFile, read_rig_file, write_rig_file
from beambench.scenes.scene import Scene

_SIZES = "rows=6,cols=9,square_m=0.02,beyond_x_m=0.095,beyond_y_m=0.035"
_LABEL = f"boards[{_SIZES}]"
_PLACES = {"air": (-0.03, 0.0, 0.6), "port": (-0.03, 0.0, 0.72)}
_TRUE = {
    "camera.focal_length_m": 8e-3, "principal_offset_px.0": 1.5, "principal_offset_px.1": -2.0, "distortion.k1": -0.08,
    "distortion.k2": 0.02, "distortion.p1": 2e-4, "distortion.p2": -1e-4, "port.stand_off_m": 0.03,
}  # fmt: skip


def _seen(medium: str, seed: int) -> xr.Dataset:
    board = Board(6, 9, 0.02, (0.095, 0.035))
    return board_capture(load_scene(f"calibration-{medium}"), board, place_m=_PLACES[medium], seed=seed)


def _z(found: Calibrated) -> dict[str, float]:
    """Errors over their standard errors: of the camera, of the port, and of the sheet's plane in its three numbers."""
    by = {one.path.removeprefix("rig."): one for one in found.figures} | {one.name: one for one in found.figures}
    normal = rotation_matrix((0.0, -8.0, 0.0))[:, 0]
    true = _TRUE | {
        "sheet, elevation of its normal": float(np.arcsin(normal[1])),
        "sheet, azimuth of its normal": float(np.arctan2(normal[2], normal[0])),
        "sheet, distance from the pupil": float(normal @ [0.2, 0.0, 0.02]),
    }
    return {name: (by[name].value - value) / by[name].sigma for name, value in true.items()}


@pytest.fixture(scope="module")
def boards() -> list[xr.Dataset]:
    """Eight views in air and eight in water, from first values 1 % off in focal length and .2° off in the sheet."""
    return [_seen("air", 5), _seen("port", 6)]


@pytest.fixture(scope="module")
def found(boards: list[xr.Dataset]) -> Calibrated:
    made: Calibrated = procedure_of(_LABEL).run([hide_truth(one) for one in boards])
    return made


@pytest.fixture(scope="module")
def file(found: Calibrated) -> RigFile:
    values = dict(found.values) | {one.path: one.value for one in found.figures if one.path}
    sigmas = {one.path: one.sigma for one in found.figures if one.path and np.isfinite(one.sigma)}
    empty = RigFile.model_construct(kind="laser_line", rig={})
    return empty.updated(values, sigmas, {"procedure": "boards"})


def _wall(overrides: dict[str, Any], declared: dict[str, Any] | None = None) -> Scene:
    """A wall before the calibrated rig, without the stations; a quarter of the rows, about the same middle."""
    small = {
        "target.0.texture": None, "target.0.shape.center_m": [0.0, 0.0, 0.65], "target.0.shape.width_m": 0.8,
        "target.0.shape.height_m": 0.8, "rig.stations": None, "rig.frames.lit": 12, "rig.frames.laser_off": 8,
        "rig.camera.rows": 64, "rig.even_light_e_per_s": 0.0,
    }  # fmt: skip
    return load_scene("calibration-air", {**small, **overrides, "declared": declared or {}})


def _first_values() -> dict[str, Any]:
    return {f"rig.{path}": value for path, value in load_scene("calibration-air").declared.items()}


def test_planted_values_come_back_with_their_errors(found: Calibrated) -> None:
    """All eleven numbers within 4.5 of their standard errors (3e-5 by chance), from first values 60 and more of them away."""
    assert max(abs(z) for z in _z(found).values()) < 4.5, _z(found)
    by = {one.path: one for one in found.figures}
    assert by["rig.camera.focal_length_m"].sigma < 1e-5 and by["rig.port.stand_off_m"].sigma < 2e-3
    assert found.used["views"] == 16 and found.used["views_left_out"] == 0
    # Where in its plane the laser stands is not seen, and no error is stated for it.
    assert all(np.isnan(one.sigma) for path, one in by.items() if path.startswith("rig.laser."))


@pytest.mark.slow
def test_the_stated_errors_are_true() -> None:
    """Eleven z of five calibrations: those of one are correlated, so that the rms of all is held to .5 to 1.6 and not tighter."""
    run = procedure_of(_LABEL).run
    every = [_z(run([hide_truth(_seen("air", 20 + k)), hide_truth(_seen("port", 40 + k))])) for k in range(5)]
    rms = float(np.sqrt(np.mean([z**2 for one in every for z in one.values()])))
    assert 0.5 < rms < 1.6, rms


def test_a_scene_with_the_file_declares_the_geometry_that_was_found(
    boards: list[xr.Dataset], found: Calibrated, file: RigFile
) -> None:
    """Camera and plane to rounding, and the covariance of the adjustment itself, after its way through the scene's own values."""
    adjusted = calibrate([hide_truth(one) for one in boards], Board(6, 9, 0.02, (0.095, 0.035)))
    plain = declared_rig(load_scene("calibration-port", {**file.overrides(), "declared": {}}))
    rig = DeclaredRig(json.dumps(plain), plain)
    names, covariance = declared_covariance(rig)
    assert set(names) == set(adjusted.names)
    order = [adjusted.names.index(name) for name in names]
    sigma = np.sqrt(np.diag(adjusted.covariance))[order]
    wanted = adjusted.covariance[np.ix_(order, order)]
    assert np.abs((covariance - wanted) / np.outer(sigma, sigma)).max() < 1e-5
    geometry = declared_geometry(rig)
    assert geometry.camera.focal_px == pytest.approx(adjusted.geometry.camera.focal_px, rel=1e-12)
    assert np.abs(geometry.sheet.frame - adjusted.geometry.sheet.frame).max() < 1e-12
    assert geometry.camera.port is not None and adjusted.geometry.camera.port is not None
    assert geometry.camera.port == adjusted.geometry.camera.port


def test_angles_of_a_rotation_are_those_it_is_made_of() -> None:
    rng = np.random.default_rng(3)
    for angles in [
        *rng.uniform(-180.0, 180.0, (50, 3)).tolist(),
        [10.0, 90.0, 20.0],
        [10.0, -90.0, 20.0],
        [0.0, 0.0, 180.0],
    ]:
        matrix = rotation_matrix(tuple(angles))
        again = rotation_angles_deg(matrix)
        assert np.abs(rotation_matrix(again) - matrix).max() < 1e-9
        assert all(-180.0 < angle <= 180.0 for angle in again)


def test_points_are_better_with_the_file_and_their_errors_hold_the_calibration(file: RigFile) -> None:
    """Median miss of a wall at .65 m: 20 mm by the first values, .21 by the file, whose points state .24 mm. Without the
    calibration's covariance they state the line's error alone, .02 mm."""
    off, stated = {}, {}
    first = {path.removeprefix("rig."): value for path, value in _first_values().items()}
    ours = {path.removeprefix("rig."): value for path, value in file.overrides().items()}
    bare = {path: value for path, value in ours.items() if path != "calibration"}
    for name, declared in (("first", first), ("file", ours), ("bare", bare)):
        capture = generate(_wall({}, declared), seed=9, rtol=1e-2)
        points = run_estimator("line-erf+triangulate-refractive", hide_truth(capture))
        miss = np.linalg.norm(points["point"].values[0, :, 0] - capture["truth_point"].values[0, :, 0], axis=1)
        off[name] = float(np.nanmedian(miss))
        stated[name] = float(np.nanmedian(np.linalg.norm(points["sigma"].values[0, :, 0], axis=1)))
    assert off["file"] < 3.0 * stated["file"] < 0.1 * off["first"], (off, stated)
    assert off["bare"] == pytest.approx(off["file"], rel=0.05) and stated["bare"] < 0.2 * stated["file"], (off, stated)


@pytest.mark.slow
def test_a_twin_takes_the_file(file: RigFile) -> None:
    """A wall recorded by the true rig: the twin of the file fails in nothing, that of the first values in the line's place."""
    real = hide_truth(generate(_wall({}), seed=5))
    rig = TwinRig(file.overrides(), dict(file.uncertainty))
    scene: Any = _wall(_first_values())
    ours = certified(real, Ask(rig, scene, None, 10, 1, ()))
    assert "fail" not in {str(one.verdict) for one in ours.clauses}
    assert any("with their correlations" in line for line in ours.evidence.about)
    wrong = {one.clause.name: str(one.verdict) for one in certified(real, Ask(None, scene, None, 10, 1, ())).clauses}
    assert wrong["place"] == "fail"


def test_draws_of_a_twin_are_correlated_as_the_file_says(file: RigFile) -> None:
    """4000 draws of focal length and stand-off: spread and correlation within 5 of their errors; an angle of 0 is drawn to both
    sides, and read noise is not below 0."""
    scene = _wall(file.overrides()).model_dump(mode="json")
    sigmas = {**file.uncertainty, "rig.lens_sigma_px": 0.6}
    uncertain = uncertain_of(scene, sigmas)
    assert uncertain.floored == {"rig.lens_sigma_px"} and "rig.port.stand_off_m" in uncertain.joint
    rng = np.random.default_rng(1)
    draws = [perturbed(scene, uncertain, "rig.laser.power_w", rng) for _ in range(4000)]
    paths = ["camera.focal_length_m", "port.stand_off_m", "laser.position_m.1"]
    held = file.rig["calibration"]
    at = [held["paths"].index(path) for path in paths]
    wanted = np.array(held["covariance"])[np.ix_(at, at)]
    got = np.cov([[draw[f"rig.{path}"] for draw in draws] for path in paths])
    scale = np.sqrt(np.diag(wanted))
    assert np.abs((got - wanted) / np.outer(scale, scale)).max() < 5.0 * np.sqrt(2.0 / 4000)
    assert min(draw["rig.lens_sigma_px"] for draw in draws) == 0.0


def test_the_command_asks_for_the_board_and_writes_the_file(
    boards: list[xr.Dataset], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    air, out = tmp_path / "air.zarr", tmp_path / "my-rig.toml"
    write(air, [boards[0]])
    assert cli.main(["calibrate", str(air), "-o", str(out)]) == 2
    assert "--procedures 'boards[rows=6,cols=9" in capsys.readouterr().err
    for label, said in (
        ("boards[rows=6,cols=9,square_m=0.02]", "the board's beyond_x_m, beyond_y_m"),
        (f"boards[{_SIZES},size=3]", "unknown parameter"),
        (f"boards[{_SIZES.replace('rows=6', 'rows=six')}]", "not allowed"),
        ("boards[rows=6", "malformed"),
        (f"boards[{_SIZES.replace('rows=6', 'rows=5')}]", "whole board"),
        (f"boards[{_SIZES.replace('0.02', '0.0206')}]", "not as large as stated"),
        (f"boards[{_SIZES.replace('square_m=0.02', 'square_m=-1')}]", "board"),
        (f"boards[{_SIZES.replace('0.02', '20')}]", "not possible"),
        (f"boards[{_SIZES.replace('rows=6', 'rows=1000000000')}]", "not possible"),
        ("emva1288[rows=6]", "unknown parameter"),
    ):
        assert cli.main(["calibrate", str(air), "--procedures", label, "-o", str(out)]) == 2, label
        assert said in capsys.readouterr().err, label
    assert not out.exists()
    assert cli.main(["calibrate", str(air), "--procedures", _LABEL, "-o", str(out), "--json"]) == 0
    told = json.loads(capsys.readouterr().out)
    file = read_rig_file(out, "laser_line")
    assert "port" not in file.rig and "rig.port.stand_off_m" not in file.uncertainty  # air does not show it
    assert len(told["found"]["boards"]) >= 13 and file.calibration[0]["views"] == 8
    # A scene without distortion takes it too.
    assert cli.main(["generate", "spotscan-wall", "--rig", str(out), "--plan"]) == 0


def test_captures_of_other_instruments_are_refused(boards: list[xr.Dataset], tmp_path: Path) -> None:
    store = tmp_path / "shots.zarr"
    write(store, [generate(load_scene("photodetector-5m", {"rig.record.shots": 4}), seed=1)])
    with pytest.raises(InputError, match="checkerboard"):
        beambench.calibrate([store], procedures=[_LABEL], out=tmp_path / "rig.toml")
    rig = json.loads(str(boards[1].attrs["rig"]))
    rig["camera"]["pixel_pitch_m"] *= 2.0
    run = procedure_of(_LABEL).run
    with pytest.raises(InputError, match="several cameras"):
        run([hide_truth(boards[0]), hide_truth(boards[1]).assign_attrs(rig=json.dumps(rig))])
    two = hide_truth(boards[0]).isel(frame=[0, 1, 8, 9])
    with pytest.raises(InputError, match="Too few views"):
        run([two])


def test_a_covariance_that_is_none_is_refused(tmp_path: Path) -> None:
    for paths, covariance, said in (
        (["laser.position_m.0"], [[1.0, 0.0]], "rows and columns"),
        (["laser.position_m.0", "laser.position_m.1"], [[1.0, 2.0], [2.0, 1.0]], "negative"),
        (["laser.power_w"], [[1.0]], "different ones of"),
    ):
        rig = {"calibration": {"paths": paths, "covariance": covariance}}
        path = tmp_path / "rig.toml"
        write_rig_file(path, RigFile(kind="laser_line", rig=rig))
        with pytest.raises(InputError, match=said):
            load_scene("spotscan-wall", read_rig_file(path).overrides())
