"""The clauses of a pulsed ranger: noise, the echo's width and time, precision and trueness of its ranges."""

from __future__ import annotations

import math
from collections.abc import Mapping
from functools import partial
from typing import Any

import numpy as np
import numpy.typing as npt
import xarray as xr

from ...estimators.registry import run_estimator
from ...scenes.errors import InputError
from ..bounds.waveform import waveform_bound
from .clause import Curve, TwinKind
from .rendered import (
    Cells,
    Frame,
    Kit,
    every_other,
    measure_rendered,
    noise_bounds,
    photon_transfer,
    pixel_noise,
    pooled_bound,
)
from .waveform_clauses import CLAUSES

__all__ = ["MAIN", "TWIN"]

Float = npt.NDArray[np.float64]

#: The estimator whose precision and trueness the clauses are about.
MAIN = "waveform-ml"
#: Half the echo's window, and the distance of what lies before it, in widths at half maximum of the twin's echo.
_WINDOW, _BEFORE = 2.0, 3.0
#: Fewest samples before the echo that noise is read from.
_LEAST = 8


def _half(capture: xr.Dataset, number: int) -> xr.Dataset:
    """Every other shot, so that both halves span the same time."""
    return every_other(capture, "shot", number, least=6)


def _records(half: xr.Dataset) -> Float:
    """Records (shot, sample) of sound shots with the laser on."""
    used = np.asarray(half["valid"].values, bool) & np.asarray(half["laser_on"].values, bool)
    if used.sum() < 3:
        raise InputError(
            "So few sound shots do not give the noise of the rig.", where="valid", value=int(used.sum()),
            allowed="3 or more with the laser on, in each half",
        )  # fmt: skip
    return np.asarray(half["signal"].values[used], np.float64)


def _places(frame: Frame) -> tuple[npt.NDArray[np.bool_], npt.NDArray[np.bool_]]:
    """(samples of the echo, samples before it), by the mean record of the twin."""
    record = _records(frame.half).mean(axis=0)
    record = record - np.median(record)
    width, _ = _width(record, 1.0)
    index = np.arange(record.size)
    peak = int(record.argmax())
    width = max(width, 2.0) if math.isfinite(width) else 8.0
    return np.abs(index - peak) <= max(_WINDOW * width, 4.0), index < peak - _BEFORE * width


def _width(record: Float, step: float) -> tuple[float, float]:
    """(width at half of the maximum, its middle) of a record without background, linear between samples; NaN where the flanks are
    cut off."""
    peak = int(record.argmax())
    half = 0.5 * float(record[max(peak - 1, 0) : peak + 2].mean())
    below = record < half
    left, right = np.flatnonzero(below[:peak]), np.flatnonzero(below[peak:])
    if not left.size or not right.size:
        return math.nan, math.nan
    i, j = int(left[-1]), peak + int(right[0])
    start = i + (half - record[i]) / (record[i + 1] - record[i])
    end = j - (half - record[j]) / (record[j - 1] - record[j])
    return float(end - start) * step, 0.5 * float(end + start) * step


def _light(half: xr.Dataset, frame: Frame) -> float:
    records = _records(half)
    echo, before = _places(frame)
    level = records[:, before].mean() if before.sum() >= _LEAST else float(np.median(records))
    return float((records.mean(axis=0) - level)[echo].sum())


def _statistics(half: xr.Dataset, frame: Frame) -> tuple[dict[str, float], Cells]:
    records = _records(half)
    echo, before = _places(frame)
    seen = before.sum() >= _LEAST
    offset, rms = pixel_noise(records[:, before]) if seen else (math.nan, math.nan)
    level = offset if seen else float(np.median(records))
    light = records[:, echo] - level
    mean = light.mean(axis=0)
    gain, energy = photon_transfer(light, rms)
    step = float(np.diff(np.asarray(half["time"].values, np.float64)).mean())
    width, middle = _width(mean, step)
    noise = rms**2 * mean.size / float(mean.sum()) ** 2
    square = float(energy.var(ddof=1)) - noise
    found = {
        "offset": offset, "noise": rms, "gain": gain,
        "fluctuation": math.copysign(math.sqrt(abs(square)), square), "pulse": width, "t0": middle,
        **_ranges(half, frame),
    }  # fmt: skip
    whole = records.mean(axis=0) - level
    return found, Cells(whole[None, echo], len(records))


def _ranges(half: xr.Dataset, frame: Frame) -> dict[str, float]:
    """Precision and trueness of `MAIN` against the scene's ranges."""
    try:
        answer = run_estimator(MAIN, half)
    except InputError:
        return {"precision": math.nan, "trueness": math.nan}
    truth = np.asarray(frame.half["truth_range"].values, np.float64)
    error = np.where(answer["valid"].values, answer["range"].values, np.nan) - truth
    error = error[np.isfinite(error)]
    if error.size < 3:
        return {"precision": math.nan, "trueness": math.nan}
    return {"precision": float(error.std(ddof=1)), "trueness": float(error.mean())}


def _bounds(half: xr.Dataset, frame: Frame) -> dict[str, float]:
    records = _records(half)
    before = _places(frame)[1]
    offset, noise = noise_bounds(records[:, before]) if before.sum() >= _LEAST else (math.nan, math.nan)
    bound = pooled_bound(waveform_bound(frame.half).sigma)
    return {
        "offset": offset, "noise": noise, "precision": bound, "trueness": bound / math.sqrt(len(records)),
    }  # fmt: skip


def _curve(real: Float, twin: Float, sigma: Float) -> Mapping[str, Curve]:
    index: list[Any] = list(range(real.shape[1]))
    return {
        "pulse": Curve(
            "The mean echo", "sample of the window", "mean above the background [DN]", index, real[0].tolist(),
            sigma[0].tolist(), twin[0].tolist(),
        )
    }  # fmt: skip


_NO_BEFORE = "no samples lie before the echo: begin the record earlier"
KIT = Kit(
    main="signal",
    level="rig.laser.pulse_energy_j",
    half=_half,
    light=_light,
    statistics=_statistics,
    bounds=_bounds,
    why_not={
        "offset": _NO_BEFORE, "noise": _NO_BEFORE, "gain": _NO_BEFORE, "fluctuation": _NO_BEFORE,
        "pulse": "the record ends within the echo", "t0": "the record ends within the echo",
        "precision": f"{MAIN} answers in too few shots", "trueness": f"{MAIN} answers in too few shots",
        "residual": "residuals need four draws or more", "residual-spread": "one record is one group",
    },
    curve=_curve,
)  # fmt: skip

TWIN = TwinKind(CLAUSES, partial(measure_rendered, kit=KIT))
