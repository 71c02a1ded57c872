"""Bounds of a Shack-Hartmann sensor: positions of spots, slopes, and Zernike coefficients and phases that follow from them.

The cell of a spot holds μ_j = B_j + A P_j(x) P_j(y) photoelectrons, P the spot of the clear square integrated over pixels, B what
is not the spot's: background, and the light of the other lenslets. With J the exact information of a pixel (Poisson, gamma of the
tube, read noise, converter)

    F_ab = Σ_j J(μ_j) ∂_a μ_j ∂_b μ_j over (x, y, A),    σ² = (F⁻¹)_xx,

and as the position is read against a reference of n exposures, σ² = σ²(frame) + σ²(reference)/n. Slopes are p/f of it. The least
squares of J modes have the covariance (AᵀΣ⁻¹A)⁻¹, A the gradients averaged over lenslets: the bound of coefficients where the
wavefront has no other modes. Those that it has besides come through as aliasing, so that this is called "quasi".
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import numpy.typing as npt
import xarray as xr

from ...estimators.rig import DeclaredRig
from ...optics.lenslets.gradients import mean_gradients
from ...optics.lenslets.hexagons import hexagon_spot
from ...optics.lenslets.spots import pixel_share_slopes, pixel_shares
from ...optics.likelihood.fisher_table import information_table
from ...optics.zernike import zernike
from ...scenes.rigs.camera_noise import camera_noise
from ...scenes.rigs.wavefront import WavefrontRig, wavefront_rig
from ...scenes.rigs.wavefront_geometry import Lattice, corners_m, flat_spots, lattice_of, spot_px, spot_reach_px
from ..scores.truth import Bound
from .instrument import bounded, true_scene, unbounded
from .wavefront_turbulence import image_bound, turbulence_bounds

__all__ = ["spot_sigma", "wavefront_bounds"]

Float = npt.NDArray[np.float64]

#: Error of a coefficient or phase [rad] at which it has failed: half of this.
_SCALE_RAD = 2.0
#: Half side [pitches] of the square of pixels about a spot that tell of it.
_REACH = 1.0


def wavefront_bounds(capture: xr.Dataset) -> Mapping[str, Bound]:
    """The bounds of `spot` [px], `slope`, `zernike` and `phase` [rad] of a generated capture.

    `kind` is "exact" for spots and slopes of the rung `geometric` whose pixels are alike and independent; "quasi" where lenslets
    blur, fields interfere, or the noise hides how far the spots move; "none" without true scene and flux.
    Raises InputError for an invalid true scene.
    """
    if not bounded(capture, "truth_flux", "truth_background"):
        return _none(capture)
    rig = wavefront_rig(true_scene(capture))
    lattice = lattice_of(rig)
    slope = np.asarray(capture["truth_slope"].values, np.float64)
    flux = np.asarray(capture["truth_flux"].values, np.float64)
    level = np.asarray(capture["truth_background"].values, np.float64)
    per_px = rig.camera.pixel_pitch_m / rig.lenslets.focal_length_m
    place = np.stack([lattice.col_px, lattice.row_px], axis=1)
    variance = np.stack(
        [spot_sigma(rig, place + s / per_px, f, b) ** 2 for s, f, b in zip(slope, flux, level, strict=True)]
    )
    best = int(np.argmax(flux.sum(axis=1)))  # the frame in whose light the reference is taken
    # The reference is a flat wave's: where the water scintillates, its even light is taken as the mean of the lenslets.
    even = flux[best] if np.ptp(flux[best]) == 0.0 else np.full(len(place), flux[best].mean())
    variance += spot_sigma(rig, place, even, float(level[best])) ** 2 / rig.frames.reference_exposures
    sigma = np.where(np.isfinite(slope), np.sqrt(variance), np.nan)
    kind = "exact" if _plain(capture, rig) and _settled(sigma, slope / per_px) else "quasi"
    width, pitch = spot_px(rig), rig.lenslets.pitch_m / rig.camera.pixel_pitch_m
    modes, phase = _modal(capture, rig, lattice, sigma * per_px)
    tilt = 2.0 * np.pi / rig.wavelength_m * pitch * per_px * rig.pupil.diameter_m
    centre, k = np.stack([lattice.x_m, lattice.y_m], axis=1), 2.0 * np.pi / rig.wavelength_m
    return {
        **turbulence_bounds(capture, sigma * per_px, centre, rig.lenslets.pitch_m, k), **image_bound(capture),
        "spot": Bound(sigma, kind, width, pitch),
        "slope": Bound(sigma * per_px, kind, width * per_px, pitch * per_px),
        "zernike": Bound(modes, "quasi", _SCALE_RAD, tilt / 4.0),
        "phase": Bound(phase, "quasi", _SCALE_RAD, tilt),
    }  # fmt: skip


def spot_sigma(rig: WavefrontRig, at: Float, flux: Float, level: float) -> Float:
    """σ [px] (lenslet, axis) of spots at `at` (lenslet, axis: column, row) [px] of `flux` (lenslet) photoelectrons, over `level`
    photoelectrons per pixel. Infinite without information."""
    rows, cols = rig.camera.rows, rig.camera.cols
    whole = level + flat_spots(rig, at[:, 0], at[:, 1], flux)
    information = information_table(camera_noise(rig.detector))(np.maximum(whole, 1e-9))
    reach = int(np.ceil(_REACH * rig.lenslets.pitch_m / rig.camera.pixel_pitch_m))
    step = np.arange(-reach, reach + 1)
    col, row = (np.rint(at[:, axis]).astype(np.int64)[:, None] + step for axis in (0, 1))
    there = ((row >= 0) & (row < rows))[:, :, None] & ((col >= 0) & (col < cols))[:, None, :]
    col, row = np.clip(col, 0, cols - 1), np.clip(row, 0, rows - 1)
    j = np.where(there, information[row[:, :, None], col[:, None, :]], 0.0)
    along, down, share = _shares(rig, at, col, row)
    light = flux[:, None, None]
    gradient = np.stack([light * along, light * down, share], axis=1)
    fisher = np.einsum("lij,laij,lbij->lab", j, gradient, gradient, optimize=True)
    sigma = np.full((len(at), 2), np.inf)
    scale = np.sqrt(np.maximum(np.einsum("laa->la", fisher), 1e-300))
    unit = fisher / (scale[:, :, None] * scale[:, None, :])
    live = np.isfinite(unit).all(axis=(1, 2)) & (flux > 0)
    live[live] = np.linalg.det(unit[live]) > 1e-9
    inverse = np.linalg.inv(unit[live])
    sigma[live] = np.sqrt(np.einsum("laa->la", inverse)[:, :2]) / scale[live, :2]
    return sigma


def _shares(rig: WavefrontRig, at: Float, col: npt.NDArray[np.int64], row: npt.NDArray[np.int64]) -> list[Float]:
    """[∂P/∂x, ∂P/∂y, P] (lenslet, rows, cols) of spots at `at` in pixels of columns (lenslet, cols) and rows (lenslet, rows)."""
    if rig.lenslets.hexagonal:
        spot = hexagon_spot(spot_px(rig), spot_reach_px(rig))

        def held(d_row: int, d_col: int) -> Float:
            # Clipped indices repeat where a window leaves the image: the table takes rising places only.
            steps = [
                np.arange(one.shape[1]) + np.rint(at[:, axis, None]) - one.shape[1] // 2
                for axis, one in ((1, row), (0, col))
            ]
            return np.stack([
                spot.shares(y - b, x - a, d_row=d_row, d_col=d_col) for y, x, (a, b) in zip(*steps, at, strict=True)
            ])  # fmt: skip

        return [-held(0, 1), -held(1, 0), held(0, 0)]
    width = spot_px(rig)
    px, py = pixel_shares(at[:, 0], width, rig.camera.cols), pixel_shares(at[:, 1], width, rig.camera.rows)
    dx = pixel_share_slopes(at[:, 0], width, rig.camera.cols)
    dy = pixel_share_slopes(at[:, 1], width, rig.camera.rows)
    px, dx = (np.take_along_axis(one, col, axis=1)[:, None, :] for one in (px, dx))
    py, dy = (np.take_along_axis(one, row, axis=1)[:, :, None] for one in (py, dy))
    return [py * dx, dy * px, py * px]


def _plain(capture: xr.Dataset, rig: WavefrontRig) -> bool:
    """Whether the likelihood of a pixel is the one that is computed: spots of the closed form, alike and independent pixels."""
    import json

    rung = json.loads(capture.attrs.get("fidelity", "{}")).get("rung", "geometric")
    tube = rig.detector.intensifier
    spread = tube is not None and tube.phosphor_sigma_px > 0
    speckle = rig.effects is not None and rig.effects.speckle_looks is not None
    return rung == "geometric" and rig.detector.prnu == 0 and rig.detector.dsnu_e == 0 and not spread and not speckle


def _settled(sigma: Float, moved: Float) -> bool:
    """Whether the spots move by four bounds or more, rms: below that an answer that is drawn to the declared place, as that of a
    coarse method is, may err less than the bound of unbiased ones (van Trees: by half of 1/16)."""
    seen = np.isfinite(sigma) & np.isfinite(moved)
    if not seen.any():
        return False
    return bool(np.mean(moved[seen] ** 2) >= 16.0 * np.mean(sigma[seen] ** 2))


def _modal(capture: xr.Dataset, rig: WavefrontRig, lattice: Lattice, slope_sigma: Float) -> tuple[Float, Float]:
    """(bounds of the coefficients (frame, mode), of the phase (frame, row, col)) [rad]; infinite where slopes do not tell modes
    apart, NaN outside the pupil."""
    frames, number = capture["truth_zernike"].shape
    side = len(lattice.grid_m)
    modes = np.full((frames, number), np.inf)
    phase = np.full((frames, side, side), np.nan)
    phase[:, lattice.mask] = np.inf
    if rig.pupil.shape != "disc":
        return modes, phase
    radius = 0.5 * rig.pupil.diameter_m
    noll = range(2, number + 2)
    centre = np.stack([lattice.x_m, lattice.y_m], axis=1)
    a = mean_gradients(noll, centre, corners_m(rig), radius) * rig.wavelength_m / (2.0 * np.pi)
    unit = lattice.grid_m / radius
    x, y = np.broadcast_arrays(unit[None, :], unit[:, None])
    surface = zernike(noll, x[lattice.mask], y[lattice.mask])
    surface = surface - surface.mean(axis=1, keepdims=True)
    for frame in range(frames):
        # The two axes of a turned array mix; their bounds are alike.
        weight = 1.0 / slope_sigma[frame] ** 2
        use = np.isfinite(weight).all(axis=1) & (weight > 0).all(axis=1)
        rooted = (a[use] * np.sqrt(weight[use])[:, :, None]).reshape(-1, number)
        if len(rooted) < number:
            continue
        _, d, vt = np.linalg.svd(rooted, full_matrices=False)
        if not d[-1] * 1e6 > d[0]:
            continue
        covariance = (vt.T / d**2) @ vt
        modes[frame] = np.sqrt(np.diagonal(covariance))
        phase[frame][lattice.mask] = np.sqrt(((covariance @ surface) * surface).sum(axis=0))
    return modes, phase


def _none(capture: xr.Dataset) -> Mapping[str, Bound]:
    """No bound: scales from the declared rig."""

    def pixels(rig: DeclaredRig) -> tuple[float, float]:
        pixel = rig.number("camera.pixel_pitch_m", above=0)
        pitch = rig.number("lenslets.pitch_m", above=0)
        width = rig.number("laser.wavelength_m", above=0) * rig.number("lenslets.focal_length_m", above=0) / pitch
        return width / pixel, pitch / pixel

    def angles(rig: DeclaredRig) -> tuple[float, float]:
        per_px = rig.number("camera.pixel_pitch_m", above=0) / rig.number("lenslets.focal_length_m", above=0)
        width, pitch = pixels(rig)
        return width * per_px, pitch * per_px

    def phases(rig: DeclaredRig) -> tuple[float, float]:
        tilt = 2.0 * np.pi / rig.number("laser.wavelength_m", above=0) * angles(rig)[1]
        return _SCALE_RAD, tilt * rig.number("pupil.diameter_m", above=0)

    return {
        "spot": unbounded(capture, pixels, truth="truth_slope"),
        "slope": unbounded(capture, angles, truth="truth_slope"),
        "zernike": unbounded(capture, phases, truth="truth_zernike"),
        "phase": unbounded(capture, phases, truth="truth_phase"),
    }
