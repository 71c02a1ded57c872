"""Estimators of wavefronts: noise against closed forms and the bound, lost spots, references, reconstructions."""

from __future__ import annotations

import json
from typing import Any

import numpy as np
import pytest
import xarray as xr

from beambench.benchmarks.bounds.wavefront import wavefront_bounds
from beambench.benchmarks.judges.bound import truths_of
from beambench.benchmarks.written.wavefront import written_capture
from beambench.captures.hide import hide_truth
from beambench.estimators import get_estimator, list_estimators, run_estimator
from beambench.estimators.result import stage_result
from beambench.estimators.rig import read_rig
from beambench.estimators.wavefront.cells import measured
from beambench.estimators.wavefront.moments import _plain, _plain_straight
from beambench.generator.generate import generate
from beambench.optics.lenslets.gradients import mean_gradients, square
from beambench.optics.zernike import zernike
from beambench.scenes.errors import InputError
from beambench.scenes.load import load_scene
from beambench.scenes.rigs.wavefront import wavefront_rig
from beambench.scenes.rigs.wavefront_geometry import lattice_of
from beambench.scenes.scene import Scene

PER_PX = 17.8e-6 / 6.7e-3
SPOTS = tuple(name for name in list_estimators("wavefront") if get_estimator(name).stage.word == "centroid")
BARE: dict[str, Any] = {
    "rig.lenslets.across": 8, "rig.pupil.shape": "square", "rig.pupil.diameter_m": 1.2e-3, "rig.camera.rows": 80,
    "rig.camera.cols": 80, "rig.pupil.modes": 10, "rig.pupil.samples": 4, "rig.detector.intensifier": None,
    "rig.detector.gain_dn_per_e": 1.0, "rig.detector.read_noise_e": 3.0, "rig.detector.adc_bits": 16,
    "rig.detector.dark_current_e_per_s": 0.0, "rig.frames.reference_exposures": 400,
}  # fmt: skip


def scene_of(frames: int, **changes: Any) -> Scene:
    return load_scene(
        "gated-turbulence", BARE | {"rig.frames.count": frames} | {f"rig.{k}": v for k, v in changes.items()}
    )


def spots(capture: xr.Dataset, name: str) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """(errors, sigma, valid) of positions."""
    found = run_estimator(name, hide_truth(capture))
    return found["spot"].values - truths_of(capture)["spot"].value, found["sigma"].values, found["valid"].values


def test_all_centroids_are_here() -> None:
    assert len(SPOTS) >= 11


@pytest.mark.parametrize("name", SPOTS)
def test_a_stated_error_is_true_where_spots_move_little(name: str) -> None:
    """64 spots in 20 frames: the rms of 2,560 errors scatters by 1.4 %, and spots share a background. Thresholds and choices of
    pixels are taken as fixed in the stated error, and a reading's error without noise as a sine over the pixel."""
    slope = 0.02 * PER_PX * np.random.default_rng(2).standard_normal((20, 64, 2))
    error, sigma, valid = spots(written_capture(scene_of(20), 3000.0, 2.0, slope, seed=3), name)
    assert valid.mean() > 0.99
    z = float(np.sqrt(np.mean((error / sigma)[valid] ** 2)))
    choosing = {
        "spot-brightest": 1.4, "spot-threshold": 1.25, "spot-power": 1.25, "spot-window": 1.25, "spot-correlation": 1.4,
    }  # fmt: skip  # fmt: skip
    assert 0.8 < z < choosing.get(name, 1.15)


def _moved_a_little(flux: float) -> xr.Dataset:
    """Spots moved by .08 px, as by d/r0 = .1: f (λ/d) √.162 (d/r0)^{5/6}. 8,192 values scatter by 1.6 %."""
    slope = 0.08 * PER_PX * np.random.default_rng(4).standard_normal((64, 64, 2))
    bright = {"detector.full_well_e": 1e6, "detector.gain_dn_per_e": 0.5} if flux > 3e4 else {}
    return written_capture(scene_of(64, **bright), flux, 1.0, slope, seed=5)


