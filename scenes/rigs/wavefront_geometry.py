"""The geometry of a wavefront rig: lenslets on the camera, the grid of the pupil, and what follows from pitch and focus."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ...optics.constants import C_M_PER_S
from .wavefront_spec import WavefrontRig

__all__ = ["Lattice", "dynamic_range_rad", "echo_delay_s", "lattice_of", "pixel_angle_rad", "range_eq26_m", "spot_px"]

Float = NDArray[np.float64]
Bool = NDArray[np.bool_]


@dataclass(frozen=True, eq=False)
class Lattice:
    """The lenslets that are used, and the grid of the pupil, both in the array's own frame, which `rotation_rad` turns.

    row, col (lenslet): place in the array. x_m, y_m (lenslet): centre from the array's centre, along the array's axes. col_px,
    row_px (lenslet): the spot of a flat wavefront on the camera. step_m: of the pupil's grid; x_grid_m (samples of a side).
    mask: samples inside the pupil. open: samples (side, side) that lenslets let through.
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


def lattice_of(rig: WavefrontRig, *, every: bool = False) -> Lattice:
    """The lattice of a rig; with `every` also of lenslets outside the pupil, as far as the beam reaches.

    A sample of the pupil's grid is the middle of a square of side pitch/samples; the grid covers the
    array, row 0 at its least y."""
    array, pupil, camera = rig.lenslets, rig.pupil, rig.camera
    across, pitch, per = array.across, array.pitch_m, pupil.samples
    step = pitch / per
    grid = np.asarray((np.arange(across * per) - 0.5 * (across * per - 1)) * step, np.float64)
    if pupil.shape == "disc":
        mask = np.hypot(grid[:, None], grid[None, :]) <= 0.5 * pupil.diameter_m
    else:
        inside = np.abs(grid) <= 0.5 * pupil.diameter_m
        mask = inside[:, None] & inside[None, :]
    middle: Float = np.asarray((np.arange(across) - 0.5 * (across - 1)) * pitch, np.float64)
    clear = np.abs(grid - np.repeat(middle, per)) <= 0.5 * array.fill * pitch
    light = np.ones((across, across), bool)
    for down, along in array.missing:
        if down < across and along < across:
            light[down, along] = False
    opened = clear[:, None] & clear[None, :] & np.repeat(np.repeat(light, per, axis=0), per, axis=1)
    share = mask.reshape(across, per, across, per).mean(axis=(1, 3))
    row, col = np.nonzero((share >= pupil.least_fill) & light)
    if every:
        row, col = np.nonzero((np.hypot(middle[:, None], middle[None, :]) <= 0.5 * rig.bench.beam_diameter_m) & light)
    x, y = middle[col], middle[row]
    turn = np.deg2rad(array.rotation_deg)
    c, s = np.cos(turn), np.sin(turn)
    on_camera = (c * x - s * y + array.offset_m[0]), (s * x + c * y + array.offset_m[1])
    col_px = on_camera[0] / camera.pixel_pitch_m + 0.5 * (camera.cols - 1)
    row_px = on_camera[1] / camera.pixel_pitch_m + 0.5 * (camera.rows - 1)
    return Lattice(row, col, x, y, col_px, row_px, float(turn), step, grid, mask, opened)


def spot_px(rig: WavefrontRig) -> float:
    """λf/d [px], d the side of a lenslet's clear square: the first zero of its spot from the middle."""
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
