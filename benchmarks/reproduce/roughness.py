"""Chapter 5 of Kusters 1992: surveys of seafloors that are drawn from known power laws, its selection, its spectra, its figures.

The document prints curves without numbers, and neither profiles nor constants of its taper: what can be judged is whether its
statements hold on surfaces whose spectrum is known.
"""

from __future__ import annotations

import math

import numpy as np

from ...estimators.laser_line.periodograms import document_spectra, split_gaussian
from ...estimators.laser_line.profiles import Profile, Resampled, resampled, selected
from ...estimators.laser_line.slopes import line_of_spectrum
from ...estimators.laser_line.spectrum import POINTS, fit_hann
from ..written.laser_line_profiles import Survey, drawn_selection, drawn_survey
from .rows import Row, Verdict, judge_band
from .spectra import GAP_ROWS, KEPT, PROFILES, reading, scaled, survey_of, tank_profiles

__all__ = ["ITEMS", "aliased_share", "leaked_share", "roughness_rows", "scatter_db", "survivors"]

_DOCUMENT = "001"
#: Items, as docs/coverage.csv names them.
ITEMS = (
    "Figure 5.7", "Figure 5.8", "Figure 5.9", "Figure 5.10", "Figure 5.11", "Figure 5.12", "Figure 5.13", "Figure 5.14",
    "Figure 5.15", "Figure 5.16", "Profile selection and resampling", "Detrend, taper and spectrum",
)  # fmt: skip
_NAN = math.nan
#: A slope is read well within this, and a spectrum is a straight line within this scatter [dB].
_SLOPE, _STRAIGHT_DB = 0.1, 2.0
_FRAMES, _USABLE = 600, 0.5
#: The mean points of an uncorrupted profile, down and forward, over 256 rows.
_DOWN, _FORWARD = 200 / 256, 155 / 256
_OURS = "surface, noise and gaps are ours"
_TAPER = split_gaussian(POINTS, 0.25, 2.5)


def roughness_rows() -> list[Row]:
    """The rows of chapter 5, in the order of `ITEMS`. Deterministic."""
    return [*_profile_rows(), *_sensor_rows(), *_resampling_rows(), *_spectrum_rows(), *_procedure_rows()]


def survivors(kept: float, gap_rows: float, seed: int = 1) -> tuple[int, float]:
    """(profiles of 600 frames that are selected, mean points of those without lights) of a survey with half its frames lit."""
    drawn = drawn_survey(_survey(kept, gap_rows), _FRAMES, seed)
    return len(selected(drawn, POINTS, 5.0)), float(np.mean([profile.along.size for profile in drawn]))


def _survey(kept: float, gap_rows: float) -> Survey:
    plain = survey_of(2.5)
    return Survey(2.5, plain.level_m3, plain.noise_m, 256, plain.row_m, kept, gap_rows, _USABLE)


def _row(
    item: str, quantity: str, unit: str, value: float, verdict: Verdict, note: str, free: str = _OURS, published: float = _NAN,
    tolerance: float = _NAN,
) -> Row:  # fmt: skip
    return Row(item, quantity, unit, published, value, tolerance, verdict, note, free, _DOCUMENT)


def _judged(holds: bool) -> Verdict:
    return "trend" if holds else "contradicted"


def _profile_rows() -> list[Row]:
    free = f"rows kept 200 or 155 of 256, which the text gives as means, and mean gap {GAP_ROWS:g} rows"
    note = "the mean is put in, and 95 of 100 profiles lie within 22 points of it: no power"
    rows = []
    for item, kept, name, printed in ((ITEMS[0], _DOWN, "bottom", 210.0), (ITEMS[1], _FORWARD, "forward", 157.0)):
        counts = [profile.along.size for profile in drawn_survey(_survey(kept, GAP_ROWS), _FRAMES, 1)]
        low, middle, high = (float(value) for value in np.quantile(counts, (0.025, 0.5, 0.975)))
        verdict = judge_band(printed, low, high, 5.0)
        rows.append(_row(item, f"points of a {name} profile", "1", middle, verdict, note, free, printed, 5.0))
    return rows


