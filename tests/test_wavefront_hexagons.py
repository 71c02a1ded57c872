"""Hexagonal grids of lenslets, from the rig to the coefficients, against closed forms."""

from __future__ import annotations

import json
from typing import Any

import numpy as np
import pytest

from beambench.benchmarks.bounds.wavefront import spot_sigma, wavefront_bounds
from beambench.benchmarks.judges.calibrate import calibrated_rig
from beambench.benchmarks.suites.spec import Calibration
from beambench.benchmarks.written.wavefront import written_capture
from beambench.captures.hide import hide_truth
from beambench.estimators import get_estimator, run_estimator
from beambench.estimators.result import stage_result
from beambench.estimators.rig import read_rig
from beambench.estimators.wavefront.geometry import declared_geometry
from beambench.generator.generate import generate
from beambench.generator.wavefront.expected import spread_within
from beambench.optics.lenslets.gradients import hexagon, mean_gradients
from beambench.optics.lenslets.hexagons import hexagon_density
from beambench.scenes.declared import declared_rig
from beambench.scenes.errors import InputError
from beambench.scenes.load import load_scene
from beambench.scenes.rigs.wavefront import wavefront_rig
from beambench.scenes.rigs.wavefront_geometry import clear_area_m2, lattice_of
from beambench.scenes.scene import Scene

PIXEL = 17.8e-6
PER_RAD = 6.7e-3 / PIXEL
SMALL: dict[str, Any] = {
    "rig.propagation": "phase-screens", "rig.turbulence": {"kind": "none"}, "rig.lenslets.grid": "hexagonal",
    "rig.lenslets.across": 7, "rig.pupil.diameter_m": 1e-3, "rig.pupil.modes": 10, "rig.camera.rows": 84, "rig.camera.cols": 84,
    "rig.frames.count": 1, "rig.detector.intensifier": None, "rig.detector.gain_dn_per_e": 1.0, "rig.detector.read_noise_e": 3.0,
    "rig.detector.dark_current_e_per_s": 0.0, "rig.detector.adc_bits": 16,
}  # fmt: skip


def hexagons(**changes: Any) -> Scene:
    return load_scene("gated-turbulence", SMALL | changes)


def test_three_rings_about_the_middle_lenslet_are_used() -> None:
    """3n(n + 1) + 1 lenslets of n rings, 37, whose pitch is the distance of the six neighbours of each."""
    lattice = lattice_of(wavefront_rig(hexagons()))
    place = np.stack([lattice.x_m, lattice.y_m], axis=1)
    assert len(place) == 37 and np.hypot(*place.T).min() == 0.0
    apart = np.linalg.norm(place[:, None] - place, axis=2)
    near = np.abs(apart - 150e-6) < 1e-12
    assert near.sum() == 2 * 90 and apart[apart > 0].min() == pytest.approx(150e-6)  # 9n² + 3n pairs
    missing = lattice_of(wavefront_rig(hexagons(**{"rig.lenslets.missing": [[3, 3], [2, 2]]})))
    assert missing.row.size == 35 and (3, 3) not in set(zip(missing.row.tolist(), missing.col.tolist(), strict=True))


def test_a_square_rig_declares_and_writes_nothing_new() -> None:
    square = load_scene("gated-turbulence", {})
    assert (
        "grid" not in declared_rig(square)["lenslets"]
        and "missing_share" not in square.model_dump(mode="json")["rig"]["lenslets"]
    )
    assert declared_rig(hexagons())["lenslets"]["grid"] == "hexagonal"