@pytest.mark.parametrize("flux", [300.0, 1e3, 3e3, 1e4, 3e4, 1e5])
def test_maximum_likelihood_attains_the_bound_with_a_true_sigma(flux: float) -> None:
    capture = _moved_a_little(flux)
    error, sigma, valid = spots(capture, "spot-ml")
    bound = wavefront_bounds(capture)["spot"]
    assert bound.kind == ("exact" if flux > 1000 else "quasi") and valid.mean() > 0.995
    efficiency = 1.0 / np.mean((error / bound.sigma)[valid] ** 2)
    assert 0.95 < efficiency < 1.0 + 4 * np.sqrt(2 / 8000)
    assert 0.95 < np.sqrt(np.mean((error / sigma)[valid] ** 2)) < 1.05


def test_light_of_neighbours_is_what_a_fit_of_the_spot_alone_errs_by() -> None:
    """At 100,000 photoelectrons it doubles the mean square error even where spots move by .08 px."""
    capture = _moved_a_little(1e5)
    bound = wavefront_bounds(capture)["spot"].sigma
    alone, taken = (np.mean((spots(capture, f"spot-ml{o}")[0] / bound) ** 2) for o in ("[neighbours=false]", ""))
    assert alone > 1.5 and taken < 1.0 / 0.95


def test_the_fit_takes_off_the_light_of_neighbours() -> None:
    """30,000 photoelectrons, spots moved by a quarter of a pixel: per-spot likelihood errs by the light of neighbours, which later
    rounds model. 3,072 values: 2.6 %."""
    slope = 0.25 * PER_PX * np.random.default_rng(4).standard_normal((24, 64, 2))
    capture = written_capture(scene_of(24), 3e4, 1.0, slope, seed=5)
    bound = wavefront_bounds(capture)["spot"].sigma
    names = ("spot-ml[neighbours=false]", "spot-ml", "spot-joint")
    alone, one, joint = (np.mean((spots(capture, name)[0] / bound) ** 2) for name in names)
    assert alone > 2.0 and one < 1.13 and joint < 1.13


@pytest.mark.parametrize("name", SPOTS)
def test_no_centroid_beats_the_bound(name: str) -> None:
    slope = 0.3 * PER_PX * np.random.default_rng(6).standard_normal((16, 64, 2))
    capture = written_capture(scene_of(16), 1000.0, 1.0, slope, seed=7)
    error, _, valid = spots(capture, name)
    bound = wavefront_bounds(capture)["spot"].sigma
    assert np.mean((error / bound)[valid] ** 2) > 1.0 - 4 * np.sqrt(2 / 2048)


def test_the_bound_of_a_spot_is_that_of_its_light() -> None:
    """Photon noise alone of one finely sampled spot: a photon of sinc²(x/w)/w tells ∫ p'²/p = (4/w²) ∫ sinc'² = 4π²/3w² of its
    place. Pixels of w/24, which blur the dark rings, and what lies beyond a pitch leave 6 % of the error at most."""
    others = [[r, c] for r in range(8) for c in range(8) if (r, c) != (4, 4)]
    fine = {"camera.pixel_pitch_m": 1e-6, "camera.rows": 1360, "camera.cols": 1360, "lenslets.missing": others}
    fine |= {"frames.reference_exposures": 1}
    capture = written_capture(scene_of(1, **{"detector.read_noise_e": 0.0}, **fine), 1e5, 1e-6, 0.0, seed=1)
    found = float(wavefront_bounds(capture)["spot"].sigma[0, 0, 0])
    width = 532e-9 * 6.7e-3 / 150e-6 / 1e-6
    exact = np.sqrt(3.0 / 1e5) * width / (2 * np.pi) * np.sqrt(2)
    assert 1.0 < found / exact < 1.06


