"""Statistics of a recorded or drawn delay scan, all read with the twin's rig: one function for both, so that they are
compared alike."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
import numpy.typing as npt
import xarray as xr

from ...estimators.calibration.gated_noise import dark_statistics, noise_statistics
from ...estimators.calibration.gated_scan import DelayScan
from ...estimators.calibration.gated_widths import ResponseFit, fit_response
from ...estimators.registry import run_estimator
from ...scenes.errors import InputError

__all__ = ["MAIN", "Frame", "Ranges", "estimated", "range_statistics", "signal_statistics"]

Float = npt.NDArray[np.float64]
Mask = npt.NDArray[np.bool_]

#: The estimator whose precision and trueness the clauses are about.
MAIN = "poisson-ml"
#: Share of the gap between two surfaces, from either, within which an estimate counts as one of them.
_NEAR = 0.25


@dataclass(frozen=True, eq=False)
class Frame:
    """What the twin's scene says of the judged half.

    Main arguments:
        expected_dn: light of the twin without noise, (delay, pixel). slope, floor: its variance per DN of light, and without
        light, DN².
        known_s: times of the echoes (pixel), None where every half's own are fitted. before: delays at which no echo is,
            only what water scatters. dn_per_e: counts per photoelectron. map: whether amplitudes were fitted to the
            recording.
        single, lit: pixels that one echo explains, and pixels with light, in the first half of the recording.
        range_m: known ranges (pixel), None if unknown. mixed: pixels that see two surfaces. first_m, last_m: their ranges.
    """

    expected_dn: Float
    slope: float
    floor: float
    known_s: Float | None
    before: npt.NDArray[np.bool_]
    dn_per_e: float
    map: bool
    single: Mask
    lit: Mask
    range_m: Float | None = None
    mixed: Mask | None = None
    first_m: Float | None = None
    last_m: Float | None = None

    @property
    def judged(self) -> Mask:
        """Pixels in which residuals and ranges are compared: a fitted map has one echo in each pixel, a scene has its edges."""
        return self.single if self.map else np.ones(self.single.size, bool)

    @property
    def coverage(self) -> dict[str, float]:
        """Clause -> share of the pixels with light in which it is judged, for those that are not judged in all."""
        ranges = self.judged if self.mixed is None else self.judged & ~self.mixed
        masks = dict.fromkeys(("pulse", "gate", "response", "t0"), self.single)
        masks |= dict.fromkeys(("residual", "residual-spread", "ranking"), self.judged)
        masks |= dict.fromkeys(("precision", "trueness"), ranges)
        lit = max(int(self.lit.sum()), 1)
        return {name: float((mask & self.lit).sum()) / lit for name, mask in masks.items()}


def signal_statistics(scan: DelayScan, frame: Frame) -> tuple[dict[str, float], ResponseFit]:
    """Statistics of counts: photon transfer, dark frames, response, time zero, what is scattered, residuals."""
    noise, dark = noise_statistics(scan, errors=False), dark_statistics(scan, errors=False)
    fit = fit_response(scan, known_s=frame.known_s, single=frame.single, noise=noise, dark=dark)
    found = {
        "gain": noise["slope"].value, "excess": noise["skewness"].value, "fluctuation": noise["fluctuation"].value,
        "offset": dark["level"].value, "read-noise": dark["noise"].value, "dsnu": dark["pattern"].value,
        "pulse": fit.pulse.value, "gate": fit.gate.value, "response": fit.response.value, "t0": fit.shift_s.value,
    }  # fmt: skip
    light = scan.counts.mean(axis=1) - scan.dark.astype(np.float64).mean(axis=0)
    found["backscatter"] = float(light[frame.before].mean()) / frame.dn_per_e if frame.before.any() else math.nan
    return found | _residuals(light, scan.repeats, len(scan.dark), frame), fit


def _residuals(light: Float, repeats: int, dark: int, frame: Frame) -> dict[str, float]:
    """χ² of every judged pixel against the twin's expectation, whose amplitude is fitted in each pixel; and the pattern of these
    amplitudes.

    The mean of the dark frames, which is subtracted from all delays of a pixel, is part of their errors: it is eliminated
    too, as a constant with the prior of its noise.
    """
    model = frame.expected_dn
    variance = (frame.floor + frame.slope * np.maximum(model, 0.0)) / repeats
    weight = 1.0 / variance
    prior = dark / frame.floor
    a, b, c = (weight * model**2).sum(axis=0), (weight * model).sum(axis=0), weight.sum(axis=0) + prior
    p, q = (weight * model * light).sum(axis=0), (weight * light).sum(axis=0)
    determinant = a * c - b**2
    seen = frame.judged & (a > 100.0)  # ten standard errors of light
    if not seen.any():
        return {"residual": math.nan, "residual-spread": math.nan, "prnu": math.nan}
    with np.errstate(divide="ignore", invalid="ignore"):
        amplitude, still = (c * p - b * q) / determinant, (a * q - b * p) / determinant
        chi2 = (weight * (light - amplitude * model - still) ** 2).sum(axis=0) + prior * still**2
        error = c / determinant
    reduced = chi2[seen] / (len(model) - 1)
    pattern = float(amplitude[seen].var(ddof=1) - error[seen].mean()) / float(amplitude[seen].mean()) ** 2
    return {
        "residual": float(reduced.mean()), "residual-spread": float(np.quantile(reduced, 0.95)),
        "prnu": math.nan if frame.map else math.copysign(math.sqrt(abs(pattern)), pattern),
    }  # fmt: skip


@dataclass(frozen=True, eq=False)
class Ranges:
    """Answers of estimators to single repeats: label -> (repeat, pixel), NaN where there is none; `two` (repeat, pixel):
    whether two surfaces were found; `failed`: label -> why it gave no answer at all."""

    range_m: Mapping[str, Float]
    two: npt.NDArray[np.bool_] | None
    failed: Mapping[str, str] = field(default_factory=dict)


def estimated(scan: DelayScan, labels: tuple[str, ...], most: int, *, two: bool) -> Ranges:
    """Run estimators on up to `most` repeats, each as a stack of its own with its share of the dark frames."""
    repeats = min(most, scan.repeats, len(scan.dark))
    found: dict[str, list[Float]] = {label: [] for label in labels}
    failed: dict[str, str] = {}
    apart = []
    for number in range(repeats):
        stack = _stack(scan, number, repeats)
        for label in labels:
            if label in failed:
                continue
            try:
                answer = run_estimator(label, stack)
            except InputError as error:
                failed[label] = str(error).splitlines()[0]
                continue
            value = np.where(answer["valid"].values, answer["range"].values, np.nan)
            found[label].append(value.ravel())
        if two:
            ends = [run_estimator(f"poisson-ml-two-returns[pick={pick}]", stack) for pick in ("first", "last")]
            both = ends[0]["valid"].values & ends[1]["valid"].values
            apart.append((both & (np.abs(ends[1]["range"].values - ends[0]["range"].values) > 0)).ravel())
    held = {label: np.stack(values) for label, values in found.items() if label not in failed}
    return Ranges(held, np.stack(apart) if apart else None, failed)


def _stack(scan: DelayScan, number: int, repeats: int) -> xr.Dataset:
    """One repeat of a scan as a capture without truth."""
    dark = scan.dark[number::repeats]
    counts = np.concatenate([scan.counts[:, number], dark]).reshape(-1, *scan.shape)
    slices, lit = len(counts), len(scan.delay_s)
    on = np.arange(slices) < lit
    delay = np.concatenate([scan.delay_s, np.full(slices - lit, scan.delay_s[0])])
    coords = {
        "delay": ("slice", delay), "gate": ("slice", np.zeros(slices, np.int32)), "laser_on": ("slice", on),
        "valid": ("slice", np.ones(slices, bool)), "time": ("slice", np.arange(slices, dtype=np.float64)),
    }  # fmt: skip
    attrs = {"modality": "gated", "rig": scan.rig.text, "truth_kind": "none", "schema_version": 1}
    return xr.Dataset({"counts": (("slice", "row", "col"), counts)}, coords, attrs)


def range_statistics(ranges: Ranges, frame: Frame) -> dict[str, float]:
    """Precision and trueness of `MAIN`, and what happens at edges between two surfaces."""
    found = {"precision": math.nan, "trueness": math.nan, "flying": math.nan, "separability": math.nan}
    if MAIN not in ranges.range_m:
        return found
    values = ranges.range_m[MAIN]
    plain = frame.judged if frame.mixed is None else frame.judged & ~frame.mixed
    sure = plain & np.isfinite(values).all(axis=0)
    if sure.sum() > 1 and len(values) > 1:
        found["precision"] = float(np.sqrt(values[:, sure].var(axis=0, ddof=1).mean()))
        if frame.range_m is not None:
            error = values[:, sure].mean(axis=0) - frame.range_m[sure]
            found["trueness"] = float(error[np.isfinite(error)].mean())
    if frame.mixed is not None and frame.first_m is not None and frame.last_m is not None and frame.mixed.any():
        first, gap = frame.first_m[frame.mixed], (frame.last_m - frame.first_m)[frame.mixed]
        place = (values[:, frame.mixed] - first) / gap
        answered = np.isfinite(place)
        if answered.any():
            found["flying"] = float(((place > _NEAR) & (place < 1.0 - _NEAR))[answered].mean())
        if ranges.two is not None:
            found["separability"] = float(ranges.two[:, frame.mixed].mean())
    return found
