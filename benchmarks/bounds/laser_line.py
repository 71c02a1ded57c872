"""Bounds of a laser line: the column of each row and return, and the point where that column's ray meets the sheet.

A row holds μ_j = A [Φ((j + ½ − c)/s) − Φ((j − ½ − c)/s)] + B photoelectrons. With J the exact information of a pixel (Poisson,
Gaussian read noise, converter) the information about c at one phase of c within its pixel is Σ_j J(μ_j) (∂μ_j/∂c)². The bound
is that of its mean over all phases,

    σ_c² = 1/⟨Σ_j J(μ_j) (∂μ_j/∂c)²⟩.

Readings of a narrow line are biased by the phase ("pixel locking"), and at some phases a biased reading has less error than the
bound of an unbiased one there. The mean over the phases is that of van Trees' inequality for a line that may lie anywhere, which
holds for biased readings too. What A, B and s leave unknown costs nothing in this mean: by symmetry they do not mix with c.

Source: H. L. van Trees, Detection, Estimation, and Modulation Theory, Part I, 1968, sec. 2.4.3; R. D. Gill and B. Y. Levit,
Bernoulli 1:59, 1995.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import numpy.typing as npt
import xarray as xr
from scipy.special import ndtr

from ...estimators.rig import DeclaredRig
from ...optics.likelihood.fisher_table import information_table
from ...optics.likelihood.model import NoiseModel
from ...optics.pinhole import Pinhole
from ...optics.sheet import Sheet, meeting
from ...scenes.medium_index import phase_index
from ...scenes.rigs.camera_noise import camera_noise
from ...scenes.rigs.laser_line import LaserLineRig, laser_line_rig
from ...scenes.rigs.laser_line_geometry import line_camera, line_sheet
from ..scores.truth import Bound
from .instrument import bounded, true_scene, unbounded

__all__ = ["column_sigma", "laser_line_bounds", "line_noise"]

Float = npt.NDArray[np.float64]

#: Width [px] of what a reading may follow: half of it, 2 px, is a failure.
_SCALE_PX = 4.0
#: Phases of the pixel in the mean; lines that are computed at once.
_PHASES, _CHUNK = 32, 512
#: Least bound of a coordinate [m], as of the stated errors: numbers hold no less.
_LEAST_M = 1e-12


def laser_line_bounds(capture: xr.Dataset) -> Mapping[str, Bound]:
    """The bounds of `column` [px] and `point` [m] of a generated capture.

    `kind` is "exact"; "quasi" where pixels differ (PRNU, DSNU, speckle, blooming), where the rig moves, where scattered light
    varies along the row, where a row has several returns, whose light may overlap, or only a part of a line, and where a line is
    slanted; "none" without true scene and amplitude. Raises InputError for an invalid true scene.
    """
    if not bounded(capture, "truth_amplitude", "truth_width", "truth_background"):
        return _none(capture)
    scene = true_scene(capture)
    rig = laser_line_rig(scene)
    truth = np.asarray(capture["truth_column"].values, np.float64)
    amplitude, width = (np.asarray(capture[f"truth_{name}"].values, np.float64) for name in ("amplitude", "width"))
    sigma = column_sigma(amplitude, width, _levels(capture, truth, rig), line_noise(rig))
    flat = capture["truth_background"].ndim == 1
    kind = "exact" if _plain(rig) and flat and truth.shape[2] == 1 and _whole(truth, width) else "quasi"
    index = phase_index(scene.medium, rig.wavelength_m)
    slope = _slopes(line_camera(rig, index), line_sheet(rig, index), truth)
    column = Bound(np.where(np.isfinite(truth), sigma, np.nan), kind, _SCALE_PX, float(rig.camera.cols))
    point = np.hypot(sigma[..., None] * slope, _LEAST_M)
    per_px = _typical(slope)
    return {"column": column, "point": Bound(point, kind, _SCALE_PX * per_px, rig.camera.cols * per_px)}


def column_sigma(amplitude: Float, width: Float, level: Float, noise: NoiseModel) -> Float:
    """σ_c [px] of lines of `amplitude` A and `level` B [photoelectrons] and `width` s [px], arrays of one shape."""
    a, s, b = (np.asarray(v, np.float64).ravel() for v in (amplitude, width, level))
    out = np.full(a.size, np.nan)
    live = np.flatnonzero(np.isfinite(a) & np.isfinite(s) & (a > 0))
    table = information_table(noise)
    phase = (np.arange(_PHASES) + 0.5) / _PHASES - 0.5
    for begin in range(0, live.size, _CHUNK):
        own = live[begin : begin + _CHUNK]
        reach = int(np.ceil(7.0 * s[own].max())) + 1
        edge = np.arange(-reach, reach + 2) - 0.5
        u = (edge - phase[:, None]) / s[own, None, None]
        mean = b[own, None, None] + a[own, None, None] * np.diff(ndtr(u), axis=-1)
        slope = -(a / s)[own, None, None] * np.diff(np.exp(-0.5 * u * u), axis=-1) / np.sqrt(2.0 * np.pi)
        out[own] = (np.asarray(table(mean)) * slope**2).sum(axis=-1).mean(axis=-1)
    with np.errstate(divide="ignore"):
        return np.asarray(1.0 / np.sqrt(out)).reshape(np.shape(amplitude))


def line_noise(rig: LaserLineRig) -> NoiseModel:
    """The likelihood of one pixel. Dark electrons are part of the mean, except behind an intensifier."""
    return camera_noise(rig.detector)


def _levels(capture: xr.Dataset, truth: Float, rig: LaserLineRig) -> Float:
    """Photoelectrons beside the line at each return (frame, row, return), without the dark ones behind an intensifier."""
    held = np.asarray(capture["truth_background"].values, np.float64)
    exposure = np.full(len(truth), rig.detector.exposure_s)
    if "exposure" in capture.coords:
        exposure = np.asarray(capture["exposure"].values, np.float64)
    rate = 0.0 if rig.detector.intensifier is None else rig.detector.dark_current_e_per_s
    dark = (rate * exposure)[:, None, None]
    if held.ndim == 1:
        return np.broadcast_to(held[:, None, None] - dark, truth.shape)
    at = np.clip(np.rint(np.nan_to_num(truth)), 0, held.shape[2] - 1).astype(np.int64)
    return np.asarray(np.take_along_axis(held, at, axis=2) - dark)


def _plain(rig: LaserLineRig) -> bool:
    still = not any(rig.motion_m_per_s or ()) and not any(rig.turn_rad_per_s or ())
    still = still and rig.auto_exposure is None
    drawn = rig.effects is not None and (rig.effects.speckle_looks is not None or rig.effects.blooming is not None)
    return still and not drawn and rig.detector.prnu == 0 and rig.detector.dsnu_e == 0


def _whole(column: Float, width: Float) -> bool:
    """Whether every row of a lit frame holds a line over all its height, with a profile that its slant does not change.

    A line that ends in a row leaves the row beside it empty. A slant of k columns per row spreads the profile evenly over k: its
    variance k²/12 must be below a fiftieth of the whole.
    """
    held = np.isfinite(column[..., 0])
    if (held.any(axis=1) & ~held.all(axis=1)).any():
        return False
    slant = np.diff(column[..., 0], axis=1)
    return not bool((slant**2 / 12.0 > 0.02 * width[:, 1:, 0] ** 2).any())


def _slopes(camera: Pinhole, sheet: Sheet, column: Float) -> Float:
    """|∂X/∂c| [m/px] (frame, row, return, xyz) on the sheet."""
    row = np.broadcast_to(np.arange(column.shape[1], dtype=np.float64)[:, None], column.shape)
    ends = []
    for step in (-1e-3, 1e-3):
        origin, direction = camera.rays(row, np.nan_to_num(column) + step)
        ends.append(meeting(origin, direction, sheet.normal, sheet.source))
    slope = np.abs(ends[1] - ends[0]) / 2e-3
    return np.moveaxis(np.where(np.isfinite(column), slope, np.nan), 0, -1)


def _typical(slope: Float) -> float:
    """Median length of ∂X/∂c, m/px; 1 without any truth, so that scales stay numbers."""
    length = np.sqrt((slope**2).sum(axis=-1))
    return float(np.nanmedian(length)) if np.isfinite(length).any() else 1.0


def _none(capture: xr.Dataset) -> Mapping[str, Bound]:
    """No bound: scales from the declared rig. A point's are those of the range at a tenth of the sensor's parallax."""

    def scales(rig: DeclaredRig) -> tuple[float, float]:
        return _SCALE_PX, float(rig.whole("camera.cols"))

    def lengths(rig: DeclaredRig) -> tuple[float, float]:
        focal = rig.number("camera.focal_length_m", above=0) / rig.number("camera.pixel_pitch_m", above=0)
        baseline = float(np.dot(rig.numbers("laser.normal", length=3), rig.numbers("laser.position_m", length=3)))
        per_px = abs(baseline) * 10.0**2 / focal
        return _SCALE_PX * per_px, rig.whole("camera.cols") * per_px

    return {
        "column": unbounded(capture, scales, truth="truth_column"),
        "point": unbounded(capture, lengths, truth="truth_point"),
    }