def test_centre_of_gravity_has_the_noise_of_its_closed_form() -> None:
    """Read noise alone: σ² = σ_r² Σx²/N² over the cell's pixels. 2,560 values scatter by 1.4 %; the tails that the cell cuts off
    leave N at 93 to 97 %."""
    scene = scene_of(20, **{"detector.read_noise_e": 100.0, "detector.offset_dn": 2000.0})
    capture = written_capture(scene, 2e4, 0.0, 0.0, seed=8)
    error, _, valid = spots(capture, "spot-centroid")
    lattice = lattice_of(wavefront_rig(scene))
    step = np.arange(-6, 7)
    x = np.rint(lattice.col_px)[:, None] + step - lattice.col_px[:, None]
    y = np.rint(lattice.row_px)[:, None] + step - lattice.row_px[:, None]
    inside_x, inside_y = np.abs(x) <= 8.427 / 2, np.abs(y) <= 8.427 / 2
    spread = (x**2 * inside_x).sum(axis=1) * inside_y.sum(axis=1)
    exact = np.sqrt(100.0**2 * spread.mean()) / 2e4
    assert 1.0 < error[valid][:, 0].std() / exact < 1.12


def test_a_lost_spot_is_invalid_and_never_zero() -> None:
    flux = np.full((3, 64), 3000.0)
    flux[1, 20] = 0.0
    capture = written_capture(scene_of(3), flux, 2.0, 0.0, seed=9)
    for name in SPOTS:
        found = run_estimator(name, hide_truth(capture))
        assert not found["valid"].values[1, 20] and np.isnan(found["spot"].values[1, 20]).all(), name
        assert found["valid"].values.sum() >= 3 * 64 - 3, name
    dark = written_capture(scene_of(2), np.array([[3000.0], [0.0]]) * np.ones(64), 2.0, 0.0, seed=9)
    found = run_estimator("spot-ml+slope-cell+zonal-southwell", hide_truth(dark))
    assert found["valid_phase"].values[0].any() and not found["valid_phase"].values[1].any()


def test_the_noise_of_the_reference_counts() -> None:
    """One exposure of the reference has the noise of a frame: √2 of the error, in estimate, stated error and bound."""
    sigma, rms, bound = [], [], []
    for exposures in (1, 400):
        capture = written_capture(scene_of(8, **{"frames.reference_exposures": exposures}), 3000.0, 1.0, 0.0, seed=10)
        error, stated, _ = spots(capture, "spot-ml")
        sigma.append(np.sqrt((stated**2).mean()))
        rms.append(np.sqrt((error**2).mean()))
        bound.append(np.sqrt((wavefront_bounds(capture)["spot"].sigma ** 2).mean()))
    assert sigma[0] / sigma[1] == pytest.approx(np.sqrt(2), rel=0.02)
    assert bound[0] / bound[1] == pytest.approx(np.sqrt(2), rel=0.01)
    assert rms[0] / rms[1] == pytest.approx(np.sqrt(2), rel=0.25)  # 128 readings of one reference


@pytest.mark.parametrize("name", ["spot-ml", "spot-gaussian", "spot-matched", "spot-weighted", "spot-window"])
def test_frames_that_move_by_a_pixel_move_the_spots_by_one(name: str) -> None:
    capture = hide_truth(written_capture(scene_of(2), 2e4, 2.0, 0.0, seed=11))
    base = run_estimator(name, capture)
    moved = run_estimator(name, capture.assign(counts=capture["counts"].roll(col=1)))
    change = moved["spot"].values - base["spot"].values
    assert np.nanmax(np.abs(change[..., 0] - 1.0)) < 0.05 and np.nanmax(np.abs(change[..., 1])) < 0.05


def test_a_reference_that_is_missing_or_of_another_lattice_is_refused() -> None:
    capture = hide_truth(written_capture(scene_of(1), 3000.0, 2.0, 0.0, seed=12))
    for value in (0.0, np.nan):
        with pytest.raises(InputError, match="no spot"):
            run_estimator("spot-ml", capture.assign(reference=capture["reference"] * 0 + value))
    rig = json.loads(capture.attrs["rig"])
    rng = np.random.default_rng(18)
    for axis in ("col_px", "row_px"):
        rig["lenslets"][axis] = [v + rng.uniform(-4.2, 4.2) for v in rig["lenslets"][axis]]
    with pytest.raises(InputError, match="declared lattice"):
        run_estimator("spot-centroid", capture.assign_attrs(rig=json.dumps(rig)))


