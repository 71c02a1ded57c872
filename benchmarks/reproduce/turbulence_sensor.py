"""What Eq. 26 to 34 of Guo et al. 2017 give on a computed sensor: spots, windows, series, deblurring; numbers for the rows."""

from __future__ import annotations

import math
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from ...optics.deconvolution import blurred_eq31, deblur, point_spread, transfer_of
from ...optics.lenslets.gradients import mean_gradients, square
from ...optics.lenslets.guo import centroid_x_eq28
from ...optics.lenslets.spots import pixel_share_slopes, pixel_shares
from ...optics.turbulence.screens import kolmogorov_plan
from ...optics.zernike import zernike
from .turbulence_order import FOCAL_M, PITCH_M, PIXEL_M, WAVELENGTH_M

__all__ = [
    "aliasing_px", "angle_error_rad", "deblurring_gain_db", "displacement_over_slope", "ray_slope_rad", "share_of_peak_to_valley",
    "share_shown",
]  # fmt: skip

Float = NDArray[np.float64]

#: λf/d and the pitch [px] of the printed sensor.
SPOT_PX = WAVELENGTH_M * FOCAL_M / PITCH_M / PIXEL_M
PITCH_PX = PITCH_M / PIXEL_M


def _rng(*key: int) -> np.random.Generator:
    return np.random.default_rng(np.random.SeedSequence(0, spawn_key=(26, *key)))


def displacement_over_slope(lenslet_over_r0: float = 0.13, draws: int = 100, samples: int = 64) -> float:
    """Regression of Δx/f on the mean slope over a lenslet, by diffraction: the centre of gravity of |F[e^{iφ}]|², Kolmogorov φ.

    The transform covers `samples` λf/d, beyond which 1/(π² · samples/2) of a displacement is lost.
    """
    plan = kolmogorov_plan(PITCH_M / lenslet_over_r0, (samples + 1, samples + 1), PITCH_M / samples)
    rng, found = _rng(27), np.empty((draws, 2))
    frequency = np.fft.fftfreq(2 * samples, d=PITCH_M / samples)  # sin(angle)/λ of the focal plane
    for each in found:
        phase = plan.draw(rng)
        middle = 0.25 * (phase[1:, 1:] + phase[1:, :-1] + phase[:-1, 1:] + phase[:-1, :-1])
        light = (np.abs(np.fft.fft2(np.exp(1j * middle), (2 * samples, 2 * samples))) ** 2).sum(axis=0)
        each[0] = WAVELENGTH_M * float((light * frequency).sum() / light.sum())
        edge = 0.5 * (phase[1:] + phase[:-1]).mean(axis=0)
        each[1] = WAVELENGTH_M / (2 * math.pi) * float(edge[-1] - edge[0]) / PITCH_M
    return float((found[:, 0] * found[:, 1]).sum() / (found[:, 1] ** 2).sum())


def _window(shift_px: Float, alpha: float, width: int, background: float = 0.0, neighbours: bool = False) -> Float:
    """X_c [px] of Eq. 28 for spots moved by `shift_px`, in a fixed window of `width` pixels about their place at rest.

    `background`: per pixel, over the brightest pixel of a spot at rest. `neighbours`: spots a pitch away, moved alike.
    """
    centre = 0.5 * (width - 1)
    rest = pixel_shares(np.array([centre]), SPOT_PX, width)
    row = rest[0]
    along = pixel_shares(centre + shift_px, SPOT_PX, width)
    if neighbours:
        along = along + sum(pixel_shares(centre + shift_px + s * PITCH_PX, SPOT_PX, width) for s in (-1, 1))
    light = along[:, None, :] * row[None, :, None] + background * float((rest.max()) ** 2)
    return centroid_x_eq28(light, np.arange(width) - centre, alpha)


def aliasing_px(alpha: float) -> float:
    """Greatest error [px] of Eq. 28 as a spot crosses a pixel, after the best straight line is taken off: no light is lost, since
    the window is 81 pixels. Zero where a pixel is at most λf/(αd)."""
    shift = np.linspace(-0.5, 0.5, 41)
    found = _window(shift, alpha, 81)
    return float(np.abs(found - shift * float((found * shift).sum() / (shift**2).sum())).max())


def share_shown(shift_px: float, alpha: float, width: int, background: float = 0.0, neighbours: bool = False) -> float:
    """X_c of Eq. 28 over the displacement of the spot."""
    return float(_window(np.array([shift_px]), alpha, width, background, neighbours)[0] / shift_px)


def angle_error_rad(photoelectrons: float) -> float:
    """Least standard error [rad] of a spot's angle: photon noise alone, σ² = 1/(N Σ p'²/p) with p the share of a pixel's column."""
    place = np.linspace(-0.5, 0.5, 21) + 20.0
    share = np.maximum(pixel_shares(place, SPOT_PX, 41), 1e-300)
    information = (pixel_share_slopes(place, SPOT_PX, 41) ** 2 / share).sum(axis=1)
    return float(np.sqrt((1.0 / information).mean() / photoelectrons)) * PIXEL_M / FOCAL_M


def ray_slope_rad(index_rms: float, eddy_m: float, path_m: float) -> float:
    """rms slope per axis [rad] of a wave that a mirror sends back through random index: 2 δn √(2√π L/ℓ).

    The index has the covariance δn² exp(−ρ²/ℓ²); its transverse gradient 2δn²/ℓ² exp(−z²/ℓ²) is integrated along the path of L.
    """
    return 2.0 * index_rms * math.sqrt(2.0 * math.sqrt(math.pi) * path_m / eddy_m)


