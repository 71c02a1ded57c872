"""The clauses of a laser line: noise, the line's width, place, shape and evenness, precision of its columns."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np
import numpy.typing as npt
import xarray as xr

from ...estimators.registry import run_estimator
from ...scenes.errors import InputError
from ..bounds.laser_line import laser_line_bounds
from .clause import Curve, TwinKind
from .laser_line_clauses import CLAUSES
from .rendered import (
    Cells,
    Frame,
    Kit,
    check_length,
    measure_rendered,
    noise_bounds,
    photon_transfer,
    pixel_noise,
    pooled_bound,
)

__all__ = ["MAIN", "TWIN"]

Float = npt.NDArray[np.float64]

#: The estimator whose columns the clauses are about.
MAIN = "line-erf"
#: Half of a row's window, in standard deviations of the twin's line, and in pixels at least.
_WINDOW, _LEAST_PX = 5.0, 5
#: Fewest rows with a line.
_ROWS = 8


def _half(capture: xr.Dataset, number: int) -> xr.Dataset:
    """Every other frame with the laser, and every other one without."""
    lit = np.asarray(capture["laser_on"].values, bool)
    on, off = np.flatnonzero(lit), np.flatnonzero(~lit)
    check_length(on.size, "frame", "4 frames with the laser on, or more", least=4)
    keep = np.sort(np.concatenate([on[number : on.size // 2 * 2 : 2], off[number : off.size // 2 * 2 : 2]]))
    return capture.isel(frame=keep)


@dataclass(frozen=True, eq=False)
class _Lines:
    """Rows that hold one line in the twin: frames (frame, row, cell) about it, the background of each row taken off; `column`: the
    twin's (row); `place` (row, cell) of the cells, px; `rows`: which; `far` (frame, pixel): what lies far from the line, or without
    the laser."""

    lit: Float
    column: Float
    place: Float
    rows: npt.NDArray[np.int64]
    far: Float


def _columns(frame: Frame) -> tuple[Float, Float]:
    """(column, width) of the twin's first return, (row), NaN where it differs from frame to frame or is not alone."""
    half = frame.half.isel(frame=np.flatnonzero(np.asarray(frame.half["laser_on"].values, bool)))
    column, width = (np.asarray(half[f"truth_{name}"].values, np.float64) for name in ("column", "width"))
    alone = np.isfinite(column[:, :, 0]).all(axis=0) & ~np.isfinite(column[:, :, 1:]).any(axis=(0, 2))
    still = alone & (np.ptp(column[:, :, 0], axis=0) < 0.01)
    return np.where(still, column[0, :, 0], np.nan), width[0, :, 0]


def _lines(half: xr.Dataset, frame: Frame) -> _Lines:
    lit = np.asarray(half["laser_on"].values, bool) & np.asarray(half["valid"].values, bool)
    counts = np.asarray(half["counts"].values, np.float64)
    column, width = _columns(frame)
    reach = max(math.ceil(_WINDOW * float(np.nanmedian(width))), _LEAST_PX) if np.isfinite(width).any() else _LEAST_PX
    cols = counts.shape[2]
    with np.errstate(invalid="ignore"):
        rows = np.flatnonzero((column > reach + 1) & (column < cols - reach - 2))
    if rows.size < _ROWS or lit.sum() < 2:
        raise InputError(
            "The recording and its scene show too little of a line that stands still.", where="counts",
            value=f"{rows.size} rows with one line, {int(lit.sum())} sound frames with the laser on in a half",
            allowed=f"{_ROWS} rows and 2 frames, or more", next_step="record a rig at rest before one surface",
        )  # fmt: skip
    place: Float = np.rint(column[rows])[:, None] + np.arange(-reach, reach + 1, dtype=np.float64)
    cells = counts[:, rows[:, None], place.astype(int)]
    beside = np.abs(np.arange(cols) - np.where(np.isfinite(column), column, -1e9)[:, None]) > 2.0 * reach
    beside &= np.isfinite(column)[:, None]
    dark = np.flatnonzero(~np.asarray(half["laser_on"].values, bool) & np.asarray(half["valid"].values, bool))
    far = counts[dark].reshape(len(dark), -1) if dark.size > 1 else counts[lit][:, beside]
    level = np.array([np.median(counts[lit][:, row, beside[row]]) for row in rows])
    return _Lines(cells[lit] - level[:, None], column[rows], place, rows, far)