@pytest.mark.parametrize("name", SPOTS)
def test_every_centroid_refuses_a_capture_without_reference_and_a_wrong_pitch(name: str) -> None:
    """A pitch of 6 % too much keeps all spots in their cells: the lattice of the reference tells. 3 % may be a curved reference."""
    capture = hide_truth(written_capture(scene_of(1), 3000.0, 2.0, 0.0, seed=12))
    with pytest.raises(InputError, match="no reference"):
        run_estimator(name, capture.drop_vars("reference"))
    rig = json.loads(capture.attrs["rig"])

    def declared(wider: float) -> xr.Dataset:
        whole = rig["lenslets"]
        lattice = {axis: [39.5 + wider * (v - 39.5) for v in whole[axis]] for axis in ("col_px", "row_px")}
        lattice |= {axis: [wider * v for v in whole[axis]] for axis in ("x_m", "y_m")}
        lattice["pitch_m"] = wider * whole["pitch_m"]
        return capture.assign_attrs(rig=json.dumps(rig | {"lenslets": whole | lattice}))

    for wider in (1.06, 0.94):
        with pytest.raises(InputError, match="another pitch") as caught:
            run_estimator(name, declared(wider))
        assert caught.value.next_step
    assert run_estimator(name, declared(1.03))["valid"].values.mean() > 0.5


@pytest.mark.parametrize("wrong", [("lenslets", "pitch_m"), ("camera", "pixel_pitch_m")])
@pytest.mark.parametrize("factor", [0.9, 1.1])
def test_a_pitch_that_is_not_that_of_the_declared_places_is_refused(wrong: tuple[str, str], factor: float) -> None:
    """Slopes, or the fit to them, were a tenth too large, without a word."""
    capture = hide_truth(written_capture(scene_of(1), 3000.0, 1.0, np.zeros((1, 64, 2)), seed=1))
    declared = json.loads(capture.attrs["rig"])
    declared[wrong[0]][wrong[1]] *= factor
    with pytest.raises(InputError, match="of two lattices"):
        run_estimator("spot-centroid", capture.assign_attrs(rig=json.dumps(declared)))


@pytest.mark.parametrize("name", SPOTS)
def test_a_dark_frame_is_invalid_and_a_dark_reference_refused(name: str) -> None:
    capture = hide_truth(written_capture(scene_of(2), np.array([[3000.0], [0.0]]) * np.ones(64), 2.0, 0.0, seed=9))
    found = run_estimator(name, capture)
    assert found["valid"].values[0].any() and not found["valid"].values[1].any()
    assert np.isnan(found["spot"].values[1]).all()
    dark = capture["reference"] * 0 + float(json.loads(capture.attrs["rig"])["detector"]["offset_dn"])
    with pytest.raises(InputError, match="no spot"):
        run_estimator(name, capture.assign(reference=dark))


def test_fewer_lenslets_than_modes_are_refused() -> None:
    scene = load_scene(
        "gated-turbulence", BARE | {"rig.frames.count": 1, "rig.lenslets.across": 2, "rig.pupil.shape": "disc"}
    )
    capture = hide_truth(written_capture(scene, 3000.0, 2.0, 0.0, seed=13))
    for name in ("zernike-ls", "zernike-map", "zonal-southwell"):
        with pytest.raises(InputError, match="fewer slopes than modes"):
            run_estimator(f"spot-ml+slope-cell+{name}[modes=12]", capture)
        for none in (-3, 1):
            with pytest.raises(InputError, match="outside its limits"):
                run_estimator(f"spot-ml+slope-cell+{name}[modes={none}]", capture)
    with pytest.raises(InputError, match="those of a disc"):
        square_pupil = hide_truth(written_capture(scene_of(1), 3000.0, 2.0, 0.0, seed=13))
        run_estimator("spot-ml+slope-cell+zernike-ls", square_pupil)