def _sensor_rows() -> list[Row]:
    """Two sonars and the laser on one law S = A f^−2.5: what each reads in its band, and what noise adds to the coarsest."""
    slope, level = 2.5, 1e-7
    apart = []
    for spacing in (0.25, 0.05, survey_of(slope).row_m / KEPT):
        top = 10.0 / (POINTS * spacing)
        noise = math.sqrt(level * (top / 10.0) ** -slope / 100.0 / (2.0 * spacing))
        survey = Survey(slope, level, noise, POINTS, spacing, 1.0, 1.0, spread=0)
        apart.append(_off_law_db(drawn_selection(survey, PROFILES, POINTS, 9), survey))
    worst = max(abs(one) for one in apart)
    coarse = Survey(slope, level, 0.03, POINTS, 0.5, 1.0, 1.0, spread=0)
    spectra = document_spectra(resampled(drawn_selection(coarse, PROFILES, POINTS, 9), POINTS), _TAPER)
    # The document's density is two-sided, and less what the taper takes.
    law = 0.5 * np.mean(_TAPER**2) * level * (spectra.frequency / 10.0) ** -slope
    over = spectra.power.mean(axis=0) / law
    return [
        _row(ITEMS[2], "density of two sonars and the laser in their bands against one law, the worst", "dB", worst,
             _judged(worst < 1.0), "spectra of several instruments lie on one line, each where it resolves",
             _OURS + ", spacing of the sonars .25 and .05 m"),
        _row(ITEMS[2], "density of the coarsest sonar over the law, at its highest frequencies", "1", float(over[-8:].mean()),
             _judged(over[-8:].mean() > 3.0 and over[1:5].mean() < 1.5),
             "white noise at the limit of resolution flattens the curve, as stated", _OURS),
    ]  # fmt: skip


def _off_law_db(profiles: list[Profile], survey: Survey) -> float:
    """Density that Hann's fit gives over that of the law, at ten times the lowest frequency of the profiles."""
    place = fit_hann(profiles).place
    at = math.log(1.0 / (POINTS * min(profile.interval_m for profile in profiles)))
    off = place[1] - math.log(survey.level_m3) - (place[0] - survey.slope) * at
    return float(10.0 / math.log(10.0) * off)


def _resampling_rows() -> list[Row]:
    """Interpolated heights against those of all rows, relative to the relief; the close-range profile's interval."""
    rows = []
    for item, kept, name in ((ITEMS[3], _DOWN, "bottom"), (ITEMS[4], _FORWARD, "forward")):
        share = _interpolation_error(kept)
        rows.append(
            _row(
                item, f"error of a resampled {name} profile, rms over that of the relief", "1", share, _judged(share < 0.1),
                "heights: a minimal effect, as stated; their spectrum is another matter, see the procedure",
            )
        )  # fmt: skip
    near, far = (resampled(drawn_selection(one, 10, POINTS, 4), POINTS).interval_m for one in _pair(0.3))
    ratio = near / far
    rows.append(
        _row(
            ITEMS[5], "interval of a profile from .3 of the distance over that from the whole", "1", ratio,
            _judged(abs(ratio / 0.3 - 1.0) < 0.05), "the interval follows the distance, and so do the frequencies",
        )
    )  # fmt: skip
    return rows


def _pair(by: float) -> tuple[Survey, Survey]:
    survey = survey_of(2.5)
    return scaled(survey, by), survey


def _interpolation_error(kept: float) -> float:
    """rms of (resampled from the rows left − resampled from all rows) over rms relief; no noise, equal surfaces."""
    plain = survey_of(2.5, noise=False)
    whole = Survey(2.5, plain.level_m3, plain.noise_m, 256, plain.row_m, 0.9999999, GAP_ROWS, spread=0)
    holed = Survey(2.5, plain.level_m3, plain.noise_m, 256, plain.row_m, kept, GAP_ROWS, spread=0)
    errors, reliefs = [], []
    for all_rows, left in zip(drawn_survey(whole, 60, 3), drawn_survey(holed, 60, 3), strict=True):
        at = left.along[0] + left.interval_m * np.arange(POINTS)
        true, read = (np.interp(at, one.along, one.height) for one in (all_rows, left))
        errors.append(np.mean((read - true) ** 2))
        reliefs.append(np.var(true))
    return math.sqrt(np.mean(errors) / np.mean(reliefs))


def scatter_db(profiles: list[Profile]) -> float:
    """rms of the document's averaged spectrum about its straight line, dB."""
    spectra = document_spectra(resampled(profiles, POINTS), _TAPER)
    place = line_of_spectrum(spectra, 2).place
    at = np.log(spectra.frequency[2:] / 10.0)
    left = np.log(spectra.power.mean(axis=0)[2:]) - (place[1] - place[0] * at)
    return float(10.0 / math.log(10.0) * np.sqrt(np.mean(left**2)))


