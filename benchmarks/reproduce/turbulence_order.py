"""Does one frame per setting show the printed order of Figures 13 to 16? A Monte Carlo of reconstructed frames.

Slopes that lenslets average are Gaussian, s ~ N(0, 4 r₀^{−5/3} C/k²) behind a mirror (the phase counts twice), with the C of
`optics.turbulence.slopes` and a reading error of each spot; the least squares of Zernike modes give the wavefront (Eq. 30). Frames
are independent. A figure has four frames, of settings whose strength rises; what is found is how often four draws, one per setting,
rise too. Without any trend they do in 1 of 4! = 24 figures.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from ...optics.lenslets.gradients import mean_gradients, square
from ...optics.turbulence.flow import table_r0_m
from ...optics.turbulence.slopes import gradient_covariance
from ...optics.turbulence.strength import kolmogorov_structure
from ...optics.zernike import zernike

__all__ = [
    "BY_FLOW", "BY_RANGE", "CHANCE", "FOCAL_M", "PITCH_M", "PIXEL_M", "WAVELENGTH_M", "Reading", "chance_of_order", "even",
    "frames_needed", "readings", "stepped", "values",
]  # fmt: skip

Float = NDArray[np.float64]

#: Printed in section 6.3.
WAVELENGTH_M, FOCAL_M, PITCH_M, PIXEL_M = 532e-9, 6.7e-3, 150e-6, 17.8e-6
#: Four values in a given order, all orders being alike.
CHANCE = 1.0 / math.factorial(4)
#: r₀ [m] of one pass at 1, 2, 3, 4 m with 40 L/min, and with 10 to 40 L/min at 4 m: our table, nobody's measurement.
BY_RANGE = tuple(float(v) for v in table_r0_m(40.0, [1.0, 2.0, 3.0, 4.0]))
BY_FLOW = tuple(float(v) for v in table_r0_m([10.0, 20.0, 30.0, 40.0], 4.0))
#: Frames drawn per setting, and figures drawn from them: a chance has a standard error of about .01.
_FRAMES, _FIGURES = 1000, 4000


@dataclass(frozen=True)
class Reading:
    """How a figure is made and read; the document gives none of these.

    across: lenslets across the round pupil. modes: greatest Noll index of Eq. 30. spot_px: reading error of a spot, standard
    deviation. tilt: whether the mean slope is left in. what: "peak-to-valley" or "rms" of the reconstructed phase [rad], or
    "spots", the rms displacement of spots [px].
    """

    across: int = 20
    modes: int = 66
    spot_px: float = 0.015
    tilt: bool = True
    what: str = "peak-to-valley"


def readings(what: str) -> tuple[Reading, ...]:
    """The plausible readings of one kind: few and many lenslets and modes, ample light and little, with the mean slope or not."""
    return tuple(
        Reading(across, modes, spot_px, tilt, what)
        for across, modes in ((8, 15), (20, 66))
        for spot_px in (0.015, 0.15)
        for tilt in (True, False)
    )


@dataclass(frozen=True, eq=False)
class _Sensor:
    """root (values, values): of the covariance of slopes [rad] for r₀ = 1 m of one pass, mirrored. fit (modes, values): phase
    coefficients [rad] from slopes. noise (modes, modes): root of the covariance of coefficients for slopes of unit error. surface
    (modes, samples). lenslets."""

    root: Float
    fit: Float
    noise: Float
    surface: Float
    lenslets: int


@lru_cache(maxsize=2)
def _sensor(across: int, modes: int) -> _Sensor:
    middle = (np.arange(across) - 0.5 * (across - 1)) * PITCH_M
    x, y = (a.ravel() for a in np.meshgrid(middle, middle))
    radius = 0.5 * across * PITCH_M
    inside = np.hypot(x, y) <= radius
    centre = np.stack([x[inside], y[inside]], axis=1)
    k = 2.0 * math.pi / WAVELENGTH_M
    covariance = 4.0 * gradient_covariance(lambda d: kolmogorov_structure(d, 1.0), centre, PITCH_M) / k**2
    noll = range(2, modes + 1)
    slope = mean_gradients(noll, centre, square(PITCH_M), radius).reshape(-1, modes - 1) / k
    fit: Float = np.asarray(np.linalg.pinv(slope), np.float64)
    t = (np.arange(2 * across) + 0.5) / across - 1.0
    u, v = (a.ravel() for a in np.meshgrid(t, t))
    disc = np.hypot(u, v) <= 1.0
    root = np.asarray(np.linalg.cholesky(covariance + 1e-9 * covariance[0, 0] * np.eye(len(covariance))))
    return _Sensor(root, fit, np.asarray(np.linalg.cholesky(fit @ fit.T)), zernike(noll, u[disc], v[disc]), len(centre))


@lru_cache(maxsize=2)
def _unit_draws(across: int, modes: int) -> tuple[Float, Float]:
    """Slopes [rad] of frames for r₀ = 1 m (frames, values), and their coefficients [rad] (frames, modes)."""
    sensor = _sensor(across, modes)
    rng = np.random.default_rng(np.random.SeedSequence(0, spawn_key=(13, across, modes)))
    slopes = rng.standard_normal((_FRAMES, len(sensor.root))) @ sensor.root.T
    return slopes, slopes @ sensor.fit.T


def values(reading: Reading, r0_m: float, setting: int) -> Float:
    """What is read off each of 1,000 frames at r₀ [m] of one pass, in rad or px. Frames of another `setting` are other frames."""
    sensor = _sensor(reading.across, reading.modes)
    slopes, coefficients = _unit_draws(reading.across, reading.modes)
    scale = r0_m ** (-5.0 / 6.0)
    rng = np.random.default_rng(np.random.SeedSequence(0, spawn_key=(14, setting)))
    order = rng.permutation(_FRAMES)
    per_px = PIXEL_M / FOCAL_M
    if reading.what == "spots":
        moved = scale * slopes[order].reshape(_FRAMES, -1, 2) / per_px
        if not reading.tilt:
            moved = moved - moved.mean(axis=1, keepdims=True)
        # Errors along the vector of displacements, and the others, of which only the length counts.
        others = 2 * sensor.lenslets - 1 - (0 if reading.tilt else 2)
        along = np.sqrt((moved**2).sum(axis=(1, 2))) + reading.spot_px * rng.standard_normal(_FRAMES)
        square_px = along**2 + reading.spot_px**2 * rng.chisquare(others, _FRAMES)
        return np.asarray(np.sqrt(square_px / sensor.lenslets))
    error = rng.standard_normal(coefficients.shape) @ sensor.noise.T
    found = scale * coefficients[order] + reading.spot_px * per_px * error
    first = 0 if reading.tilt else 2
    if reading.what == "rms":
        return np.asarray(np.sqrt((found[:, first:] ** 2).sum(axis=1)))
    surface = found[:, first:] @ sensor.surface[first:]
    if reading.what == "ratio":
        return np.asarray(surface.max(axis=1) / np.abs(surface.min(axis=1)))
    return np.asarray(np.ptp(surface, axis=1))


@lru_cache(maxsize=256)
def _pool(reading: Reading, r0_m: tuple[float, ...]) -> Float:
    return np.stack([values(reading, r0, number) for number, r0 in enumerate(r0_m)])


def chance_of_order(reading: Reading, r0_m: tuple[float, ...], frames: int = 1) -> float:
    """Share of figures whose values, means over `frames` frames per setting, rise from each setting of r₀ to the next."""
    pool = _pool(reading, r0_m)
    rng = np.random.default_rng(np.random.SeedSequence(0, spawn_key=(15, frames)))
    shown = np.stack([row[rng.integers(0, _FRAMES, (_FIGURES, frames))].mean(axis=1) for row in pool])
    return float((np.diff(shown, axis=0) > 0.0).all(axis=0).mean())


def frames_needed(reading: Reading, r0_m: tuple[float, ...], wanted: float = 0.95) -> int:
    """The least number of frames per setting whose means rise in `wanted` of all figures; by doubling and bisection.

    Raises ValueError where 4,096 frames are not enough."""
    high = 1
    while chance_of_order(reading, r0_m, high) < wanted:
        high *= 2
        if high > 4096:
            raise ValueError("more than 4,096 frames are needed")
    low = high // 2
    while high - low > 1:
        middle = (low + high) // 2
        low, high = (low, middle) if chance_of_order(reading, r0_m, middle) >= wanted else (middle, high)
    return high


def even(r0_m: float = BY_RANGE[3]) -> tuple[float, ...]:
    """r₀ [m] at 1, 2, 3 and 4 m where turbulence is the same all along the tank, `r0_m` at 4 m: r₀^{−5/3} grows as the path."""
    return tuple(r0_m * (r / 4.0) ** -0.6 for r in (1.0, 2.0, 3.0, 4.0))


def stepped(ratio: float, last_m: float = BY_FLOW[3]) -> tuple[float, ...]:
    """r₀ [m] of four settings, each `ratio` times shorter than the one before; the last as short as at 40 L/min and 4 m."""
    return tuple(last_m * ratio ** (3 - n) for n in range(4))