def _exact(rotation_deg: float = 0.0) -> tuple[Any, xr.Dataset, np.ndarray, np.ndarray]:
    """(declared rig, exact slopes of ten modes with a stated error of 1 µrad, the coefficients, the surface on the grid)."""
    scene = load_scene(
        "gated-turbulence",
        {"rig.pupil.modes": 10, "rig.lenslets.rotation_deg": rotation_deg, "rig.camera.rows": 220, "rig.camera.cols": 220},
    )  # fmt: skip
    capture = hide_truth(written_capture(scene, 3000.0, 2.0, 0.0, seed=14))
    rig = wavefront_rig(scene)
    lattice, rad = lattice_of(rig), np.random.default_rng(15).standard_normal(9)
    centre = np.stack([lattice.x_m, lattice.y_m], axis=1)
    own = mean_gradients(range(2, 11), centre, square(150e-6), 1.5e-3) @ rad * 532e-9 / (2 * np.pi)
    c, s = np.cos(np.deg2rad(rotation_deg)), np.sin(np.deg2rad(rotation_deg))
    slope = np.stack([c * own[:, 0] - s * own[:, 1], s * own[:, 0] + c * own[:, 1]], axis=1)[None]
    made = stage_result(
        "assignment", slope=slope, sigma=np.full(slope.shape, 1e-6), valid=np.ones(slope.shape[:2], bool)
    )
    unit = lattice.grid_m / 1.5e-3
    surface = np.tensordot(rad, zernike(range(2, 11), unit[None, :], unit[:, None]), axes=1)
    return read_rig(capture), made, rad, np.where(lattice.mask, surface - surface[lattice.mask].mean(), np.nan)


@pytest.mark.parametrize("rotation_deg", [0.0, 20.0])
def test_least_squares_refinds_exact_slopes(rotation_deg: float) -> None:
    rig, slopes, rad, surface = _exact(rotation_deg)
    for label in ({}, {"weighted": False}):
        found = get_estimator("zernike-ls").function(slopes, rig, **label)
        np.testing.assert_allclose(found["zernike"].values[0], rad, atol=1e-9)
        np.testing.assert_allclose(found["phase"].values[0], surface, atol=1e-8)


def test_the_prior_pulls_strong_wavefronts_little() -> None:
    rig, slopes, rad, surface = _exact()
    found = get_estimator("zernike-map").function(slopes, rig)
    np.testing.assert_allclose(found["zernike"].values[0], rad, atol=0.05)
    assert np.nanstd(found["phase"].values[0] - surface) < 0.1


@pytest.mark.parametrize("name", ["zonal-southwell", "zonal-fried"])
def test_zonal_reconstruction_refinds_smooth_wavefronts(name: str) -> None:
    """Planes exactly; of ten modes of 1 rad the error of the scheme is that of cubic terms between lenslets, some hundredths."""
    rig, slopes, rad, surface = _exact()
    found = get_estimator(name).function(slopes, rig)
    assert np.nanstd(found["phase"].values[0] - surface) < 0.1
    np.testing.assert_allclose(found["zernike"].values[0], rad, atol=0.1)
    plane = slopes.assign(slope=slopes["slope"] * 0 + np.array([2e-4, -1e-4]))
    flat = get_estimator(name).function(plane, rig)
    k = 2 * np.pi / 532e-9 * 3e-3 / 4
    np.testing.assert_allclose(flat["zernike"].values[0, :2], [k * 2e-4, -k * 1e-4], rtol=1e-9)
    np.testing.assert_allclose(flat["zernike"].values[0, 2:], 0.0, atol=1e-8)


@pytest.mark.parametrize("name", ["zernike-ls", "zonal-southwell", "zonal-fried"])
def test_coefficients_that_a_part_of_the_pupil_does_not_tell_apart_are_invalid(name: str) -> None:
    """They were valid, with values of 1e6 rad, where most spots were lost; the phase of what is seen remains."""
    rig, slopes, _, _ = _exact()
    centre = slopes["slope"].values[0] * 0 + np.stack(
        [rig.numbers("lenslets.x_m"), rig.numbers("lenslets.y_m")], axis=1
    )
    corner = np.argsort(centre.sum(axis=1))[:12]
    valid = np.isin(np.arange(len(centre)), corner)[None]
    noise = 1e-5 * np.random.default_rng(17).standard_normal(slopes["slope"].shape)
    part = stage_result(
        "assignment", slope=slopes["slope"].values + noise, sigma=np.full(noise.shape, 1e-5), valid=valid
    )
    found = get_estimator(name).function(part, rig, modes=22)
    assert not found["valid"].values.any()
    assert found["valid_phase"].values.any() == name.startswith("zonal")
    whole = get_estimator(name).function(slopes, rig, modes=22)
    assert whole["valid"].values.all()