def _light(half: xr.Dataset, frame: Frame) -> float:
    return float(_lines(half, frame).lit.mean(axis=0).sum())


def _statistics(half: xr.Dataset, frame: Frame) -> tuple[dict[str, float], Cells]:
    lines = _lines(half, frame)
    mean = lines.lit.mean(axis=0)
    offset, rms = pixel_noise(lines.far)
    light = mean.sum(axis=1)
    centre = (mean * lines.place).sum(axis=1) / light
    square = (mean * (lines.place - centre[:, None]) ** 2).sum() / light.sum()
    even = light / _lines(frame.half, frame).lit.mean(axis=0).sum(axis=1)
    found = {
        "offset": offset, "read-noise": rms, "gain": photon_transfer(lines.lit, rms)[0],
        "width": math.sqrt(max(float(square), 0.0)), "evenness": float(even.std(ddof=1) / even.mean()),
        **_found(half, lines),
    }  # fmt: skip
    return found, Cells(mean, len(lines.lit))


def _found(half: xr.Dataset, lines: _Lines) -> dict[str, float]:
    """Place, shape and precision of the columns that `MAIN` finds."""
    lit = np.asarray(half["laser_on"].values, bool) & np.asarray(half["valid"].values, bool)
    answer = run_estimator(MAIN, half)
    valid = np.asarray(answer["valid"].values, bool)[lit][:, lines.rows, 0]
    column = np.where(valid, np.asarray(answer["column"].values, np.float64)[lit][:, lines.rows, 0], np.nan)
    always = np.isfinite(column).all(axis=0)
    column = column[:, always] - lines.column[always]
    if column.shape[1] < _ROWS:
        return dict.fromkeys(("place", "shape", "precision"), math.nan)
    rows = column.mean(axis=0)
    return {
        "place": float(rows.mean()), "shape": float(rows.std(ddof=1)),
        "precision": float(np.sqrt(column.var(axis=0, ddof=1).mean())),
    }  # fmt: skip


def _bounds(half: xr.Dataset, frame: Frame) -> dict[str, float]:
    lines = _lines(half, frame)
    bound = pooled_bound(laser_line_bounds(frame.half)["column"].sigma)
    offset, noise = noise_bounds(lines.far)
    return {
        "offset": offset, "read-noise": noise,
        "precision": bound, "place": bound / math.sqrt(lines.rows.size * len(lines.lit)),
    }  # fmt: skip


def _curve(real: Float, twin: Float, sigma: Float) -> Mapping[str, Curve]:
    middle: list[Any] = (np.arange(real.shape[1]) - real.shape[1] // 2).tolist()
    error = np.sqrt((sigma**2).sum(axis=0)) / len(sigma)
    return {
        "width": Curve(
            "Mean profile across the line", "pixels from the row's middle pixel", "mean above the background [DN]", middle,
            real.mean(axis=0).tolist(), error.tolist(), twin.mean(axis=0).tolist(),
        )
    }  # fmt: skip


_FEW = f"{MAIN} answers in too few rows"
KIT = Kit(
    main="counts",
    level="rig.laser.power_w",
    half=_half,
    light=_light,
    statistics=_statistics,
    bounds=_bounds,
    why_not={"place": _FEW, "shape": _FEW, "precision": _FEW, "residual": "residuals need four draws or more"},
    curve=_curve,
)

TWIN = TwinKind(CLAUSES, partial(measure_rendered, kit=KIT))
