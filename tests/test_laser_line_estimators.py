"""Line finders: exact without noise, pixel locking as computed, near the bound with noise, and refusal where there is no line."""

from __future__ import annotations

import json

import numpy as np
import pytest
import xarray as xr
from scipy.special import erf

from beambench.benchmarks.bounds.laser_line import column_sigma, line_noise
from beambench.benchmarks.judges.bound import bounds_of
from beambench.benchmarks.written.laser_line import written_capture
from beambench.captures.hide import hide_truth
from beambench.estimators import get_estimator, run_estimator
from beambench.optics.likelihood.model import NoiseModel
from beambench.scenes.errors import InputError
from beambench.scenes.load import load_scene
from beambench.scenes.rigs.laser_line import laser_line_rig
from beambench.scenes.scene import Scene

FINDERS = (
    "line-peak", "line-centroid", "line-window-centroid", "line-parabola", "line-log-gaussian", "line-erf", "line-ml",
)  # fmt: skip


def _scene(lens_px: float, **changes: object) -> Scene:
    """256 rows of 64 columns in two frames; 12 bits, 10 e of read noise."""
    values = {
        "rig.camera.cols": 64, "rig.lens_sigma_px": lens_px, "rig.detector.adc_bits": 12,
        "rig.detector.gain_dn_per_e": 0.05, "rig.detector.offset_dn": 100.0, "rig.detector.read_noise_e": 10.0,
    }  # fmt: skip
    return load_scene("spotscan-wall", values | {f"rig.detector.{key}": value for key, value in changes.items()})


def _phases() -> np.ndarray:
    """Columns of two frames whose phases fill a pixel evenly."""
    return 30.0 + np.linspace(-0.5, 0.5, 512, endpoint=False).reshape(2, 256)


def _errors(name: str, capture: xr.Dataset) -> tuple[np.ndarray, np.ndarray]:
    """(errors [px], errors over their stated standard errors) of the valid rows, all of which must be."""
    found = run_estimator(name, hide_truth(capture))
    assert found["valid"].values.all()
    error = (found["column"] - capture["truth_column"]).values
    return error, error / found["sigma"].values


@pytest.mark.parametrize("name", ["line-erf", "line-ml"])
@pytest.mark.parametrize("width", [0.4, 0.5, 0.75, 1.5])
def test_a_fit_refinds_columns_without_noise(name: str, width: float) -> None:
    capture = written_capture(_scene(width), 4e4, width, 20.0, _phases(), averaged=True)
    error, _ = _errors(name, capture)
    assert np.abs(error).max() < 1e-3
    # 8 bits over a peak of 220 DN: rounding, ±.5 DN, is all the noise there is.
    peak = 4e4 * erf(0.5 / (width * np.sqrt(2)))
    coarse = _scene(width, adc_bits=8, gain_dn_per_e=220.0 / peak, offset_dn=8.0, read_noise_e=0.0)
    error, _ = _errors(name, written_capture(coarse, 4e4, width, 20.0, _phases()))
    assert np.sqrt((error**2).mean()) < 0.005


@pytest.mark.parametrize(
    ("name", "rms", "within"),
    [("line-parabola", 0.0912, 0.002), ("line-centroid", 0.0725, 0.005), ("line-log-gaussian", 0.0038, 0.1),
     ("line-erf", 1e-6, 100.0), ("line-peak", 12**-0.5, 0.002)],
)  # fmt: skip
def test_pixel_locking_of_a_line_of_half_a_pixel(name: str, rms: float, within: float) -> None:
    """Without noise and rounding, s = .5 px: .091 and .073 px as measured before (docs: PHYSICS, «Laser line»)."""
    error, z = _errors(name, written_capture(_scene(0.479), 4e4, 0.5, 0.0, _phases(), averaged=True))
    assert np.sqrt((error**2).mean()) == pytest.approx(rms, rel=within)
    if rms > 0.05:
        # The stated error knows the locking of the declared width, .5 px here.
        assert np.sqrt((z**2).mean()) == pytest.approx(1.0, abs=0.05)


@pytest.mark.parametrize("width", [0.75, 1.2])
@pytest.mark.parametrize("electrons", [1500.0, 2e4])
def test_maximum_likelihood_attains_the_bound_with_a_true_sigma(width: float, electrons: float) -> None:
    """Peaks of 480 and more photoelectrons over 10 e of read noise: signal to noise above 15. 4096 rows."""
    scene, error, z = _scene(width), [], []
    for seed in range(8):
        capture = written_capture(scene, electrons, width, 20.0, _phases(), seed=seed)
        bound = bounds_of(capture)["column"]
        assert bound.kind == "exact"
        e, over = _errors("line-ml", capture)
        error.append(e / bound.sigma)
        z.append(over)
    # Four standard errors of a mean square of 4096 normal numbers: .09; the bound itself is to be met within 5 %.
    assert 1 - 0.045 < np.sqrt((np.array(error) ** 2).mean()) < 1.05 + 0.022
    assert np.sqrt((np.array(z) ** 2).mean()) == pytest.approx(1.0, abs=0.05)


