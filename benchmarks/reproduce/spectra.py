"""Surveys of chapter 5 of Kusters 1992, drawn from power laws that are known, and what methods read from them."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import numpy.typing as npt

from ...estimators.laser_line.likelihoods import Fit
from ...estimators.laser_line.profiles import Profile, levelled
from ...estimators.laser_line.spectrum import (
    POINTS,
    fit_hann,
    fit_kusters,
    fit_lomb_scargle,
    fit_multitaper,
    fit_reml,
)
from ..written.laser_line_profiles import Survey, drawn_selection

__all__ = [
    "CONDITIONS", "GAP_ROWS", "KEPT", "METHODS", "PROFILES", "SLOPES", "Reading", "reading", "scaled", "survey_of", "tank_profiles",
]  # fmt: skip

Float = npt.NDArray[np.float64]

#: (mean error, standard deviation, mean stated error, rms of error over stated error) of a slope.
Reading = tuple[float, float, float, float]

SLOPES = (2.0, 2.5, 3.0, 3.5)
PROFILES = 50
METHODS: dict[str, Callable[[list[Profile]], Fit]] = {
    "kusters": fit_kusters, "hann": fit_hann, "multitaper": fit_multitaper, "lomb-scargle": fit_lomb_scargle, "reml": fit_reml,
}  # fmt: skip
#: Share of rows kept and mean length of gaps in rows: 200 of 256 points, and about 50 of 600 frames selected.
KEPT, GAP_ROWS = 200 / 256, 2.6
#: (whether the survey has gaps, whether noise).
CONDITIONS = {
    "equal intervals, no noise": (False, False),
    "gaps, no noise": (True, False),
    "gaps and noise": (True, True),
}

#: Density at 10 cycles/m: relief of some millimetres within a profile. Distance of rows at 2 m.
_LEVEL_M3, _ROW_M = 1e-7, 0.0035
#: Relief over noise, in power, a decade above the lowest frequency of a profile.
_RELIEF = 10.0


def survey_of(slope: float, *, gaps: bool = True, noise: bool = True) -> Survey:
    """A survey of `slope`. With noise, S(10/L) is ten times the noise's density, L the length of 128 points."""
    kept = KEPT if gaps else 1.0
    rows = int(np.ceil(1.35 * POINTS / kept)) if gaps else POINTS
    interval = _ROW_M / kept
    top = 10.0 / (POINTS * interval)
    density = _LEVEL_M3 * (top / 10.0) ** -slope / _RELIEF
    sigma = float(np.sqrt(density / (2.0 * interval)))
    return Survey(
        slope, _LEVEL_M3, sigma if noise else 1e-3 * sigma, rows, _ROW_M, kept, GAP_ROWS, spread=2 if gaps else 0
    )


def reading(method: str, slope: float, condition: str, surveys: int, seed: int = 1) -> Reading:
    """What a method reads from `surveys` surveys of 50 profiles of 128 points."""
    gaps, noise = CONDITIONS[condition]
    made = survey_of(slope, gaps=gaps, noise=noise)
    error, stated = np.empty(surveys), np.empty(surveys)
    for number in range(surveys):
        profiles = drawn_selection(made, PROFILES, POINTS, seed + number)
        if method != "kusters":
            profiles = [levelled(profile) for profile in profiles]
        fit = METHODS[method](profiles)
        error[number], stated[number] = fit.place[0] - slope, np.sqrt(fit.covariance[0, 0])
    spread = float(error.std(ddof=1)) if surveys > 1 else float("nan")
    return float(error.mean()), spread, float(stated.mean()), float(np.sqrt(((error / stated) ** 2).mean()))


def tank_profiles(count: int, *, noise_m: float, radius_m: float = 2.2, seed: int = 1) -> list[Profile]:
    """Profiles of the test tank: its round wall, and the 25 mm cylinder before it, at slightly different places each."""
    rng = np.random.default_rng(seed)
    along = _ROW_M * np.arange(-100, 100)
    made = []
    for _ in range(count):
        middle = 0.05 * rng.standard_normal()
        height = radius_m - np.sqrt(radius_m**2 - (along - middle) ** 2)
        beside = (along - middle - 0.1) / 0.0125
        height = np.where(np.abs(beside) < 1, 0.02 + 0.0125 * np.sqrt(np.clip(1 - beside**2, 0, 1)), height)
        made.append(
            Profile(
                np.asarray(along, np.float64),
                height + noise_m * rng.standard_normal(along.size),
                np.full(along.size, noise_m),
            )
        )
    return made


def scaled(survey: Survey, by: float) -> Survey:
    """The same surface from `by` times the distance: rows lie as much farther apart, errors of range grow with its square."""
    return replace(survey, row_m=by * survey.row_m, noise_m=by**2 * survey.noise_m)