def test_noise_of_coefficients_is_the_stated_one() -> None:
    """300 draws of white slopes: every coefficient's variance within five standard errors, √(2/300)."""
    rig, slopes, _, _ = _exact()
    shape = slopes["slope"].shape[1:]
    rng = np.random.default_rng(16)
    many = stage_result(
        "assignment", slope=1e-6 * rng.standard_normal((300, *shape)), sigma=np.full((300, *shape), 1e-6),
        valid=np.ones((300, shape[0]), bool),
    )  # fmt: skip
    for name in ("zernike-ls", "zonal-southwell"):
        found = get_estimator(name).function(many, rig)
        ratio = found["zernike"].values.var(axis=0) / found["sigma"].values[0] ** 2
        assert np.abs(ratio - 1).max() < 5 * np.sqrt(2 / 300), name


def test_a_recorded_capture_has_scales_and_no_bound() -> None:
    capture = written_capture(scene_of(1), 3000.0, 2.0, 0.0, seed=17)
    recorded = capture.drop_vars(["truth_flux", "truth_background"])
    for bound in wavefront_bounds(recorded).values():
        assert bound.kind == "none" and bound.scale > 0 and bound.window > 0


def test_frames_of_several_channels_are_refused() -> None:
    capture = hide_truth(written_capture(scene_of(1), 3000.0, 2.0, 0.0, seed=18))
    with pytest.raises(InputError, match="one channel"):
        run_estimator("spot-ml", capture.assign(counts=capture["counts"].expand_dims(channel=2, axis=3)))


@pytest.mark.parametrize("light", [1e-10, 2e-12])
def test_the_compiled_centre_of_gravity_is_that_of_the_cells(light: float) -> None:
    """Clipped pixels, a lost spot and two levels of light. The kernel sums in single precision, 6e-8 of what is summed: with whole
    offsets sums of counts are exact, and the light of a faint spot is a few per cent of that of its cell."""
    scene = load_scene("gated-turbulence", {
        "rig.laser.pulse_energy_j": light, "rig.lenslets.across": 10, "rig.frames.count": 3, "rig.pupil.diameter_m": 1.5e-3,
        "rig.camera.rows": 90, "rig.camera.cols": 92,
    })  # fmt: skip
    capture = hide_truth(generate(scene, seed=1, fidelity="geometric"))
    counts = capture["counts"].values.copy()
    counts[0, 40:44, 44:50], counts[1, 44:54, 20:30] = 4095, 100
    capture = capture.assign(counts=(capture["counts"].dims, counts))
    one, other = (measured(capture, _plain, reader=reader) for reader in (None, _plain_straight))
    assert 0 < (~one["valid"].values).sum() < one["valid"].size
    np.testing.assert_array_equal(one["valid"].values, other["valid"].values)
    for name in ("spot", "sigma"):
        np.testing.assert_allclose(other[name].values, one[name].values, rtol=1e-6, atol=2e-6)


@pytest.mark.parametrize("label", [
    "spot-power[alpha=-1]", "spot-power[alpha=0]", "spot-window[reach=0]", "spot-brightest[pixels=2]", "spot-weighted[width=0]",
    "spot-weighted[steps=0]", "spot-threshold[threshold=1]", "spot-threshold[sigmas=-1]", "spot-ml[steps=0]",
    "spot-joint[rounds=0]",
    "spot-gaussian[steps=-3]", "spot-matched[steps=0]", "spot-centroid[least_sigmas=-1]", "spot-quad[least_sigmas=-2]",
])  # fmt: skip
def test_an_option_outside_its_limits_is_refused_and_never_replaced(label: str) -> None:
    capture = hide_truth(written_capture(scene_of(1), 3000.0, 1.0, np.zeros((1, 64, 2)), seed=1))
    name = label.partition("[")[2].partition("=")[0]
    with pytest.raises(InputError) as caught:
        run_estimator(label, capture)
    assert caught.value.where == name and caught.value.allowed and caught.value.next_step
