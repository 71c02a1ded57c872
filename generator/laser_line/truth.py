"""The truth of a frame: where, in the middle of each row, the sheet's middle plane meets the surface."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.special import erf

from ...optics.sheet import meeting
from .light import Nodes
from .setting import Pose, Setting

__all__ = ["LineTruth", "line_truth"]

Float = NDArray[np.float64]

_MOST_STEPS = 60
#: A root is one where the surface is this near to the sheet's middle, as a share of its range: float32 hits err by 1e-7 of it.
_ON_SHEET = 2e-6
#: Half the step [px] over which slopes are taken on the tangent plane.
_STEP = 1e-3


@dataclass(frozen=True, eq=False)
class LineTruth:
    """All returns of a frame, that of the brightest pixel of each row first: `column` [px], `point` (…, xyz) [m], `amplitude`
    [photoelectrons of the row's whole line], `width` [px, 1 σ], each (rows, returns), NaN where there is none."""

    column: Float
    point: Float
    amplitude: Float
    width: Float


def line_truth(setting: Setting, pose: Pose, nodes: Nodes) -> LineTruth:
    """Every lit crossing of a row: by Newton's method on the tangent planes, between the nodes that show a change of side.

    A change of side at an edge, where the surface jumps past the sheet, is no crossing; nor is one in the laser's shadow.
    """
    rows = nodes.offset.shape[0]
    with np.errstate(invalid="ignore"):
        side = nodes.offset >= 0
        turned = side[:, :-1] != side[:, 1:]
    turned &= np.isfinite(nodes.offset[:, :-1]) & np.isfinite(nodes.offset[:, 1:])
    row, cell = np.nonzero(turned)
    at = row.astype(np.float64)
    col, good = _roots(setting, pose, at, nodes.col[cell], nodes.col[cell + 1], side[row, cell])
    row, at, col = row[good], at[good], col[good]
    seen = setting.see(at, col, pose)
    slope = np.abs(setting.offsets(at, col + _STEP, seen) - setting.offsets(at, col - _STEP, seen)) / (2.0 * _STEP)
    down = (setting.offsets(at + _STEP, col, seen) - setting.offsets(at - _STEP, col, seen)) / (2.0 * _STEP)
    bright = (seen.radiance > 0) & (slope > 0)
    row, at, col = row[bright], at[bright], col[bright]
    slope, down, light = slope[bright], down[bright], seen.radiance[bright]
    origin, direction = setting.camera.rays(at, col)
    point = meeting(origin, direction, setting.sheet.normal, setting.sheet.source)
    # A row is as high as a pixel is wide: within it a slanted line moves evenly, by down/slope columns.
    blur = np.hypot(setting.lens_px(col, point), down / slope / np.sqrt(12.0))
    width = np.hypot(setting.sheet.sigma(setting.sheet.range(point)) / slope, blur)
    return _sorted(rows, row, col, point, light / slope, width)


def _roots(
    setting: Setting, pose: Pose, row: Float, low: Float, high: Float, below: NDArray[np.bool_]
) -> tuple[Float, NDArray[np.bool_]]:
    """(columns where u = 0, whether they are on the surface) within low … high; `below`: the side of the lower end."""
    col = 0.5 * (low + high)
    good = np.zeros(col.shape, bool)
    for _ in range(_MOST_STEPS):
        seen = setting.see(row, col, pose, lit=False)
        u = np.where(seen.hit, setting.sheet.offset(seen.point), np.nan)
        good = np.abs(u) <= _ON_SHEET * setting.sheet.range(seen.point)
        ahead, behind = (setting.offsets(row, col + step, seen) for step in (_STEP, -_STEP))
        with np.errstate(divide="ignore", invalid="ignore"):
            new = col - u * 2.0 * _STEP / (ahead - behind)
            same = (u >= 0) == below
        low, high = np.where(same, np.maximum(col, low), low), np.where(same, high, np.minimum(col, high))
        new = np.where(np.isfinite(new) & (new >= low) & (new <= high), new, 0.5 * (low + high))
        still = np.abs(new - col)
        col = new
        if not np.any(still > 1e-10) or not np.any(high - low > 1e-10):
            break
    return col, good


def _sorted(rows: int, row: NDArray[np.intp], col: Float, point: Float, amplitude: Float, width: Float) -> LineTruth:
    # The brightest pixel, at the line's middle, is what finders see first: a wide line may hold more light in all.
    order = np.lexsort((-amplitude * erf(0.5 / (np.sqrt(2.0) * width)), row))
    row = row[order]
    first = np.searchsorted(row, row)
    number = np.arange(row.size) - first
    returns = int(number.max(initial=0)) + 1
    made = LineTruth(
        np.full((rows, returns), np.nan), np.full((rows, returns, 3), np.nan), np.full((rows, returns), np.nan),
        np.full((rows, returns), np.nan),
    )  # fmt: skip
    made.column[row, number] = col[order]
    made.point[row, number] = point[:, order].T
    made.amplitude[row, number] = amplitude[order]
    made.width[row, number] = width[order]
    return made