@pytest.mark.parametrize("rung", ["geometric", "isolated", "coherent"])
def test_a_tilt_moves_every_spot_by_f_times_its_slope(rung: str) -> None:
    """A tilt of a rad rms has the slope 4a/(kD); centres of gravity of the light about each place move by f times that, but for
    neighbours' tails; fields that interfere move them by some hundredths more."""
    scene = hexagons(**{"rig.aberration": {"noll": [2, 3], "rad": [2.0, -1.0]}})
    capture = generate(scene, seed=1, fidelity=rung, truth_electrons=True)  # type: ignore[arg-type]
    slope = 4.0 * np.array([2.0, -1.0]) / (2.0 * np.pi / 532e-9 * 1e-3)
    np.testing.assert_allclose(capture["truth_slope"].values[0], np.broadcast_to(slope, (37, 2)), rtol=1e-9)
    found = run_estimator("spot-ml", hide_truth(capture.assign(counts=capture["truth_electrons"] + 100.0)))
    lattice = lattice_of(wavefront_rig(scene))
    moved = found["spot"].values[0] - np.stack([lattice.col_px, lattice.row_px], axis=1)
    inner = np.hypot(lattice.x_m, lattice.y_m) < 0.32e-3
    assert found["valid"].values[0][inner].all()
    np.testing.assert_allclose(moved[inner].mean(axis=0), PER_RAD * slope, atol=0.02)


def test_the_rungs_agree_on_a_flat_wave() -> None:
    """Cells that lie partly in the hexagon: .7 % rms of the pattern in closed form, and 2 % of the light in far tails."""
    one, other = (
        generate(hexagons(), seed=1, fidelity=rung, truth_electrons=True)["truth_electrons"].values[0]
        for rung in ("geometric", "isolated")
    )
    assert np.sqrt(((other - one) ** 2).sum() / (one**2).sum()) < 0.01
    assert 0.96 < other.sum() / one.sum() < 1.0


def test_light_goes_with_the_clear_area() -> None:
    full, half = (wavefront_rig(hexagons(**{"rig.lenslets.fill": fill})) for fill in (1.0, 0.5))
    assert clear_area_m2(full) == pytest.approx(np.sqrt(0.75) * 150e-6**2)
    assert clear_area_m2(half) == pytest.approx(0.25 * clear_area_m2(full))
    capture = generate(hexagons(), seed=1, fidelity="geometric", truth_electrons=True)
    square = generate(hexagons(**{"rig.lenslets.grid": None}), seed=1, fidelity="geometric")
    ratio = float(capture["truth_flux"].values.mean()) / float(square["truth_flux"].values.mean())
    assert ratio == pytest.approx(np.sqrt(0.75))


def test_slopes_are_averages_over_the_hexagon() -> None:
    """Coma and trefoil, whose gradients are quadratic: the mean over a hexagon by edge integrals, to the grid's second order."""
    scene = hexagons(**{"rig.aberration": {"noll": [4, 7, 9], "rad": [1.0, 0.7, -0.5]}, "rig.pupil.samples": 24})
    lattice = lattice_of(wavefront_rig(scene))
    centre = np.stack([lattice.x_m, lattice.y_m], axis=1)
    want = mean_gradients([4, 7, 9], centre, hexagon(150e-6), 0.5e-3) @ [1.0, 0.7, -0.5] * 532e-9 / (2 * np.pi)
    found = generate(scene, seed=1, fidelity="geometric")["truth_slope"].values[0]
    np.testing.assert_allclose(found, want, atol=2e-3 * np.abs(want).max())


@pytest.mark.parametrize(("light", "least"), [(3000.0, 0.9), (30000.0, 0.8)])
def test_maximum_likelihood_is_near_the_bound(light: float, least: float) -> None:
    """Spots of the written closed form, 37 lenslets in 25 frames: the declared product of two profiles costs some per cent; the
    ratio of variances has a standard error of √(2/1850) = 3.3 %."""
    scene = hexagons(**{"rig.frames.count": 25})
    slope = 0.08 / PER_RAD * np.random.default_rng(4).standard_normal((25, 37, 2))
    capture = written_capture(scene, light, 2.0, slope, seed=5)
    bound = wavefront_bounds(capture)["spot"]
    assert bound.kind == "exact"
    found = run_estimator("spot-ml", hide_truth(capture))
    lattice = lattice_of(wavefront_rig(scene))
    error = found["spot"].values - np.stack([lattice.col_px, lattice.row_px], axis=1) - slope * PER_RAD
    assert found["valid"].values.all()
    assert least < np.mean(bound.sigma**2) / np.mean(error**2) < 1.07
    assert 0.93 < np.sqrt(np.mean((error / found["sigma"].values) ** 2)) < 1.1


