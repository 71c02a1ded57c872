"""Where the rays of pixels meet the sheet, compiled: `Geometry.points` of a camera in the medium or behind a flat window.

Pixel -> slope without Brown's distortion (Newton's method) -> Snell's law at the window's two faces -> plane. A point is 60 to
200 ns, where the same in whole arrays is bound by memory; the derivative by the column is a difference over ±1e-3 px.
"""

from __future__ import annotations

import math

import numpy as np
import numpy.typing as npt

from ...optics.jit import kernel
from ...optics.pinhole import Pinhole
from ...optics.port import FlatPort
from ...optics.sheet import Sheet

__all__ = ["meet_sheet", "takes"]

Float = npt.NDArray[np.float64]

#: Half the step [px] of the derivative by the column.
_STEP = 1e-3


def takes(camera: Pinhole) -> bool:
    """Whether the kernel knows what this camera looks through."""
    return camera.port is None or isinstance(camera.port, FlatPort)


def meet_sheet(camera: Pinhole, sheet: Sheet, row: Float, col: Float) -> tuple[Float, Float]:
    """(points X (n, 3) [m], |∂X/∂c| (n, 3) [m/px]) of pixel coordinates (n); NaN as of `Geometry.points`."""
    port = camera.port
    window = (0.0, 0.0, 1.0, 1.0, 1.0)
    if isinstance(port, FlatPort):
        window = (port.stand_off_m, port.thickness_m, port.inside, port.glass, port.outside)
    point, slope = np.empty((row.size, 3)), np.empty((row.size, 3))
    _meet_all(
        row, col, (camera.focal_px, camera.row0, camera.col0), camera.distortion, any(camera.distortion), window,
        port is not None, np.ascontiguousarray(sheet.normal), np.ascontiguousarray(sheet.frame[:, 2]), sheet.source, _STEP,
        point, slope,
    )  # fmt: skip
    return point, slope


@kernel(error_model="numpy")
def _meet_all(row, col, lens, brown, bent, window, behind, normal, axis, source, step, point, slope):  # type: ignore[no-untyped-def]
    low, high = np.empty(3), np.empty(3)
    for i in range(row.size):
        _meet(row[i], col[i], lens, brown, bent, window, behind, normal, axis, source, point[i])
        _meet(row[i], col[i] - step, lens, brown, bent, window, behind, normal, axis, source, low)
        _meet(row[i], col[i] + step, lens, brown, bent, window, behind, normal, axis, source, high)
        for k in range(3):
            slope[i, k] = abs(high[k] - low[k]) / (2.0 * step)


@kernel(error_model="numpy")
def _meet(row, col, lens, brown, bent, window, behind, normal, axis, source, out):  # type: ignore[no-untyped-def]
    """One point; NaN where no ray leaves, or where it meets the sheet's plane behind the window or behind the laser."""
    focal, row0, col0 = lens
    x, y = (col - col0) / focal, (row - row0) / focal
    if bent:
        x, y = _straight(x, y, brown)
    ox = oy = oz = 0.0
    square = x * x + y * y
    if behind:
        stand_off, thickness, inside, glass, outside = window
        sine = math.sqrt(square / (1.0 + square))
        q = inside * sine
        radius = stand_off * q / _root(inside, q) + thickness * q / _root(glass, q)
        sideways = 1.0 / math.sqrt(square) if square > 0.0 else 0.0
        dx, dy = x * sideways * q / outside, y * sideways * q / outside
        dz = _root(outside, q) / outside
        ox, oy, oz = x * sideways * radius, y * sideways * radius, stand_off + thickness
    else:
        dz = 1.0 / math.sqrt(square + 1.0)
        dx, dy = x * dz, y * dz
    facing = normal[0] * dx + normal[1] * dy + normal[2] * dz
    gap = normal[0] * (source[0] - ox) + normal[1] * (source[1] - oy) + normal[2] * (source[2] - oz)
    away = gap / facing if facing != 0.0 else np.nan
    out[0], out[1], out[2] = ox + away * dx, oy + away * dy, oz + away * dz
    along = axis[0] * (out[0] - source[0]) + axis[1] * (out[1] - source[1]) + axis[2] * (out[2] - source[2])
    if not (away > 0.0 and along > 0.0):
        out[0] = out[1] = out[2] = np.nan


@kernel(error_model="numpy")
def _root(index, q):  # type: ignore[no-untyped-def]
    """n cosθ of sinθ = q/n; NaN at total reflection."""
    left = (index - q) * (index + q)
    return math.sqrt(left) if left > 0.0 else np.nan


@kernel(error_model="numpy")
def _straight(bent_x, bent_y, brown):  # type: ignore[no-untyped-def]
    """Slopes that Brown's distortion turns into these, by Newton's method; NaN as of `optics.pinhole.undistorted`."""
    k1, k2, p1, p2, k3 = brown
    x, y = bent_x, bent_y
    for _ in range(30):
        square = x * x + y * y
        radial = 1.0 + square * (k1 + square * (k2 + square * k3))
        turn = k1 + square * (2.0 * k2 + 3.0 * square * k3)
        ex = x * radial + 2.0 * p1 * x * y + p2 * (square + 2.0 * x * x) - bent_x
        ey = y * radial + p1 * (square + 2.0 * y * y) + 2.0 * p2 * x * y - bent_y
        xx = radial + 2.0 * x * x * turn + 2.0 * p1 * y + 6.0 * p2 * x
        yy = radial + 2.0 * y * y * turn + 6.0 * p1 * y + 2.0 * p2 * x
        xy = 2.0 * x * y * turn + 2.0 * p1 * x + 2.0 * p2 * y
        det = xx * yy - xy * xy
        move_x, move_y = (yy * ex - xy * ey) / det, (xx * ey - xy * ex) / det
        x, y = x - move_x, y - move_y
        if not max(abs(move_x), abs(move_y)) > 1e-15:
            break
    square = x * x + y * y
    radial = 1.0 + square * (k1 + square * (k2 + square * k3))
    ex = x * radial + 2.0 * p1 * x * y + p2 * (square + 2.0 * x * x) - bent_x
    ey = y * radial + p1 * (square + 2.0 * y * y) + 2.0 * p2 * x * y - bent_y
    found = math.sqrt(ex * ex + ey * ey) <= 1e-13 * (1.0 + math.sqrt(bent_x * bent_x + bent_y * bent_y))
    # Beyond the turn of the polynomial lie other roots, where the image is folded over or mirrored.
    if found and det > 0.0 and radial > 0.0:
        return x, y
    return np.nan, np.nan
