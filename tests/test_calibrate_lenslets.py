"""The procedure `lenslets`: a planted array comes back with errors that are true; its rig file in scenes and twins; refusals."""

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
from beambench.captures import write
from beambench.captures.hide import hide_truth
from beambench.estimators import run_estimator
from beambench.estimators.calibration.procedure import Calibrated, procedure_of
from beambench.estimators.calibration.wavefront_lenslets import fitted_lattice
from beambench.generator.generate import generate
from beambench.scenes.load import load_scene
from beambench.scenes.rig_files import read_rig_file

#: Small: 76 lenslets, one frame, a reference of four exposures.
_SMALL: dict[str, Any] = {
    "rig.lenslets.across": 12, "rig.camera.rows": 110, "rig.camera.cols": 112, "rig.pupil.diameter_m": 1.5e-3,
    "rig.frames.count": 1, "rig.frames.reference_exposures": 4,
}  # fmt: skip
_BELIEVED = {"lenslets.offset_m": [0.0, 0.0], "lenslets.rotation_deg": 0.0, "lenslets.pitch_m": 150e-6}
_UNFIT = r"too few spots|another pitch|no lattice"
#: x, y [m], turn [degree], pitch [m]: half a pixel, 5 % of a pixel at the rim, .2 %.
_PLANTED = (9e-6, -6e-6, 0.3, 150.3e-6)


def _capture(planted: tuple[float, float, float, float], seed: int, **more: Any) -> xr.Dataset:
    """A capture of an array that lies where it is planted, declared at the middle."""
    x, y, turn, pitch = planted
    array = {
        "rig.lenslets.preset": "", "rig.lenslets.focal_length_m": 6.7e-3, "rig.lenslets.pitch_m": pitch,
        "rig.lenslets.offset_m": [x, y], "rig.lenslets.rotation_deg": turn, "declared": _BELIEVED,
    }  # fmt: skip
    return generate(load_scene("gated-turbulence", {**_SMALL, **array, **more}), seed=seed, fidelity="geometric")


def _found(*captures: xr.Dataset) -> Calibrated:
    made: Calibrated = procedure_of("lenslets").run([hide_truth(one) for one in captures])
    return made


def _z(found: Calibrated, planted: tuple[float, float, float, float]) -> list[float]:
    return [(one.value - value) / one.sigma for one, value in zip(found.figures[:4], planted, strict=True)]


@pytest.fixture(scope="module")
def capture() -> xr.Dataset:
    return _capture(_PLANTED, 3)


def test_a_planted_array_comes_back(capture: xr.Dataset) -> None:
    """Offset, turn and pitch within 4.5 of their errors, a thousandth of a pixel; the spot is as wide as declared to 3 %."""
    found = _found(capture)
    assert [one.path for one in found.figures[:4]] == [
        "rig.lenslets.offset_m.0", "rig.lenslets.offset_m.1", "rig.lenslets.rotation_deg", "rig.lenslets.pitch_m",
    ]  # fmt: skip
    assert max(map(abs, _z(found, _PLANTED))) < 4.5 and found.figures[0].sigma < 5e-8
    by = {one.name: one.value for one in found.figures}
    assert by["width of the spots, 1 σ"] == pytest.approx(by["the same of the declared spot"], rel=0.03)
    assert by["pitch in pixels"] == pytest.approx(150.3 / 17.8, rel=1e-4)
    assert "whole pitches" in found.figures[0].note


@pytest.mark.slow
def test_the_stated_errors_are_true() -> None:
    """64 z of 16 arrays: their rms errs by .09; .7 to 1.35 allowed. Light of lenslets beside the declared ones, left out of the
    fit, makes the pitch's alone 1.6."""
    z = []
    for seed in range(16):
        rng = np.random.default_rng(seed)
        x, y = rng.uniform(-20e-6, 20e-6, 2).tolist()
        planted = (x, y, float(rng.uniform(-0.5, 0.5)), 150e-6 * (1.0 + float(rng.uniform(-3e-3, 3e-3))))
        z.append(_z(_found(_capture(planted, seed)), planted))
    assert 0.7 < np.sqrt(np.mean(np.square(z))) < 1.35, np.sqrt(np.mean(np.square(z), axis=0))
    assert np.abs(np.mean(z, axis=0)).max() < 1.0


