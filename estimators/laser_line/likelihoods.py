"""The greatest likelihood of few parameters by Fisher scoring, and the uncertainty of its place over profiles."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

__all__ = ["Fit", "Terms", "climb"]

Float = npt.NDArray[np.float64]

_MOST_STEPS = 40
#: A step below this share of a standard error ends the search.
_ENOUGH = 0.02
#: Profiles beyond which neighbours are taken to be independent: 4 (n/100)^(2/9) of them, as a rule (Newey and West 1994).
_LAGS = 4.0


@dataclass(frozen=True, eq=False)
class Terms:
    """A log likelihood at one place: its value, the `score` of every profile (profile, parameter), the expected `information`."""

    value: float
    score: Float
    information: Float


@dataclass(frozen=True, eq=False)
class Fit:
    """`place` of the greatest likelihood, its `covariance`, and whether it was found within the limits."""

    place: Float
    covariance: Float
    found: bool


def climb(
    terms: Callable[[Float], Terms], start: Float, low: Float, high: Float, prior: tuple[Float, Float], spread: float
) -> Fit:
    """Fisher scoring with damping, within low … high.

    Main arguments:
        prior: (mean, precision) of a Gaussian prior, of precision 0 where there is none.
        spread: by how much the variance exceeds that of the information.

    The covariance is the larger, parameter by parameter, of spread·J⁻¹ and of J⁻¹ B J⁻¹, B the variance of the scores' sum over the
    profiles, neighbours included (W. K. Newey and K. D. West, Econometrica 55:703, 1987): profiles of a slow vehicle are alike.
    """
    mean, precision = prior
    at = np.clip(start, low, high)
    now, damping, found = terms(at), 1e-3, False
    last = np.zeros_like(at)
    for _ in range(_MOST_STEPS):
        gradient = now.score.sum(axis=0) - precision * (at - mean)
        curvature = now.information + np.diag(precision)
        step = np.linalg.solve(curvature + damping * np.diag(np.diag(curvature)), gradient)
        new = np.clip(at + step, low, high)
        moved = float((new - at) @ curvature @ (new - at))
        after = terms(new)
        if _penalised(after, new, mean, precision) >= _penalised(now, at, mean, precision) - 1e-9:
            # Steps to and fro about the place of rest are halved: the expected information may be less than that of the data.
            turned = float((new - at) @ curvature @ last) < 0
            damping = max(2.0 * damping, 1.0) if turned else max(damping / 10.0, 1e-9)
            last, at, now = new - at, new, after
            if moved < _ENOUGH**2:
                found = True
                break
        elif damping > 1e6:
            break
        else:
            damping *= 10.0
    found = found and bool(((at > low) & (at < high)).all())
    return Fit(at, _covariance(now, precision, spread), found)


def _penalised(terms: Terms, at: Float, mean: Float, precision: Float) -> float:
    return terms.value - 0.5 * float(precision @ (at - mean) ** 2)


def _covariance(terms: Terms, precision: Float, spread: float) -> Float:
    inverse = np.linalg.inv(terms.information + np.diag(precision))
    count = len(terms.score)
    score = terms.score - terms.score.mean(axis=0)
    lags = min(int(_LAGS * (count / 100.0) ** (2.0 / 9.0)), count - 1)
    middle = score.T @ score
    for lag in range(1, lags + 1):
        part = score[lag:].T @ score[:-lag]
        middle += (1.0 - lag / (lags + 1.0)) * (part + part.T)
    middle *= count / max(count - 1.0, 1.0)
    robust = inverse @ middle @ inverse
    model = spread * inverse
    grown = np.sqrt(np.maximum(np.diag(robust) / np.diag(model), 1.0))
    return np.asarray(model * np.outer(grown, grown))