def _edge_slopes(phase: Float, per: int, used: NDArray[np.bool_]) -> Float:
    """Mean gradients (2·lenslets) [rad/m] of lenslets of `per` intervals a side: differences of the means of opposite edges."""
    weight = np.full(per + 1, 1.0 / per)
    weight[[0, -1]] *= 0.5  # the trapezoidal rule
    last = len(phase) - per
    down = np.tensordot(weight, np.stack([phase[i : i + last : per, ::per] for i in range(per + 1)]), axes=1)
    along = np.tensordot(weight, np.stack([phase[::per, i : i + last : per] for i in range(per + 1)]), axes=1)
    slopes = (np.diff(down, axis=1)[used] / PITCH_M, np.diff(along, axis=0)[used] / PITCH_M)
    return np.stack(slopes, axis=1).ravel()


@lru_cache(maxsize=4)
def _fitted(across: int, last: int, draws: int) -> tuple[Float, Float, NDArray[np.bool_]]:
    """Kolmogorov phases of D/r₀ = 1 (draws, samples) and their fits by modes 2 … `last` from slopes of `across` lenslets; the pupil
    (side, side) that holds the samples."""
    per = 4
    side = across * per
    plan = kolmogorov_plan(across * PITCH_M, (side + 1, side + 1), PITCH_M / per)
    middle = (np.arange(across) - 0.5 * (across - 1)) * PITCH_M
    x, y = np.meshgrid(middle, middle)
    radius = 0.5 * across * PITCH_M
    used = np.hypot(x, y) <= radius
    noll = range(2, last + 1)
    centre = np.stack([x[used], y[used]], axis=1)
    fit = np.linalg.pinv(mean_gradients(noll, centre, square(PITCH_M), radius).reshape(-1, last - 1))
    t = (np.arange(side) + 0.5) / (0.5 * side) - 1.0
    u, v = np.meshgrid(t, t)
    disc = np.hypot(u, v) <= 1.0
    modes = zernike(noll, u[disc], v[disc])
    rng = _rng(30, across, last)
    true, found = [], []
    for _ in range(draws):
        phase = plan.draw(rng)
        true.append((0.25 * (phase[1:, 1:] + phase[1:, :-1] + phase[:-1, 1:] + phase[:-1, :-1]))[disc])
        found.append((fit @ _edge_slopes(phase, per, used)) @ modes)
    return np.stack(true), np.stack(found), disc


def _without_tilt(phase: Float, disc: NDArray[np.bool_]) -> Float:
    """Phases (draws, samples) without mean and tilt, which only shift an image."""
    y, x = np.nonzero(disc)
    plane = np.stack([np.ones(x.size), x - x.mean(), y - y.mean()], axis=1)
    return np.asarray(phase - (phase @ np.linalg.pinv(plane).T) @ plane.T)


def share_of_peak_to_valley(modes: int, across: int = 20, draws: int = 60) -> float:
    """Mean peak-to-valley of the sum of modes up to Noll's index `modes` over that of the phase itself, turbulence alone."""
    true, found, _ = _fitted(across, modes, draws)
    return float((np.ptp(found, axis=1) / np.ptp(true, axis=1)).mean())


def _bars(side: int) -> Float:
    """An image of bars of three widths and a disc, 0 … 1."""
    x, y = np.meshgrid(np.arange(side), np.arange(side))
    image = np.zeros((side, side))
    for number, width in enumerate((8, 5, 3)):
        band = (y // (side // 4)) == number
        image[band & ((x // width) % 2 == 0)] = 1.0
    image[np.hypot(x - side // 2, y - 7 * side // 8) < side // 12] = 0.7
    return image


def _filled(values: Float, disc: NDArray[np.bool_]) -> Float:
    out = np.zeros(disc.shape)
    out[disc] = values
    return out


@lru_cache(maxsize=32)
def deblurring_gain_db(
    diameter_over_r0: float, ways: int, weight: float = 0.003, draws: int = 6, noise: float = 0.01
) -> tuple[float, float]:
    """(mean, its standard error) of the gain of PSNR [dB] by Eq. 32 as meant. The image is blurred by the phase itself, once
    through the water; H is that of the fit times `ways`: 1, or 2 for the mirror's wavefront as it is. 21 modes, 8 lenslets. Tilts
    are left out: they shift an image and do not blur it."""
    true, found, disc = _fitted(8, 21, 64)
    scale = diameter_over_r0 ** (5.0 / 6.0)
    true, found = scale * _without_tilt(true, disc), scale * _without_tilt(found, disc)
    image, pupil, gains = _bars(64), disc.astype(np.float64), []
    for n in range(draws):
        once = transfer_of(point_spread(_filled(true[n], disc), pupil), image.shape)
        known = transfer_of(point_spread(ways * _filled(found[n], disc), pupil), image.shape)
        seen = blurred_eq31(image, once, noise * _rng(32, n).standard_normal(image.shape))
        restored = deblur(seen, known, weight, tolerance=1e-3, iterations=100).image
        before, after = ((np.asarray(v) - image) ** 2 for v in (seen, restored))
        gains.append(10.0 * math.log10(float(before.mean() / after.mean())))
    return float(np.mean(gains)), float(np.std(gains, ddof=1) / math.sqrt(draws))