def test_several_references_narrow_the_errors_and_one_counts_once(capture: xr.Dataset) -> None:
    one, both = _found(capture), _found(capture, _capture(_PLANTED, 4))
    assert both.figures[0].sigma == pytest.approx(one.figures[0].sigma / np.sqrt(2.0), rel=0.15)
    assert max(map(abs, _z(both, _PLANTED))) < 4.5
    twice = _found(capture, capture)
    assert twice.used["references"] == 1 and twice.figures[0].sigma == one.figures[0].sigma


def test_an_array_that_lies_a_pitch_away_is_given_at_the_declared_place() -> None:
    """A lattice looks the same after a step: an array 8.43 px to the right reads as one that is not moved. The note says so."""
    whole = (150e-6, 0.0, 0.0, 150e-6)
    found = _found(_capture(whole, 5))
    assert abs(found.figures[0].value % 150e-6) < 1e-6 or abs(found.figures[0].value % 150e-6 - 150e-6) < 1e-6


def test_a_lattice_without_noise_is_exact_and_dust_is_left_out() -> None:
    u, v = (part.ravel() for part in np.meshgrid(np.arange(-5.0, 6.0), np.arange(-5.0, 6.0)))
    steps, turn = np.stack([u, v], axis=1), np.deg2rad(0.7)
    place = np.stack(
        [50.2 + 8.4 * (np.cos(turn) * u - np.sin(turn) * v), 48.9 + 8.4 * (np.sin(turn) * u + np.cos(turn) * v)], axis=1
    )
    rng = np.random.default_rng(2)
    place += 0.01 * rng.standard_normal(place.shape)
    place[7] += [1.5, 0.0]
    found = fitted_lattice(place, np.full(place.shape, 1e-4), steps)
    assert not found.used[7] and found.used.sum() >= len(place) - 2
    true = [50.2, 48.9, 8.4, turn]
    sigma = np.sqrt(np.diag(found.covariance))
    assert np.abs(([*found.middle_px, found.pitch_px, found.turn_rad] - np.array(true)) / sigma).max() < 4.0
    with pytest.raises(InputError, match="Too few spots"):
        fitted_lattice(place[:2], np.ones((2, 2)), steps[:2])


