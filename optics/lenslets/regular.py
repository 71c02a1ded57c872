"""Coherent spots of a regular square array, fast: fields on a lattice that all lenslets share, then pixels by exact interpolation.

The same sum as `coherent`, with the fields taken at `samples` points per pitch, so that one kernel serves all lenslets and the sums
over cells are matrix products. Light of a lenslet is kept over its own cell and `neighbours` cells to each side. Between the points
the irradiance is interpolated by sinc, and each pixel's integral of that is a difference of sine integrals: any ratio of
pitch to pixel and any offset, no resampling. Points too few alias what interferes far from its lenslet; `error_of` of the
test says by how much.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.special import sici

from .coherent import Detector, Lenslet

__all__ = ["RegularArray", "cells_of_phase", "regular_array"]

Float = NDArray[np.float64]
Complex64 = NDArray[np.complex64]


@dataclass(frozen=True, eq=False)
class RegularArray:
    """What is common to all frames of one array and detector.

    Main arguments:
        shape: rows, columns of lenslets. cells: q per lenslet and axis. samples: points of the lattice per pitch.
        neighbours: cells kept to each side. kernel (points, cells): of one axis. offset_m (points): of the points from a
        lenslet's centre. cell_m (cells): of the cells' centres. pixel_y, pixel_x (pixels, lattice): integrals over pixels [m].
    Single precision: relative errors of 1e-6 of the brightest pixel.
    """

    lenslet: Lenslet
    shape: tuple[int, int]
    cells: int
    samples: int
    neighbours: int
    kernel: Complex64
    offset_m: Float
    cell_m: Float
    pixel_y: NDArray[np.float32]
    pixel_x: NDArray[np.float32]

    def image(self, samples: ArrayLike, slope_rad: ArrayLike) -> Float:
        """Light per pixel (rows, cols) in the unit of |u|² m².

        `samples` (rows, cols, q, q) and `slope_rad` (rows, cols, 2) of lenslets, as for `coherent_image`; lenslets without
        light have samples of zero. Raises ValueError for other shapes.
        """
        light = self.lattice(samples, slope_rad)
        return np.asarray(self.pixel_y @ light @ self.pixel_x.T, np.float64)

    def lattice(self, samples: ArrayLike, slope_rad: ArrayLike) -> NDArray[np.float32]:
        """Irradiance |Σ U_m|² on the lattice, (rows + 2·neighbours)·samples by (cols + 2·neighbours)·samples."""
        u, slope = np.asarray(samples), np.asarray(slope_rad, np.float64)
        if u.shape != (*self.shape, self.cells, self.cells) or slope.shape != (*self.shape, 2):
            raise ValueError(
                f"samples need the shape {(*self.shape, self.cells, self.cells)} and slope_rad {(*self.shape, 2)}, "
                f"not {u.shape} and {slope.shape}."
            )
        wave = np.exp(2j * np.pi / self.lenslet.wavelength_m * slope[..., None] * self.cell_m)
        u = (u * wave[..., 0, None, :] * wave[..., 1, :, None]).astype(np.complex64)
        side = self.lenslet.side_m / self.cells
        spread = np.sinc(
            side * (self.offset_m - self.lenslet.focal_length_m * slope[..., None]) / self.lenslet.scale_m2
        ).astype(np.float32)
        size = [(n + 2 * self.neighbours) * self.samples for n in self.shape]
        real, imag = np.zeros(size, np.float32), np.zeros(size, np.float32)
        k = self.kernel
        parts = [
            np.ascontiguousarray(part)
            for part in (u.real, u.imag, k.real.T, k.imag.T, spread[..., 0, :], spread[..., 1, :])
        ]
        from .regular_kernels import add_fields

        add_fields(*parts, self.samples, real, imag)
        return np.asarray(real * real + imag * imag)


def regular_array(
    lenslet: Lenslet,
    shape: tuple[int, int],
    pitch_m: float,
    detector: Detector,
    *,
    cells: int = 8,
    samples: int = 24,
    neighbours: int = 1,
) -> RegularArray:
    """The plan of an array of `shape` lenslets `pitch_m` apart whose middle is at x = y = 0, seen by `detector`.

    Other arguments:
        cells: q. samples: lattice points per pitch. neighbours: cells kept to each side of a lenslet's own.

    Raises ValueError for numbers below 1 (0 for neighbours) or a pitch below the lenslet's side.
    """
    if min(*shape, cells, samples) < 1 or neighbours < 0 or not pitch_m >= lenslet.side_m * (1 - 1e-12) > 0:
        raise ValueError(
            "shape, cells and samples must be at least 1, neighbours at least 0, and pitch_m at least the lenslet's side: "
            f"{shape!r}, {cells!r}, {samples!r}, {neighbours!r}, {pitch_m!r}."
        )
    count = (2 * neighbours + 1) * samples
    step = pitch_m / samples
    offset = step * (np.arange(count) - 0.5 * (count - 1))
    side = lenslet.side_m / cells
    cell = side * (np.arange(cells) - 0.5 * (cells - 1))
    chirp = np.exp(1j * np.pi * offset**2 / lenslet.scale_m2) * side / np.sqrt(lenslet.scale_m2)
    kernel = chirp[:, None] * np.exp(-2j * np.pi * offset[:, None] * cell / lenslet.scale_m2)
    pixel = [
        _pixels(
            (shape[a] + 2 * neighbours) * samples, step, detector.shape[a], detector.pixel_m, detector.origin_m[1 - a]
        )
        for a in (0, 1)
    ]
    return RegularArray(
        lenslet,
        (shape[0], shape[1]),
        cells,
        samples,
        neighbours,
        kernel.astype(np.complex64),
        offset,
        cell,
        pixel[0],
        pixel[1],
    )


def cells_of_phase(
    phase_rad: ArrayLike, shape: tuple[int, int], cells: int, side_m: float, wavelength_m: float
) -> tuple[NDArray[np.complex128], Float]:
    """(samples (rows, cols, q, q), slope (rows, cols, 2) [rad]) of a phase that is sampled on p·q points per lenslet and axis.

    Main arguments:
        phase_rad (rows·p·q, cols·p·q): φ, not wrapped, at the middles of its points; lenslets without gaps between them.
        shape: rows,
            columns of lenslets. cells: q. side_m: of a lenslet. wavelength_m: of the slopes.

    The means of φ over the cells, less their plane fit, whose slope is given apart. Raises ValueError where the points do not
    divide.
    """
    phase = np.asarray(phase_rad, np.float64)
    rows, cols = shape
    if phase.ndim != 2 or phase.shape[0] % (rows * cells) or phase.shape[1] % (cols * cells):
        raise ValueError(
            f"phase_rad {phase.shape} does not divide into {rows} × {cols} lenslets of {cells} × {cells} cells."
        )
    high, wide = phase.shape[0] // (rows * cells), phase.shape[1] // (cols * cells)
    mean = phase.reshape(rows, cells, high, cols, cells, wide).mean(axis=(2, 5)).transpose(0, 2, 1, 3)
    x = side_m / cells * (np.arange(cells) - 0.5 * (cells - 1))
    spread = x @ x if cells > 1 else 1.0
    gradient = np.stack([mean.mean(axis=2) @ x, mean.mean(axis=3) @ x], axis=-1) / spread
    rest = mean - gradient[..., 0, None, None] * x - gradient[..., 1, None, None] * x[:, None]
    return np.exp(1j * rest), np.asarray(gradient * (wavelength_m / (2.0 * np.pi)))


def _pixels(points: int, step_m: float, pixels: int, pixel_m: float, origin_m: float) -> NDArray[np.float32]:
    """∫ over each pixel of sinc((X − X_j)/step) dX as (pixels, points) [m]; X_j centred on 0."""
    edge = origin_m + pixel_m * (np.arange(pixels + 1) - 0.5)
    u = edge[:, None] / step_m - (np.arange(points) - 0.5 * (points - 1))
    return np.asarray(step_m / np.pi * np.diff(sici(np.pi * u)[0], axis=0), np.float32)