def _spectrum_rows() -> list[Row]:
    near, far = (drawn_selection(one, PROFILES, POINTS, 6) for one in _pair(0.3))
    other = drawn_selection(scaled(survey_of(2.5, noise=False), 0.8), PROFILES, POINTS, 8)
    plain = drawn_selection(survey_of(2.5, noise=False), PROFILES, POINTS, 7)
    straight = scatter_db(plain)
    tops = [0.5 / resampled(held, POINTS).interval_m for held in (plain, other, far, near)]
    law = survey_of(2.5)
    apart = max(abs(_off_law_db(held, law)) for held in (plain, other, far, near))
    tank = scatter_db(tank_profiles(PROFILES, noise_m=1e-4))
    return [
        _row(ITEMS[6], "scatter of a bottom's averaged spectrum about a straight line", "dB", straight,
             _judged(straight < _STRAIGHT_DB), "a surface that is a power law gives a straight line, though of another slope"),
        _row(ITEMS[6], "highest frequency with the shorter interval over that with the other", "1", tops[1] / tops[0],
             _judged(tops[1] > 1.1 * tops[0]), "a shorter interval leads to higher frequencies, as stated"),
        _row(ITEMS[7], "highest frequency at close range over that from the usual distance", "1", tops[3] / tops[2],
             _judged(tops[3] > 2.0 * tops[2]), "as stated for the data set of extremely close range"),
        _row(ITEMS[8], "density of four data sets in their bands against one law, the worst", "dB", apart,
             _judged(apart < 1.0), "data sets of one seafloor join, whatever their intervals"),
        _row(ITEMS[9], "scatter of the tank's averaged spectrum over that of the bottom's", "1", tank / straight,
             _judged(tank > 3.0 * straight), "a round wall and a cylinder have lobes and no power law, as stated",
             "radius 2.2 m, cylinder 25 mm, noise .1 mm"),
    ]  # fmt: skip


def leaked_share() -> float:
    """Power of a steep surface (slope 3.5) above half of the highest frequency, with the taper over without, same mean power."""
    even = resampled(drawn_selection(survey_of(3.5, gaps=False, noise=False), PROFILES, POINTS, 5), POINTS)
    shares = []
    for taper in (_TAPER, np.ones(POINTS)):
        power = document_spectra(even, taper).power.mean(axis=0) / np.mean(taper**2)
        shares.append(power[POINTS // 4 :].sum())
    return float(shares[0] / shares[1])


def aliased_share() -> float:
    """Power that a wave of .8 of the sampling rate puts at .2 of it, with the taper over without, same mean power."""
    wave = np.sin(2.0 * np.pi * 0.8 * np.arange(POINTS) + 0.3)
    even = Resampled(wave[None], 1.0, 1.0)
    sums = []
    for taper in (_TAPER, np.ones(POINTS)):
        spectra = document_spectra(even, taper)
        near = np.abs(spectra.frequency - 0.2) < 0.05
        sums.append(spectra.power[0, near].sum() / np.mean(taper**2))
    return float(sums[0] / sums[1])


def _procedure_rows() -> list[Row]:
    count = survivors(_DOWN, GAP_ROWS)[0]
    counts = [survivors(_DOWN, gap)[0] for gap in (1.5, 2.0, 3.0, 4.0)]
    even = reading("hann", 2.5, "equal intervals, no noise", 4)[0]
    gaps = reading("hann", 2.5, "gaps, no noise", 4)[0]
    leak, alias = leaked_share(), aliased_share()
    rows = [
        _row(ITEMS[10], "profiles selected of 600", "1", float(count),
             judge_band(50.0, min(counts), max(counts), 25.0),
             f"from {min(counts)} to {max(counts)} for mean gaps of 4 to 1.5 rows: sensitive to the gaps, as the text says of its "
             "criteria", f"mean gap {GAP_ROWS:g} rows, half of the frames lit", 50.0, 25.0),
        _row(ITEMS[10], "slope read from equal intervals, resampled, minus the true 2.5", "1", even, _judged(abs(even) <= _SLOPE),
             "the interval is the length over the number of points, one too many: even equal intervals are interpolated, and fine "
             "relief is lost"),
        _row(ITEMS[10], "slope read from gaps as surveyed, resampled, minus the true 2.5", "1", gaps, _judged(abs(gaps) <= _SLOPE),
             "stated as a minimal effect on the representation; linear interpolation takes from the high frequencies"),
        _row(ITEMS[11], "power above half of the highest frequency, slope 3.5, tapered over not", "1", leak, _judged(leak < 0.5),
             "the taper takes leakage away"),
        _row(ITEMS[11], "aliased power of a wave above the highest frequency, tapered over not", "1", alias, _judged(alias < 0.5),
             "the text tapers to reduce aliasing, which no taper can: it reduces leakage"),
    ]  # fmt: skip
    for slope in (2.0, 3.5):
        error = reading("kusters", slope, "gaps and noise", 4)[0]
        rows.append(
            _row(ITEMS[11], f"slope read by the document's procedure, gaps and noise, minus the true {slope:g}", "1", error,
                 _judged(abs(error) <= _SLOPE), "a straight line through all of the spectrum: noise flattens it, interpolation "
                 "steepens it", _OURS + ", the taper's share .25 and width 2.5 sigma, the line")
        )  # fmt: skip
    return rows