def test_the_spread_within_hexagons_is_that_about_each_ones_best_plane() -> None:
    """Weighted least squares, lenslet by lenslet, of a random phase."""
    lattice = lattice_of(wavefront_rig(hexagons()))
    phase = np.random.default_rng(7).standard_normal(lattice.mask.shape)
    assert lattice.cover is not None
    cover, square, light = lattice.cover.toarray(), 0.0, 0.0
    x, y = (one.ravel() / 150e-6 for one in np.broadcast_arrays(lattice.grid_m[None, :], lattice.grid_m[:, None]))
    basis = np.stack([np.ones_like(x), x, y], axis=1)
    for weight in cover:
        root = np.sqrt(weight)[:, None]
        fit = np.linalg.lstsq(root * basis, root[:, 0] * phase.ravel(), rcond=None)[0]
        square, light = square + float(weight @ (phase.ravel() - basis @ fit) ** 2), light + float(weight.sum())
    assert spread_within(phase, lattice) == pytest.approx(np.sqrt(square / light), rel=1e-9)
    assert spread_within((3.0 * x - 2.0 * y).reshape(phase.shape), lattice) < 1e-6


def test_the_bound_is_that_of_pixels_integrated_one_by_one() -> None:
    """One lenslet, 1e5 photoelectrons: F = Σ ∂μ ∂μᵀ/(μ + σ²) over a window of a pitch to either side, by quadrature of the
    pattern's closed form and its differences. Of the exact likelihood J is above 1/(μ + σ²) by less than 1/2μ."""
    others = [[r, c] for r in range(7) for c in range(7) if (r, c) != (3, 3)]
    rig = wavefront_rig(hexagons(**{"rig.lenslets.missing": others}))
    at, width = np.array([41.3, 41.6]), 532e-9 * 6.7e-3 / 150e-6 / PIXEL
    node, weight = np.polynomial.legendre.leggauss(10)
    step = np.arange(-9, 10)

    def shares(x: float, y: float) -> np.ndarray:
        u = (41 + step[:, None] + 0.5 * node - x).ravel() / width
        v = (42 + step[:, None] + 0.5 * node - y).ravel() / width
        density = hexagon_density(u[None, :], v[:, None]).reshape(19, 10, 19, 10) / width**2
        return np.asarray(0.25 * np.einsum("rgch,g,h->rc", density, weight, weight))

    h, light = 1e-4, 1e5
    along = (shares(at[0] + h, at[1]) - shares(at[0] - h, at[1])) / (2 * h)
    down = (shares(at[0], at[1] + h) - shares(at[0], at[1] - h)) / (2 * h)
    gradient = np.stack([light * along, light * down, shares(*at)]).reshape(3, -1)
    noise = light * gradient[2] + 9.0 + 1.0 / 12.0
    want = np.sqrt(np.diagonal(np.linalg.inv(gradient / noise @ gradient.T))[:2])
    np.testing.assert_allclose(spot_sigma(rig, at[None], np.array([light]), 1e-9)[0], want, rtol=0.02)


def test_a_spot_in_the_corner_of_the_square_is_anothers() -> None:
    geometry = declared_geometry(read_rig(generate(hexagons(), seed=1, fidelity="geometric")))
    half = 0.5 * geometry.pitch_px
    corner = np.array([[0.5, 0.9], [0.99, 0.0], [0.0, 1.1], [-0.5, 0.9], [0.0, 0.0]]) * half
    assert geometry.within(corner).tolist() == [False, True, True, False, True]
    assert not geometry.within(np.full((1, 2), np.nan)).any()


def test_least_squares_average_over_hexagons_and_state_their_noise() -> None:
    """Exact slopes of nine modes come back; of tilts alone the variance is σ²(kR/2)²/n."""
    scene = hexagons()
    rig, lattice = read_rig(generate(scene, seed=1, fidelity="geometric")), lattice_of(wavefront_rig(scene))
    rad = np.random.default_rng(6).standard_normal(9)
    centre = np.stack([lattice.x_m, lattice.y_m], axis=1)
    slope = (mean_gradients(range(2, 11), centre, hexagon(150e-6), 0.5e-3) @ rad * 532e-9 / (2 * np.pi))[None]
    made = stage_result(
        "assignment", slope=slope, sigma=np.full(slope.shape, 1e-6), valid=np.ones(slope.shape[:2], bool)
    )
    least = get_estimator("zernike-ls").function
    np.testing.assert_allclose(least(made, rig)["zernike"].values[0], rad, atol=1e-9)
    tilts = least(made, rig, modes=3)["sigma"].values[0]
    np.testing.assert_allclose(tilts, 1e-6 * 2.0 * np.pi / 532e-9 * 0.5e-3 / 2.0 / np.sqrt(37), rtol=1e-9)


