"""The geometry of a wavefront rig: lenslets on the camera, the grid of the pupil, and what follows from pitch and focus."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array

from ...optics.constants import C_M_PER_S
from ...optics.lenslets.gradients import hexagon, square
from ...optics.lenslets.hexagons import hexagon_coverage, hexagon_spot
from ...optics.lenslets.spots import isolated_image
from .wavefront_spec import WavefrontRig

__all__ = [
    "Lattice", "clear_area_m2", "corners_m", "dynamic_range_rad", "echo_delay_s", "flat_spots", "lattice_of", "pixel_angle_rad",
    "range_eq26_m", "spot_px", "spot_reach_px",
]  # fmt: skip

Float = NDArray[np.float64]
Bool = NDArray[np.bool_]


@dataclass(frozen=True, eq=False)
class Lattice:
    """The lenslets that are used, and the grid of the pupil, both in the array's own frame, which `rotation_rad` turns.

    row, col (lenslet): place in the array. x_m, y_m (lenslet): centre from the array's centre, along the array's axes. col_px,
    row_px (lenslet): the spot of a flat wavefront on the camera. step_m: of the pupil's grid; x_grid_m (samples of a side).
    mask: samples inside the pupil. open: samples (side, side) that lenslets let through. samples: of a pitch. cover (lenslet,
    side²): how much of each sample lies in a clear hexagon; None for squares, whose sides lie between samples.
    """

    row: NDArray[np.int64]
    col: NDArray[np.int64]
    x_m: Float
    y_m: Float
    col_px: Float
    row_px: Float
    rotation_rad: float
    step_m: float
    grid_m: Float
    mask: Bool
    open: Bool
    samples: int
    cover: csr_array | None = None

    def totals(self, values: Float) -> Float:
        """Sum (lenslet) over each lenslet's clear area of values (side, side), in samples."""
        if self.cover is not None:
            return np.asarray(self.cover @ values.ravel())
        across = len(self.grid_m) // self.samples
        whole = (values * self.open).reshape(across, self.samples, across, self.samples).sum(axis=(1, 3))
        return np.asarray(whole[self.row, self.col])


def lattice_of(rig: WavefrontRig, *, every: bool = False) -> Lattice:
    """The lattice of a rig; with `every` also of lenslets outside the pupil, as far as the beam reaches.

    A sample of the pupil's grid is the middle of a square of side pitch/samples; the grid covers the
    array, row 0 at its least y."""
    array, pupil, camera = rig.lenslets, rig.pupil, rig.camera
    per = pupil.samples
    step = array.pitch_m / per
    # Every second row of hexagons reaches half a pitch farther.
    side = (array.across + array.hexagonal) * per
    grid = np.asarray((np.arange(side) - 0.5 * (side - 1)) * step, np.float64)
    mask = _mask(rig, grid)
    cover = None
    if array.hexagonal:
        row, col, x, y, cover = _hexagons(rig, mask, every)
        opened = np.asarray(cover.sum(axis=0)).reshape(mask.shape) >= 0.5
    else:
        row, col, x, y, opened = _squares(rig, grid, mask, every)
    turn = np.deg2rad(array.rotation_deg)
    c, s = np.cos(turn), np.sin(turn)
    on_camera = (c * x - s * y + array.offset_m[0]), (s * x + c * y + array.offset_m[1])
    col_px = on_camera[0] / camera.pixel_pitch_m + 0.5 * (camera.cols - 1)
    row_px = on_camera[1] / camera.pixel_pitch_m + 0.5 * (camera.rows - 1)
    return Lattice(row, col, x, y, col_px, row_px, float(turn), step, grid, mask, opened, per, cover)


def _mask(rig: WavefrontRig, grid: Float) -> Bool:
    pupil = rig.pupil
    if pupil.shape == "disc":
        return np.asarray(np.hypot(grid[:, None], grid[None, :]) <= 0.5 * pupil.diameter_m)
    inside = np.abs(grid) <= 0.5 * pupil.diameter_m
    return np.asarray(inside[:, None] & inside[None, :])


_Sites = tuple[NDArray[np.int64], NDArray[np.int64], Float, Float]


def _squares(rig: WavefrontRig, grid: Float, mask: Bool, every: bool) -> tuple[*_Sites, Bool]:
    array, pupil = rig.lenslets, rig.pupil
    across, pitch, per = array.across, array.pitch_m, pupil.samples
    middle: Float = np.asarray((np.arange(across) - 0.5 * (across - 1)) * pitch, np.float64)
    clear = np.abs(grid - np.repeat(middle, per)) <= 0.5 * array.fill * pitch
    light = array.lit()
    opened = clear[:, None] & clear[None, :] & np.repeat(np.repeat(light, per, axis=0), per, axis=1)
    share = mask.reshape(across, per, across, per).mean(axis=(1, 3))
    row, col = np.nonzero((share >= pupil.least_fill) & light)
    if every:
        row, col = np.nonzero((np.hypot(middle[:, None], middle[None, :]) <= 0.5 * rig.bench.beam_diameter_m) & light)
    return row, col, middle[col], middle[row], opened


