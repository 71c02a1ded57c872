"""The observed range error of Kusters 1992, chapter 4, on generated frames: all data sets, by whole pixels and centres of mass."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from ...captures.hide import hide_truth
from ...estimators import run_estimator
from ...optics.pixel_patch import predicted_error_m
from ...scenes.rigs.laser_line import laser_line_rig
from .tank_fit import Bins, binned, fit_sections, range_errors
from .tank_frames import Plane, section_capture
from .tank_sets import SETS, DataSet, Section, tank_scene

__all__ = ["BIN_M", "PROFILES", "READOUTS", "Observed", "observed", "predicted"]

Float = NDArray[np.float64]

#: Profiles of each data set, of 72 to 79; how far the unit sways between them [m]; width of a bin [m]. Ours.
PROFILES, _SWAY_M, BIN_M = 8, 0.002, 0.1
#: What the instrument reads, and its whole-pixel variant.
READOUTS = ("line-peak", "line-centroid")
#: First guesses of the target's distance from the wall err by this [m]: the thesis' were made by eye.
_BY_EYE_M = 0.01


@dataclass(frozen=True)
class Observed:
    """Errors of one readout: by the thesis' procedure, and against the true section; where each point is from."""

    bins: Bins
    true_bins: Bins
    sections: dict[int, Section]
    error_m: Float
    range_m: Float
    data_set: NDArray[np.int64]


def predicted(range_m: Float) -> Float:
    """Predicted greatest error [m] (Eq. 3.33 to 3.36) of the rig of "spotscan-tank"."""
    rig = laser_line_rig(tank_scene(SETS[1]))
    return predicted_error_m(
        range_m, pixel_m=rig.camera.pixel_pitch_m, focal_length_m=rig.camera.focal_length_m, index=_index(), baseline_m=0.15,
        angle_rad=float(np.deg2rad(10.0)),
    )  # fmt: skip


@lru_cache(maxsize=1)
def _index() -> float:
    from ...scenes.medium_index import phase_index

    scene = tank_scene(SETS[1])
    return phase_index(scene.medium, laser_line_rig(scene).wavelength_m)


@lru_cache(maxsize=5)
def _captured(number: int) -> tuple[xr.Dataset, Float, Plane, list[Section]]:
    """(hidden capture, true ranges (frame, row), plane, true sections) of a data set, the unit swaying between profiles."""
    data_set = SETS[number - 1]
    scene = tank_scene(data_set)
    plane = Plane.of(scene, data_set.view_deg)
    sway = _SWAY_M * np.random.default_rng(400 + number).standard_normal((PROFILES, 2))
    plain = data_set.section
    sections = [Section(plain.floor_m + a, plain.wall_m + b, plain.target_out_m + b, plain.radius_m) for a, b in sway]
    capture, range_m = section_capture(scene, plane, sections, seed=400 + number)
    return hide_truth(capture), range_m, plane, sections


def _profiles(data_set: DataSet, readout: str) -> list[tuple[Float, Float]]:
    """(down, out) [m] of the points of every profile."""
    capture, _, plane, _ = _captured(data_set.number)
    found = run_estimator(f"{readout}+triangulate-refractive", capture).isel({"return": 0})
    points, valid = np.moveaxis(found["point"].values, -1, 0), found["valid"].values
    down, out = plane.gravity(points)
    return [(d[ok], o[ok]) for d, o, ok in zip(down, out, valid, strict=True)]


@lru_cache(maxsize=4)
def observed(readout: str) -> Observed:
    """All data sets by one readout."""
    errors: list[tuple[Float, Float, Float, Float]] = []
    of: dict[int, Section] = {}
    for data_set in SETS:
        profiles = _profiles(data_set, readout)
        fitted = fit_sections(profiles, data_set.from_wall_m + _BY_EYE_M, 0.5 * data_set.diameter_m, predicted)
        for (down, out), model, true in zip(profiles, fitted, _captured(data_set.number)[3], strict=True):
            error, range_m = range_errors(down, out, model)
            true_error, _ = range_errors(down, out, true)
            errors.append((error, range_m, true_error, np.full(error.size, data_set.number)))
        floor, wall, target = np.mean([[s.floor_m, s.wall_m, s.target_out_m] for s in fitted], axis=0)
        of[data_set.number] = Section(float(floor), float(wall), float(target), fitted[0].radius_m)
    error, range_m, true_error, number = (np.concatenate(part) for part in zip(*errors, strict=True))
    return Observed(
        binned(error, range_m, BIN_M), binned(true_error, range_m, BIN_M), of, error, range_m, number.astype(np.int64)
    )  # fmt: skip