@pytest.mark.parametrize("name", FINDERS)
@pytest.mark.parametrize("width", [0.3, 0.5, 0.9])
def test_no_finder_beats_the_bound(name: str, width: float) -> None:
    """Nor do biased ones, whose readings are better than an unbiased bound at some phases: the mean over phases holds."""
    scene, square, count = _scene(width), 0.0, 0
    for seed in range(4):
        capture = written_capture(scene, 3000.0, width, 20.0, _phases(), seed=seed)
        found = run_estimator(name, hide_truth(capture))
        error = (found["column"] - capture["truth_column"]).values / bounds_of(capture)["column"].sigma
        good = found["valid"].values
        assert good.mean() > (0.6 if name == "line-log-gaussian" else 0.9)  # a narrow line leaves its neighbours dark
        square, count = square + float((error[good] ** 2).sum()), count + int(good.sum())
    assert square / count > 1 - 4 * np.sqrt(2 / count)


def test_the_bound_is_that_of_light_and_position() -> None:
    """Without read noise, converter and background a line of N electrons and wide pixels' s has σ = s/√N (Sheppard's
    correction: √(s² + 1/12)/√N at most); twice the light, √2 less."""
    noise = NoiseModel(0.0, 1e3, 0.0, 2**30, 1e12)
    wide = float(column_sigma(np.array(1e4), np.array(3.0), np.array(0.0), noise))
    assert 3.0 / 100 < wide < np.sqrt(9 + 1 / 12) / 100 * 1.001
    quiet = line_noise(laser_line_rig(_scene(0.75)))
    one, two = (float(column_sigma(np.array(n), np.array(0.75), np.array(1e4), quiet)) for n in (100.0, 200.0))
    assert one / two == pytest.approx(2.0, rel=0.01)  # the background rules


def test_points_have_the_bound_of_their_columns() -> None:
    from beambench.generator.generate import generate

    capture = generate(load_scene("spotscan-wall"), seed=1)
    bounds = bounds_of(capture)
    ratio = bounds["point"].sigma / bounds["column"].sigma[..., None]
    length = np.sqrt((ratio**2).sum(axis=-1))
    # dR/dc is about R²w/(nfb): 11.6 mm at a metre.
    assert length.min() > 0.009 and length.max() < 0.014
    found = run_estimator("line-ml+triangulate-refractive", hide_truth(capture))
    error = (found["point"] - capture["truth_point"]).values / bounds["point"].sigma
    assert np.sqrt((error**2).mean()) == pytest.approx(1.0, abs=0.13)


def test_bad_frames_give_no_points() -> None:
    """A frame without a line, a saturated and a dark one, and a line at the image's edge."""
    scene = _scene(0.75)
    column = _phases()
    empty = written_capture(scene, 0.0, 0.75, 20.0, column, seed=1)
    for name in FINDERS:
        assert run_estimator(name, hide_truth(empty))["valid"].values.mean() < 0.01
    edge = written_capture(scene, 2e4, 0.75, 20.0, np.full((2, 256), 1.0), seed=1)
    bright = written_capture(scene, 4e6, 0.75, 20.0, column, seed=1)
    for capture in (edge, bright):
        for name in (*FINDERS, "line-ml+triangulate-refractive"):
            assert not run_estimator(name, hide_truth(capture))["valid"].values.any()


@pytest.mark.parametrize("name", ["line-erf", "line-ml"])
def test_several_returns_of_a_row_come_brightest_first(name: str) -> None:
    """Two lines 20 columns apart in one row; a third return, which is not there, is refused."""
    scene, left, right = _scene(0.75), _phases() - 10.0, _phases() + 10.0
    one, two = (
        written_capture(scene, light, 0.75, 20.0, column, averaged=True)
        for light, column in ((1e4, left), (2.5e4, right))
    )
    both = one.assign(counts=one["counts"] + two["counts"] - np.float32(101.0)).assign_attrs(one.attrs)
    found = run_estimator(f"{name}[returns=3]", hide_truth(both))
    assert found["column"].shape == (2, 256, 3)
    assert np.abs(found["column"].values[..., 0] - right).max() < 1e-3
    assert np.abs(found["column"].values[..., 1] - left).max() < 1e-3
    assert found["valid"].values[..., :2].all() and not found["valid"].values[..., 2].any()
    points = run_estimator(f"{name}+triangulate-refractive[returns=2]", hide_truth(both))
    assert points["point"].shape == (2, 256, 2, 3) and points["valid"].values.all()