@pytest.mark.parametrize("name", ["zonal-southwell", "zonal-fried", "zernike-map"])
def test_methods_of_square_grids_say_so(name: str) -> None:
    capture = hide_truth(generate(hexagons(), seed=1, fidelity="geometric"))
    with pytest.raises(InputError, match="square lenslets only"):
        run_estimator(f"spot-ml+slope-cell+{name}", capture)


def test_spots_narrower_than_their_table_are_refused() -> None:
    with pytest.raises(InputError, match="narrower than their table"):
        hexagons(**{"rig.lenslets.preset": None, "rig.lenslets.pitch_m": 150e-6, "rig.lenslets.focal_length_m": 0.9e-3})


def test_too_few_samples_of_small_hexagons_are_refused_with_a_number_that_is_enough() -> None:
    """Half of a sample must lie in the clear hexagon: 1/fill samples, enough for squares, are not."""
    small = {"rig.lenslets.fill": 0.5, "rig.pupil.samples": 2}
    with pytest.raises(InputError, match="No sample of the pupil") as caught:
        hexagons(**small)
    enough = int(str(caught.value.allowed).partition(" ")[0])
    assert enough == 4 and hexagons(**small | {"rig.pupil.samples": enough}).modality == "wavefront"


def test_a_whole_chain_finds_the_coefficients() -> None:
    rad = [0.5, -0.4, 0.6, -0.3, 0.2]
    scene = hexagons(**{"rig.aberration": {"noll": [2, 3, 4, 5, 6], "rad": rad}, "rig.laser.pulse_energy_j": 1e-9})
    capture = generate(scene, seed=2, fidelity="coherent")
    found = run_estimator("spot-joint+slope-cell+zernike-ls", hide_truth(capture))
    np.testing.assert_allclose(capture["truth_zernike"].values[0, :5], rad, atol=5e-3)
    np.testing.assert_allclose(found["zernike"].values[0, :5], rad, atol=0.05)


def test_a_turned_array_is_for_the_geometric_rung_alone() -> None:
    scene = hexagons(**{"rig.lenslets.rotation_deg": 15.0})
    for rung in ("isolated", "coherent"):
        with pytest.raises(InputError, match="parallel"):
            generate(scene, seed=1, fidelity=rung)  # type: ignore[arg-type]
    assert np.isfinite(generate(scene, seed=1, fidelity="geometric")["truth_slope"]).all()


def test_auto_compares_hexagons_too() -> None:
    capture = generate(hexagons(), seed=1, fidelity="auto", rtol=0.3)
    assert json.loads(capture.attrs["fidelity"])["rung"] == "geometric"
    assert json.loads(generate(hexagons(), seed=1, fidelity="auto", rtol=1e-4).attrs["fidelity"])["rung"] == "coherent"


def test_a_reference_registers_a_hexagonal_lattice() -> None:
    scene = hexagons(**{"rig.lenslets.rotation_deg": 1.0})
    declared = declared_rig(hexagons())
    declared["lenslets"]["col_px"] = [value + 0.6 for value in declared["lenslets"]["col_px"]]
    found = json.loads(calibrated_rig(scene, json.dumps(declared), Calibration(spot_photoelectrons=6e4), seed=0))
    lattice = lattice_of(wavefront_rig(scene))
    np.testing.assert_allclose(found["lenslets"]["col_px"], lattice.col_px, atol=0.02)
    np.testing.assert_allclose(found["lenslets"]["row_px"], lattice.row_px, atol=0.02)
    assert found["lenslets"]["rotation_rad"] == pytest.approx(lattice.rotation_rad, abs=1e-3)
