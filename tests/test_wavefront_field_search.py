"""Spots that left their cells: found in the whole frame, given to their lenslets, and read in cells of their own."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from beambench.benchmarks.written.wavefront import written_capture
from beambench.captures.hide import hide_truth
from beambench.estimators import get_estimator, list_estimators, run_estimator
from beambench.estimators.wavefront.field_search import assigned_spots, spots_in
from beambench.scenes.load import load_scene
from beambench.scenes.rigs.wavefront import wavefront_rig
from beambench.scenes.rigs.wavefront_geometry import lattice_of
from beambench.scenes.scene import Scene

PER_PX = 17.8e-6 / 6.7e-3
SPOTS = tuple(name for name in list_estimators("wavefront") if get_estimator(name).stage.word == "centroid")
WIDE: dict[str, Any] = {
    "rig.lenslets.across": 12, "rig.pupil.shape": "square", "rig.pupil.diameter_m": 1.8e-3, "rig.camera.rows": 140,
    "rig.camera.cols": 140, "rig.pupil.modes": 10, "rig.pupil.samples": 4, "rig.detector.intensifier": None,
    "rig.detector.gain_dn_per_e": 1.0, "rig.detector.read_noise_e": 3.0, "rig.detector.adc_bits": 16,
    "rig.detector.dark_current_e_per_s": 0.0, "rig.frames.reference_exposures": 100, "rig.frames.count": 1,
}  # fmt: skip


def scene_of(**changes: Any) -> Scene:
    return load_scene("gated-turbulence", WIDE | {f"rig.{k}": v for k, v in changes.items()})


def defocused(scene: Scene, stretch: float, tilt_px: tuple[float, float], seed: int = 1) -> np.ndarray:
    """Slopes (1, lenslet, axis) of a defocus that stretches the spot field, a tilt, and .1 px rms of turbulence."""
    lattice = lattice_of(wavefront_rig(scene))
    place = np.stack([lattice.col_px, lattice.row_px], axis=1)
    moved = stretch * (place - place.mean(axis=0)) + np.asarray(tilt_px)
    return np.asarray((moved + 0.1 * np.random.default_rng(seed).standard_normal(moved.shape)) * PER_PX)[None]


@pytest.mark.parametrize("name", SPOTS)
def test_every_centroid_follows_spots_beyond_their_cells(name: str) -> None:
    """Spots of the rim move by .8 of the pitch, and all by .3: in the cells of their lenslets lie other spots, or none."""
    scene = scene_of()
    slope = defocused(scene, 0.12, (2.5, -1.5))
    capture = hide_truth(written_capture(scene, 3000.0, 2.0, slope, seed=3))
    truth = slope / PER_PX + get_place(scene)
    wrong = {}
    for search in ("cell", "field"):
        found = run_estimator(f"{name}[search={search}]", capture)
        held = found["valid"].values
        error = np.abs(found["spot"].values - truth).max(axis=-1)
        wrong[search] = float((error[held] > 1.0).sum() / held.size), float(held.mean())
    assert wrong["cell"][0] > 0.2, "most spots are read as those of the next lenslet"
    assert wrong["field"][0] == 0.0 and wrong["field"][1] > 0.97, wrong


def get_place(scene: Scene) -> np.ndarray:
    lattice = lattice_of(wavefront_rig(scene))
    return np.stack([lattice.col_px, lattice.row_px], axis=1)


def test_a_lost_spot_is_invalid_and_no_neighbour_takes_its_place() -> None:
    scene = scene_of()
    flux = np.full((1, 144), 3000.0)
    lost = np.array([7, 40, 77, 78, 90])
    flux[:, lost] = 0.0
    slope = defocused(scene, 0.1, (1.0, 0.0), seed=4)
    found = run_estimator("spot-ml[search=field]", hide_truth(written_capture(scene, flux, 2.0, slope, seed=5)))
    valid = found["valid"].values[0]
    assert not valid[lost].any() and np.delete(valid, lost).mean() > 0.97
    error = np.abs(found["spot"].values[0] - slope[0] / PER_PX - get_place(scene)).max(axis=-1)
    assert error[valid].max() < 0.5


@pytest.mark.parametrize("grid", ["square", "hexagonal"])
def test_lattices_of_any_kind_are_assigned(grid: str) -> None:
    """300 places, displaced by defocus, astigmatism and tilt up to 1.2 pitches; a twentieth of the spots lacks, five are false."""
    rng = np.random.default_rng(8)
    i, j = (v.ravel().astype(float) for v in np.mgrid[:18, :18])
    places = 20.0 * np.stack(
        [j + (0.5 * (i % 2) if grid == "hexagonal" else 0.0), i * (np.sqrt(0.75) if grid == "hexagonal" else 1.0)],
        axis=1,
    )
    centre = places - places.mean(axis=0)
    moved = centre @ np.array([[0.06, 0.02], [0.02, 0.1]]) + np.array([5.0, -3.0]) + rng.normal(0, 0.8, places.shape)
    there = np.sort(rng.permutation(len(places))[: int(0.95 * len(places))])
    spots = np.concatenate([(places + moved)[there], rng.uniform(-20, 400, (5, 2))])
    owner = assigned_spots(places, spots, 20.0)
    right = np.full(len(places), -1)
    right[there] = np.arange(len(there))
    held = owner >= 0
    assert (owner[held] == right[held]).mean() > 0.985 and held.sum() > 0.97 * len(there)


def test_noise_alone_has_hardly_any_spots() -> None:
    """10,000 pixels of noise, smoothed: 5 standard deviations are passed by one in millions."""
    light = np.random.default_rng(3).normal(100.0, 5.0, (100, 100))
    assert len(spots_in(light, 8.0, 1.0, 5.0)) <= 1
    assert len(spots_in(np.full((20, 20), np.nan), 8.0, 1.0, 5.0)) == 0
