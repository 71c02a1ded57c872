"""Profiles of a surface that is a power law, drawn from its spectrum, with noise and with rows lost as in a survey."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
import scipy.fft

from ...estimators.laser_line.profiles import Profile, selected

__all__ = ["Survey", "drawn_heights", "drawn_rows", "drawn_selection", "drawn_survey"]

Float = npt.NDArray[np.float64]

#: Heights drawn per row, and the length drawn over that of a frame: the lowest frequency is an eighth of a profile's.
_FINE, _LONG = 8, 8


@dataclass(frozen=True)
class Survey:
    """A survey by a laser line, one profile per frame.

    Main arguments:
        slope, level_m3: of S(f) = A f^−slope; the level is that at 10 cycles/m. noise_m: 1 σ of a height.
        rows: of a frame. row_m: their distance on the surface.
        kept: mean share of rows with a line. gap_rows: mean length of a run of lost rows; runs and gaps are geometric.
    Other arguments:
        usable: share of frames that the vehicle's lights leave usable.
        stated: the noise that the triangulation states, over the true one.
        spread: distance in which a row may lie from its place on, in eighths of the rows' distance: perspective and relief move
            them.
    """

    slope: float
    level_m3: float
    noise_m: float
    rows: int
    row_m: float
    kept: float
    gap_rows: float
    usable: float = 1.0
    stated: float = 1.0
    spread: int = 2


def drawn_heights(
    rng: np.random.Generator, count: int, step_m: float, slope: float, level_m3: float, *, profiles: int, period: int
) -> Float:
    """Heights (profiles, count) [m] at steps of `step_m`, Gaussian, of the one-sided density level (f/10)^−slope [m³] at the
    frequencies k/(period·step) up to the highest: a sum of waves of which a piece is kept, so that its ends do not meet."""
    f = scipy.fft.rfftfreq(period, step_m)
    density = np.zeros_like(f)
    density[1:] = level_m3 * (f[1:] / 10.0) ** -slope
    # Variance S df per wave, a half of it in each of its two parts, of which irfft adds both mirror images.
    scale = np.sqrt(density / (period * step_m) / 2.0) / np.sqrt(2.0)
    wave = rng.standard_normal((profiles, f.size)) + 1j * rng.standard_normal((profiles, f.size))
    return np.asarray(scipy.fft.irfft(wave * scale, period, axis=1, norm="forward")[:, :count])


def drawn_rows(rng: np.random.Generator, frames: int, rows: int, kept: float, gap_rows: float) -> npt.NDArray[np.bool_]:
    """Rows (frame, row) with a line: a chain of two states with the given share of kept rows and mean length of gaps."""
    leave = 1.0 / gap_rows
    fall = leave * (1.0 - kept) / kept
    state = np.empty((frames, rows), bool)
    state[:, 0] = rng.random(frames) < kept
    for row in range(1, rows):
        drawn = rng.random(frames)
        state[:, row] = np.where(state[:, row - 1], drawn >= fall, drawn < leave)
    return state


def drawn_survey(survey: Survey, frames: int, seed: int) -> list[Profile]:
    """The profiles of `frames` frames, each of its own place; those of frames with lights hold no point and are left out."""
    rng = np.random.default_rng(seed)
    fine = survey.row_m / _FINE
    count = survey.rows * _FINE
    usable = np.flatnonzero(rng.random(frames) < survey.usable)
    period = scipy.fft.next_fast_len(_LONG * count, real=True)
    heights = drawn_heights(rng, count, fine, survey.slope, survey.level_m3, profiles=usable.size, period=period)
    kept = drawn_rows(rng, usable.size, survey.rows, survey.kept, survey.gap_rows)
    place = _FINE * np.arange(survey.rows) + rng.integers(0, survey.spread + 1, (usable.size, survey.rows))
    made = []
    for own, there, at in zip(heights, kept, place, strict=True):
        if there.sum() > 1:
            height = own[at[there]] + survey.noise_m * rng.standard_normal(int(there.sum()))
            made.append(Profile(fine * at[there], height, np.full(height.size, survey.stated * survey.noise_m)))
    return made


def drawn_selection(survey: Survey, profiles: int, points: int, seed: int, *, most_gap: float = 5.0) -> list[Profile]:
    """`profiles` profiles of `points` points each that the selection of Kusters 1992 keeps, cut to their first points.

    Frames are drawn until there are enough. Raises ValueError where less than one frame in a hundred is kept.
    """
    made: list[Profile] = []
    for batch in range(100):
        drawn = selected(drawn_survey(survey, profiles, 1000 * seed + batch), points, most_gap)
        cut = [Profile(p.along[:points], p.height[:points], p.sigma[:points]) for p in drawn]
        made += selected(cut, points, most_gap)
        if len(made) >= profiles:
            return made[:profiles]
    raise ValueError(f"{len(made)} of {100 * profiles} frames are kept: gaps are too long, or rows too few")