def test_the_command_writes_a_file_that_scenes_and_estimators_take(
    capture: xr.Dataset, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Spots are declared within .01 px of where they are, and half a pixel beside them by the first values."""
    store, out = tmp_path / "spots.zarr", tmp_path / "my-rig.toml"
    write(store, [capture])
    assert cli.main(["calibrate", str(store), "-o", str(out)]) == 0
    assert "lenslets:" in capsys.readouterr().out
    file = read_rig_file(out, "wavefront")
    assert file.rig["lenslets"]["preset"] == "" and file.uncertainty["rig.lenslets.offset_m.1"] > 0
    scene: Any = load_scene("gated-turbulence", file.overrides())  # over a preset
    assert scene.rig.lenslets.pitch_m == file.rig["lenslets"]["pitch_m"] != 150e-6
    declared = {path.removeprefix("rig."): value for path, value in file.overrides().items()}
    off = {}
    for name, believed in (("first", _BELIEVED), ("file", declared)):
        one = _capture(_PLANTED, 3, declared=believed)
        held = json.loads(str(one.attrs["rig"]))["lenslets"]
        off[name] = abs(float(np.mean(held["col_px"])) - (55.5 + _PLANTED[0] / 17.8e-6))
    assert off["file"] < 0.01 < 0.4 < off["first"]


def test_wavefronts_are_better_with_the_file() -> None:
    """Astigmatism of 2 rad in still water, read by an array that is declared 3° beside its turn: .2 rad of it go into the other
    astigmatism."""
    planted = (2e-6, -1e-6, 20.0, 150e-6)
    more = {
        "rig.frames.count": 16, "rig.turbulence": {"kind": "none"}, "rig.aberration": {"noll": [5], "rad": [2.0]},
    }  # fmt: skip
    first = {**_BELIEVED, "lenslets.rotation_deg": 17.0}
    capture = _capture(planted, 3, declared=first, **more)
    found = _found(capture)
    single = {one.path: one.value for one in found.figures if one.path and not one.path.endswith((".0", ".1"))}
    values = {path.removeprefix("rig."): value for path, value in {**found.values, **single}.items()}
    off = {}
    for name, believed in (("first", first), ("file", values)):
        rig = _capture(planted, 3, declared=believed, **more).attrs["rig"]
        modes = run_estimator("spot-joint+slope-cell+zernike-ls[modes=10]", hide_truth(capture).assign_attrs(rig=rig))
        miss = modes["zernike"].values[:, :5] - capture["truth_zernike"].values[:, :5]
        off[name] = float(np.sqrt((miss.mean(axis=0) ** 2).mean()))
    assert off["file"] < 0.5 * off["first"], off


@pytest.mark.slow
def test_a_twin_takes_the_file(tmp_path: Path) -> None:
    """The twin of the file fails in nothing; that of the first values in the places of the spots."""
    base = {"rig.frames.count": 8, "rig.turbulence.layers": [{"range_m": 3.0, "r0_m": 1.0}]}
    moved = {"rig.lenslets.offset_m": [3e-6, -2e-6]}
    real = generate(load_scene("gated-turbulence", {**base, **moved, "declared": {"lenslets.offset_m": [0.0, 0.0]}}), seed=5,
                    fidelity="geometric")  # fmt: skip
    other = generate(load_scene("gated-turbulence", {**base, **moved, "declared": {"lenslets.offset_m": [0.0, 0.0]}}), seed=6,
                     fidelity="geometric")  # fmt: skip
    write(tmp_path / "other.zarr", [other])
    file = beambench.calibrate([tmp_path / "other.zarr"], out=tmp_path / "my-rig.toml").rig
    scene: Any = load_scene("gated-turbulence", base)
    rig = TwinRig(file.overrides(), dict(file.uncertainty))
    told = []
    for given in (rig, None):
        made = certified(hide_truth(real), Ask(given, scene, "geometric", 10, 1, ()))
        told.append({one.clause.name: str(one.verdict) for one in made.clauses})
    ours, wrong = told
    assert "fail" not in ours.values(), ours
    assert wrong["place-x"] == wrong["place-y"] == "fail"


def test_what_does_not_fit_is_refused(capture: xr.Dataset, tmp_path: Path) -> None:
    hidden = hide_truth(capture)
    dark = hidden.assign(reference=hidden["reference"] * 0.0 + 100.0)
    rng = np.random.default_rng(1)
    noise = hidden.assign(reference=hidden["reference"] * 0.0 + 100.0 + 30.0 * rng.random(hidden["reference"].shape))
    run = procedure_of("lenslets").run
    for bad in (dark, noise):
        with pytest.raises(InputError, match=_UNFIT):
            run([bad])
    for factor in (0.9, 1.1, 1.5):
        rig = json.loads(str(hidden.attrs["rig"]))
        rig["lenslets"]["pitch_m"] *= factor
        for name in ("x_m", "y_m"):
            rig["lenslets"][name] = [factor * value for value in rig["lenslets"][name]]
        for name, middle in (("col_px", 55.5), ("row_px", 54.5)):
            rig["lenslets"][name] = [middle + factor * (value - middle) for value in rig["lenslets"][name]]
        with pytest.raises(InputError, match=_UNFIT):
            run([hidden.assign_attrs(rig=json.dumps(rig))])
    rig = json.loads(str(hidden.attrs["rig"]))
    rig["lenslets"]["row"] = list(range(len(rig["lenslets"]["row"])))
    with pytest.raises(InputError, match="stand on an array"):
        run([hidden.assign_attrs(rig=json.dumps(rig))])
    with pytest.raises(InputError, match="several arrays"):
        run([hidden, hide_truth(_capture(_PLANTED, 3, declared={**_BELIEVED, "lenslets.offset_m": [1e-5, 0.0]}))])
    with pytest.raises(InputError, match="unknown parameter"):
        procedure_of("lenslets[rows=3]")
    assert "reference" in procedure_of("lenslets").lacking([hidden.drop_vars("reference")])
    assert "lenslet camera" in procedure_of("lenslets").lacking([hidden.assign_attrs(modality="gated")])