def _hexagons(rig: WavefrontRig, mask: Bool, every: bool) -> tuple[*_Sites, csr_array]:
    array, pupil = rig.lenslets, rig.pupil
    pitch, step, side = array.pitch_m, array.pitch_m / pupil.samples, len(mask)
    row, col = np.nonzero(array.lit())
    middle = array.across // 2
    y = np.sqrt(0.75) * pitch * (row - 0.5 * (array.across - 1))
    x = pitch * (col - 0.5 * (array.across - 1) + 0.5 * ((row - middle) % 2))
    if every:
        used = np.hypot(x, y) <= 0.5 * rig.bench.beam_diameter_m
    else:
        sample, part = hexagon_coverage(np.stack([x, y], axis=1), pitch, step, side)
        inside = (part * mask.ravel()[sample]).sum(axis=1) * step**2
        used = inside >= pupil.least_fill * np.sqrt(0.75) * pitch**2 * (1.0 - 1e-3)
    row, col, x, y = row[used], col[used], x[used], y[used]
    sample, part = hexagon_coverage(np.stack([x, y], axis=1), array.fill * pitch, step, side)
    at = np.repeat(np.arange(len(x)), sample.shape[1] if len(x) else 0)
    cover = csr_array((part.ravel(), (at, sample.ravel())), shape=(len(x), side * side))
    return row, col, x, y, cover


def corners_m(rig: WavefrontRig) -> Float:
    """Corners (corners, 2) [m] of a lenslet about its centre, along the array's axes."""
    return hexagon(rig.lenslets.pitch_m) if rig.lenslets.hexagonal else square(rig.lenslets.pitch_m)


def clear_area_m2(rig: WavefrontRig) -> float:
    """Area [m²] of the part of a lenslet that lets light through."""
    return float((rig.lenslets.fill * rig.lenslets.pitch_m) ** 2 * (np.sqrt(0.75) if rig.lenslets.hexagonal else 1.0))


#: Distance [pitches], or in λf/d where that is less, up to which light of a hexagon's spot is computed: the rest is below 2 %.
_REACH, _REACH_WIDTHS = 3.5, 32.0


def spot_reach_px(rig: WavefrontRig) -> float:
    """Distance [px] along either axis up to which the light of a hexagonal lenslet's spot is computed."""
    return min(_REACH * rig.lenslets.pitch_m / rig.camera.pixel_pitch_m, _REACH_WIDTHS * spot_px(rig))


def flat_spots(rig: WavefrontRig, col_px: Float, row_px: Float, light: Float) -> Float:
    """Photoelectrons (rows, cols) of spots of flat waves at places (lenslet) [px] of `light` (lenslet) photoelectrons, intensities
    added; sides parallel to the pixels."""
    shape = (rig.camera.rows, rig.camera.cols)
    if rig.lenslets.hexagonal:
        return hexagon_spot(spot_px(rig), spot_reach_px(rig)).image(col_px, row_px, light, shape)
    return isolated_image(col_px, row_px, light, spot_px(rig), shape)


def spot_px(rig: WavefrontRig) -> float:
    """λf/d [px], d the side of a lenslet's clear square, or the width between the flats of its clear hexagon: the first zero of a
    square's spot from the middle."""
    array = rig.lenslets
    return rig.wavelength_m * array.focal_length_m / (array.fill * array.pitch_m) / rig.camera.pixel_pitch_m


def pixel_angle_rad(rig: WavefrontRig) -> float:
    """θ_min = P/f [rad], the angle of one pixel P. Guo et al. 2017, Eq. 33, call it the sensitivity, which it is not: centroids
    resolve a small fraction of a pixel."""
    return rig.camera.pixel_pitch_m / rig.lenslets.focal_length_m


def dynamic_range_rad(rig: WavefrontRig) -> float:
    """θ_max = D/2f [rad], the slope that moves a spot by half the pitch D. Guo et al. 2017, Eq. 34."""
    return rig.lenslets.pitch_m / (2.0 * rig.lenslets.focal_length_m)


def range_eq26_m(travel_time_s: float | Float, group_index: float) -> float | Float:
    """r = v t₀/2 [m] with v = c/n_g. Guo et al. 2017, Eq. 26, for a rig of no arms, L1 = L2 = 0."""
    return C_M_PER_S / group_index * travel_time_s / 2.0


def echo_delay_s(rig: WavefrontRig, range_m: float, group_index: float) -> float:
    """Delay [s] of the echo of a reflector at `range_m` behind the last beam splitter: 2 n_g r/c + (L1 + L2)/c.

    The arms lie in air, whose index is taken as 1. With L1 = L2 the range from the laser, r + L1, obeys Eq. 26 but for n_g.
    """
    arms = rig.bench.laser_arm_m + rig.bench.camera_arm_m
    return (2.0 * group_index * range_m + arms) / C_M_PER_S
