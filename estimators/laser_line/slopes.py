"""Slope and level of a power law with a noise floor: S(f) = A f^−γ + N.

Parameters of the fits are γ, ln A₁₀ and ln N, A₁₀ = A 10^−γ the density at 10 cycles/m [m³].
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

from ...optics.roughness import intrinsic_covariance
from .likelihoods import Fit, Terms, climb
from .periodograms import Spectra
from .profiles import Profile

__all__ = ["AT_PER_M", "SLOPES", "line_of_spectrum", "power_law_of_points", "power_law_of_spectrum"]

Float = npt.NDArray[np.float64]

#: Frequency at which levels are stated, cycles/m.
AT_PER_M = 10.0
#: Slopes that are searched; an answer at a limit is refused.
SLOPES = (1.05, 4.95)
#: Standard deviation of ln N about the stated noise: a factor of e² in variance either way.
_NOISE_PRIOR = 2.0
#: Half the step of the derivative by the slope.
_STEP = 1e-3


def line_of_spectrum(spectra: Spectra, first: int) -> Fit:
    """Least squares of ln S on ln(f/10) from the `first` frequency on: (γ, ln A₁₀), covariance by the scatter about the line."""
    u, y = np.log(spectra.frequency[first:] / AT_PER_M), np.log(spectra.power.mean(axis=0)[first:])
    basis = np.stack([-u, np.ones_like(u)], axis=1)
    inverse = np.linalg.inv(basis.T @ basis)
    place = inverse @ basis.T @ y
    left = y - basis @ place
    return Fit(place, inverse * float(left @ left) / (u.size - 2), bool(np.isfinite(place).all()))


def power_law_of_spectrum(spectra: Spectra, noise_m3: float, first: int, last: int) -> Fit:
    """Greatest likelihood of exponentially distributed powers (P. Whittle, Arkiv för Matematik 2:423, 1953), f[first … last − 1].

    ln L = −Σ over profiles and frequencies of [ln m + I/m], m = A f^−γ + N; information Σ ∂ln m ∂ln mᵀ. `noise_m3`: N as stated.
    """
    power = spectra.power[:, first:last]
    u = np.log(spectra.frequency[first:last] / AT_PER_M)

    def terms(place: Float) -> Terms:
        law, floor = np.exp(place[1] - place[0] * u), np.exp(place[2])
        mean = law + floor
        slope = np.stack([-u * law / mean, law / mean, np.broadcast_to(floor, u.shape) / mean])
        ratio = power / mean
        value = -float((np.log(mean) + ratio).sum())
        return Terms(value, (ratio - 1.0) @ slope.T, len(power) * (slope @ slope.T))

    stated = np.log(max(noise_m3, 1e-30))
    start = _start(spectra, first, last, stated)
    return climb(terms, start, *_limits(start), _prior(stated), spectra.spread)


def power_law_of_points(profiles: Sequence[Profile], start: tuple[float, float], aperture: float) -> Fit:
    """Greatest restricted likelihood of heights where they lie: no grid, no taper, no transform.

    Heights are Gaussian, with the generalised covariance of A f^−γ (`optics.roughness`), errors of variance N sigma² (here N is a
    factor, 1 as stated), and any straight line, which contrasts remove (P. K. Kitanidis, Water Resources Research 19:909, 1983).

    Main arguments:
        start: (γ, ln A₁₀). aperture: length over which a height is an average, in median intervals.
    """
    held = [_Contrasts(profile, aperture) for profile in profiles]

    def terms(place: Float) -> Terms:
        parts = [one.terms(place) for one in held]
        values, scores, informations = zip(*parts, strict=True)
        return Terms(float(sum(values)), np.array(scores), np.asarray(sum(informations)))

    first = np.array([np.clip(start[0], 1.3, 4.5), start[1], 0.0])
    return climb(terms, first, *_limits(first), _prior(0.0), 1.0)


class _Contrasts:
    """One profile less its straight line, by two reflections (Householder) of its heights and covariances."""

    def __init__(self, profile: Profile, aperture: float) -> None:
        self._at = profile.along - profile.along.mean()
        self._length = profile.length_m
        self._aperture = aperture * float(np.median(np.diff(profile.along)))
        basis = np.stack([np.ones_like(self._at), self._at], axis=1)
        self._mirrors: list[Float] = []
        for column in range(2):
            x = basis[:, column].copy()
            x[:column] = 0.0
            x[column] += np.copysign(np.linalg.norm(x), x[column])
            mirror = x / np.linalg.norm(x)
            basis -= 2.0 * np.outer(mirror, mirror @ basis)
            self._mirrors.append(mirror)
        self._height = self._turned(profile.height - profile.height.mean())
        self._noise = self._both(np.diag(profile.sigma**2))

    def _turned(self, value: Float) -> Float:
        for mirror in self._mirrors:
            value = value - 2.0 * np.multiply.outer(mirror, mirror @ value)
        return value[2:]

    def _both(self, matrix: Float) -> Float:
        return self._turned(self._turned(matrix).T)

    def _law(self, slope: float) -> Float:
        """Covariance of the contrasts for a density of 1 m³ at 10 cycles/m."""
        lag = self._at[:, None] - self._at[None, :]
        return self._both(AT_PER_M**slope * intrinsic_covariance(lag, slope, self._length, self._aperture))

    def terms(self, place: Float) -> tuple[float, Float, Float]:
        """Log likelihood, score (3) and information (3, 3) at γ, ln A₁₀, ln N."""
        from scipy.linalg import cho_factor, cho_solve

        level, floor = np.exp(place[1]), np.exp(place[2])
        law, noise = level * self._law(place[0]), floor * self._noise
        bent = level * (self._law(place[0] + _STEP) - self._law(place[0] - _STEP)) / (2.0 * _STEP)
        factor = cho_factor(law + noise, lower=True)
        inverse = cho_solve(factor, np.eye(len(law)))
        weight = inverse @ self._height
        value = -float(np.log(np.diag(factor[0])).sum()) - 0.5 * float(self._height @ weight)
        parts = (inverse @ bent, inverse @ law, inverse @ noise)
        score = np.array(
            [0.5 * float(weight @ d @ weight - np.trace(p)) for d, p in zip((bent, law, noise), parts, strict=True)]
        )
        information = np.array([[0.5 * float((p * q.T).sum()) for q in parts] for p in parts])
        return value, score, information


def _start(spectra: Spectra, first: int, last: int, stated: float) -> Float:
    """From the line through the lower half of the band, where the noise matters least."""
    half = Spectra(spectra.frequency[: max((first + last) // 2, first + 4)], spectra.power, spectra.spread)
    half = Spectra(half.frequency, spectra.power[:, : half.frequency.size], spectra.spread)
    line = line_of_spectrum(half, first).place
    return np.array([np.clip(line[0], 1.3, 4.5), line[1], stated])


def _limits(start: Float) -> tuple[Float, Float]:
    low, high = start - 20.0, start + 20.0
    low[0], high[0] = SLOPES
    return low, high


def _prior(stated: float) -> tuple[Float, Float]:
    return np.array([0.0, 0.0, stated]), np.array([0.0, 0.0, _NOISE_PRIOR**-2])
