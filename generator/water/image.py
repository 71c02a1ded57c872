"""The way back through a scattering medium: each pixel's light spreads over the image as a halo.

The halo's point spread depends on range, so the image is shared out among a few ranges (linear weights between
neighbours) and each share is convolved with its own kernel. Every slice is treated by itself: the halo of a far wall
arrives when the wall's light does.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...optics.water.halo import HaloSpread, halo_spread
from ...optics.water.phase_forms import PhaseFunction
from ...scenes.rigs.parts import Camera

__all__ = ["ImageHalo", "image_halo", "pixel_shares"]

Float = NDArray[np.float64]

#: Scattering lengths between two kernels: linear weights then err by less than .25²/8 = .8 % of the halo.
_LENGTH_STEP = 0.25
_MOST_KERNELS = 12
#: Offsets up to this many pixels are integrated over the pixel; further out the middle's value stands for it.
_NEAR = 6
_FINE = 15


def pixel_shares(spread: HaloSpread, pixel_rad: float, reach: int) -> Float:
    """Halo that falls into the pixel at offset (row, col) = 0 … `reach`, relative to the unscattered light.

    Main arguments:
        spread: point spread h.
        pixel_rad: p/f, the angle of a pixel on the axis. Angles are arctan(offset·p/f), solid angles p²/f²·cos³θ.

    h is singular at 0: the pixel's own share is what the inscribed circle encloses, plus the corners.
    """
    offset = np.arange(reach + 1, dtype=np.float64)
    share = _sampled(spread, np.hypot(offset[:, None], offset), pixel_rad)
    fine = (np.arange(_FINE) + 0.5) / _FINE - 0.5
    near = min(_NEAR, reach) + 1
    for row in range(near):
        for col in range(row + 1):
            rho = np.hypot(row + fine[:, None], col + fine)
            value = _sampled(spread, rho, pixel_rad)
            if row == 0:
                value = np.where(rho < 0.5, 0.0, value)
            mean = float(value.mean()) + (
                float(spread.enclosed_within(np.arctan(0.5 * pixel_rad))) if row == 0 else 0.0
            )
            share[row, col] = share[col, row] = mean
    return share


def _sampled(spread: HaloSpread, rho: Float, pixel_rad: float) -> Float:
    theta = np.arctan(rho * pixel_rad)
    return np.asarray(spread.density_at(theta) * pixel_rad**2 * np.cos(theta) ** 3)


@dataclass(frozen=True, eq=False)
class ImageHalo:
    """Kernels of the return's halo at `range_m` (n), ascending. `own` (n): the share that stays in the pixel itself,
    left out of the kernels. Images are (rows + 2 margin, cols + 2 margin) wide and halos (rows, cols)."""

    range_m: Float
    own: Float
    shape: tuple[int, int]
    margin: int
    transform: tuple[Any, ...]
    size: tuple[int, int]

    def own_share(self, range_m: Float) -> Float:
        """Halo of a pixel that falls back into it, relative to its unscattered light."""
        return np.interp(range_m, self.range_m, self.own)

    def weights(self, range_m: Float) -> NDArray[np.float32]:
        """(kernel, …): how each pixel's light is shared among the kernels by its range; sums to 1."""
        grid = np.arange(len(self.range_m), dtype=np.float64)
        at = np.interp(range_m, self.range_m, grid)
        return np.stack([np.maximum(1.0 - np.abs(at - i), 0.0) for i in grid]).astype(np.float32)

    def spread(self, image: NDArray[np.float32], weight: NDArray[np.float32]) -> NDArray[np.float32]:
        """Halo (rows, cols) of one wide image of unscattered light, without the pixels' own shares."""
        from scipy import fft

        total = None
        for kernel, share in zip(self.transform, weight, strict=True):
            part = image * share
            if part.any():
                moved = fft.rfft2(part, self.size, workers=-1) * kernel
                total = moved if total is None else total + moved
        if total is None:
            return np.zeros(self.shape, dtype=np.float32)
        m, (rows, cols) = self.margin, self.shape
        full = fft.irfft2(total, self.size, workers=-1)
        return np.maximum(full[m : m + rows, m : m + cols], 0.0).astype(np.float32)


def image_halo(
    camera: Camera, margin: int, phase: PhaseFunction, scattering_per_m: float, range_m: tuple[float, float]
) -> ImageHalo:
    """Kernels for ranges low … high of an image with `margin` more pixels on each side."""
    from scipy import fft

    low, high = range_m
    steps = int(np.clip(np.ceil(scattering_per_m * (high - low) / _LENGTH_STEP), 1, _MOST_KERNELS - 1))
    ranges = np.linspace(low, max(high, low * (1 + 1e-6)), steps + 1)
    rows, cols = camera.rows, camera.cols
    reach = max(rows, cols) - 1 + margin
    # Room for every offset between a wide image's pixel and an inner one: nothing wraps around.
    size = (fft.next_fast_len(2 * (rows + margin), real=True), fft.next_fast_len(2 * (cols + margin), real=True))
    own, transform = [], []
    for r in ranges:
        spread = halo_spread(phase, scattering_per_m * float(r))
        share = pixel_shares(spread, camera.pixel_pitch_m / camera.focal_length_m, reach)
        own.append(float(share[0, 0]))
        share[0, 0] = 0.0
        kernel = np.zeros(size, dtype=np.float32)
        down, right = rows + margin, cols + margin
        quarter = share[:down, :right].astype(np.float32)
        kernel[:down, :right] = quarter
        # mirrored about the middle, without the middle itself
        kernel[size[0] - down + 1 :, :right] = quarter[:0:-1]
        kernel[:, size[1] - right + 1 :] = kernel[:, right - 1 : 0 : -1]
        transform.append(fft.rfft2(kernel, workers=-1))
    return ImageHalo(ranges, np.asarray(own), (rows, cols), margin, tuple(transform), size)
