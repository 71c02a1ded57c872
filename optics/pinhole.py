"""A pinhole camera with lens distortion and an optional port, flat or a dome: pixel to ray, and point to pixel, exact both ways.

    pixel (row, col) -> distorted slopes ((col − c₀)/F, (row − r₀)/F) -> slopes (x, y) -> ray, F the focal length in pixels.

Distortion (D. C. Brown, Photogrammetric Engineering 37:855, 1971): with r² = x² + y²,

    x_d = x (1 + k₁r² + k₂r⁴ + k₃r⁶) + 2p₁xy + p₂(r² + 2x²),    y_d likewise with p₁(r² + 2y²) + 2p₂xy.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from .dome import DomePort, slope_through_dome, through_dome
from .port import FlatPort, slope_toward, through_port

__all__ = ["Pinhole", "distorted", "undistorted"]

Float = NDArray[np.float64]
#: k₁, k₂, p₁, p₂, k₃.
Brown = tuple[float, float, float, float, float]


@dataclass(frozen=True)
class Pinhole:
    """A camera at the origin that looks along z (x right, y down); integers are pixel centres.

    Main arguments:
        focal_px: focal length over pixel pitch. row0, col0: the principal point [px].
    Other arguments:
        distortion: k₁, k₂, p₁, p₂, k₃ of Brown's model. port: the window before the camera; None where the camera stands in
            the medium itself.
    """

    focal_px: float
    row0: float
    col0: float
    distortion: Brown = (0.0, 0.0, 0.0, 0.0, 0.0)
    port: FlatPort | DomePort | None = None

    def rays(self, row: ArrayLike, col: ArrayLike) -> tuple[Float, Float]:
        """(origin [m], unit direction), each (3, …), of the rays in the medium through pixel coordinates (…).

        Without a port all origins are the entrance pupil, (0, 0, 0). NaN where distortion or the port let no ray through.
        """
        x, y = self.slopes(row, col)
        if isinstance(self.port, DomePort):
            return through_dome(x, y, self.port)
        if self.port is not None:
            return through_port(x, y, self.port)
        inverse = 1.0 / np.sqrt(x * x + y * y + 1.0)
        return np.zeros((3, *x.shape)), np.stack([x * inverse, y * inverse, inverse])

    def slopes(self, row: ArrayLike, col: ArrayLike) -> tuple[Float, Float]:
        """(x, y) of the ray (x, y, 1) that leaves the entrance pupil for pixel coordinates (…)."""
        at_row, at_col = np.broadcast_arrays(np.asarray(row, np.float64), np.asarray(col, np.float64))
        x, y = (at_col - self.col0) / self.focal_px, (at_row - self.row0) / self.focal_px
        return undistorted(x, y, self.distortion) if any(self.distortion) else (x, y)

    @property
    def narrowing(self) -> float:
        """Angle inside the port over that in the medium of rays near the axis: how much narrower a pixel sees; 1 without a port."""
        if isinstance(self.port, DomePort):
            step = 1e-4
            (_, low), (_, high) = (through_dome(sign * step, 0.0, self.port) for sign in (-1.0, 1.0))
            return float(2.0 * step / np.linalg.norm(high - low))
        return 1.0 if self.port is None else self.port.outside / self.port.inside

    def project(self, point: ArrayLike) -> tuple[Float, Float]:
        """(row, col) [px] at which a `point` (3, …) [m] is seen; NaN where it is not before the camera or its port."""
        at = np.asarray(point, np.float64)
        if isinstance(self.port, DomePort):
            x, y = slope_through_dome(at, self.port)
        elif self.port is not None:
            x, y = slope_toward(at, self.port)
        else:
            depth = np.where(at[2] > 0, at[2], np.nan)
            x, y = at[0] / depth, at[1] / depth
        x, y = distorted(x, y, self.distortion)
        return self.row0 + self.focal_px * y, self.col0 + self.focal_px * x


def distorted(x: Float, y: Float, k: Brown) -> tuple[Float, Float]:
    """Slopes (x_d, y_d) that the lens makes of (x, y)."""
    k1, k2, p1, p2, k3 = k
    square = x * x + y * y
    radial = 1.0 + square * (k1 + square * (k2 + square * k3))
    cross = 2.0 * x * y
    return x * radial + p1 * cross + p2 * (square + 2 * x * x), y * radial + p1 * (square + 2 * y * y) + p2 * cross


def undistorted(x_d: Float, y_d: Float, k: Brown, steps: int = 30) -> tuple[Float, Float]:
    """Slopes (x, y) that `distorted` turns into (x_d, y_d), by Newton's method; NaN where it does not converge to 1e-13, or
    only where the lens folds or mirrors the image."""
    k1, k2, p1, p2, k3 = k
    x, y = np.array(x_d, np.float64), np.array(y_d, np.float64)
    with np.errstate(invalid="ignore", over="ignore", divide="ignore"):
        for _ in range(steps):
            square = x * x + y * y
            radial = 1.0 + square * (k1 + square * (k2 + square * k3))
            turn = k1 + square * (2 * k2 + 3 * square * k3)  # d radial/d square
            got_x, got_y = distorted(x, y, k)
            ex, ey = got_x - x_d, got_y - y_d
            xx = radial + 2 * x * x * turn + 2 * p1 * y + 6 * p2 * x
            yy = radial + 2 * y * y * turn + 6 * p1 * y + 2 * p2 * x
            xy = 2 * x * y * turn + 2 * p1 * x + 2 * p2 * y
            det = xx * yy - xy * xy
            move_x, move_y = (yy * ex - xy * ey) / det, (xx * ey - xy * ex) / det
            x, y = x - move_x, y - move_y
            if not max(np.abs(move_x).max(initial=0.0), np.abs(move_y).max(initial=0.0)) > 1e-15:
                break
        got_x, got_y = distorted(x, y, k)
        good = np.hypot(got_x - x_d, got_y - y_d) <= 1e-13 * (1.0 + np.hypot(x_d, y_d))
        # Beyond the turn of the polynomial lie other roots, where the image is folded over or mirrored.
        square = x * x + y * y
        good &= (det > 0) & (1.0 + square * (k1 + square * (k2 + square * k3)) > 0)
    return np.where(good, x, np.nan), np.where(good, y, np.nan)