def test_a_recorded_capture_has_scales_and_no_bound() -> None:
    """Without true scene: kind "none", with 4 px, and metres that follow from the declared baseline."""
    capture = written_capture(_scene(0.75), 2e4, 0.75, 20.0, _phases(), seed=1)
    recorded = capture.drop_attrs().assign_attrs({**capture.attrs, "truth_kind": "none"})
    del recorded.attrs["truth_scene"]
    bounds = bounds_of(recorded)
    assert {name: bound.kind for name, bound in bounds.items()} == {"column": "none", "point": "none"}
    assert bounds["column"].scale == 4.0 and 0.01 < bounds["point"].scale < 1.0
    assert bounds["point"].sigma.shape == capture["truth_point"].shape


def test_frames_of_several_channels_are_refused() -> None:
    capture = hide_truth(written_capture(_scene(0.75), 2e4, 0.75, 20.0, _phases(), seed=1))
    colour = capture.assign(counts=capture["counts"].expand_dims(channel=3, axis=-1))
    with pytest.raises(InputError, match="one channel"):
        run_estimator("line-peak", colour)


# ---------------------------------------------------------------- chains


def test_a_chain_is_its_links_and_takes_their_parameters() -> None:
    capture = hide_truth(written_capture(_scene(0.75), 2e4, 0.75, 20.0, _phases(), seed=1))
    chain = get_estimator("line-centroid+triangulate-refractive")
    assert chain.stage.word == "triangulation" and chain.reads_captures and chain.modality == "laser_line"
    plain, other = (
        run_estimator(f"line-centroid{part}+triangulate-refractive{label}", capture)
        for part, label in (("", ""), ("", "[threshold=0.6]"))
    )
    assert plain.attrs["estimator"] == "line-centroid+triangulate-refractive"
    assert not np.array_equal(plain["point"], other["point"]) and plain["point"].dims[-1] == "xyz"
    with pytest.raises(InputError, match="unknown parameter"):
        run_estimator("line-centroid+triangulate-refractive[width=1]", capture)
    assert json.loads(capture.attrs["rig"])["kind"] == "laser_line"


@pytest.mark.parametrize(
    ("label", "said"),
    [("triangulate-air+line-peak", "does not read"), ("line-peak+line-erf", "does not read"),
     ("line-peak+nothing", "no such estimator"), ("peak+triangulate-air", "does not read"), ("line-peak+", "malformed")],
)  # fmt: skip
def test_a_chain_whose_links_do_not_fit_is_refused(label: str, said: str) -> None:
    capture = hide_truth(written_capture(_scene(0.75), 2e4, 0.75, 20.0, _phases(), seed=1))
    with pytest.raises(InputError, match=said):
        run_estimator(label, capture)


def test_an_estimator_of_a_later_stage_alone_reads_no_capture() -> None:
    capture = hide_truth(written_capture(_scene(0.75), 2e4, 0.75, 20.0, _phases(), seed=1))
    with pytest.raises(InputError, match="another stage") as caught:
        run_estimator("triangulate-air", capture)
    assert "FIRST+triangulate-air" in str(caught.value)


def test_a_learned_profile_takes_the_halo_of_turbid_water_along() -> None:
    """Coastal water, 512 rows: what scattering puts beside the line makes a Gaussian follow the phase of the pixel. The template
    errs by less and says by how much; in clear water it is as good as the Gaussian. 512 rows tell an rms to 3 %."""
    from beambench.benchmarks.suites.suite import load_suite
    from beambench.generator.generate import generate

    scenes = dict(load_suite("laser-line").scenes)
    rms, z = {}, {}
    for water in ("fresh", "coastal"):
        capture = generate(scenes[water], seed=101, fidelity="scatter", rtol=3e-3)
        for name in ("line-ml", "line-template"):
            found = run_estimator(name, hide_truth(capture))
            held = found["valid"].values
            assert held.mean() > 0.99
            error = (found["column"] - capture["truth_column"]).values[held]
            rms[water, name] = float(np.sqrt((error**2).mean()))
            z[water, name] = float(np.sqrt(((error / found["sigma"].values[held]) ** 2).mean()))
    assert rms["fresh", "line-template"] == pytest.approx(rms["fresh", "line-ml"], rel=0.06)
    assert rms["coastal", "line-template"] < 0.92 * rms["coastal", "line-ml"]
    assert z["coastal", "line-ml"] > 1.1 and z["coastal", "line-template"] == pytest.approx(1.0, abs=0.09)
