"""The bounds against simulated estimators, from below the threshold to above it.

    python -m beambench.benchmarks.checks.bounds

Gaussian, or rectangular (pulse 1, gate 3: a trapezoid), response of σ_R = 1, delays every .4, Poisson samples, uniform
prior over the window. Columns: photoelectrons of the echo; then in units of σ_R the Cramér-Rao bound (root mean square
over the middle half of the window, infinite where a delay carries no information), the pairwise Ziv-Zakai bound, the
M-ary one (all delays h apart at once), the limit of that family, and the Bayesian bound. Then ratios of simulated rms
errors: of the posterior mean to the Bayesian bound, to the limit of the family and to the Ziv-Zakai bound, and of maximum
likelihood to the Bayesian bound; the share of regular delays in the middle half, and the rms error of maximum likelihood
there over the Cramér-Rao bound.

The posterior mean attains the Bayesian bound, so no rms error is below it. Where `mean/tight` is above 1.1 no bound of the
Ziv-Zakai family is within 10 % of the attainable error.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import numpy.typing as npt

from ..bounds.bayes import posterior_bound
from ..bounds.ziv_zakai import curvature, local_bound

__all__ = ["gaussian_stack", "rectangular_stack", "threshold_row"]

Float = npt.NDArray[np.float64]

_STEP = 0.4
_PHOTONS = (0.5, 1.0, 2.0, 4.0, 8.0, 12.0, 16.0, 20.0, 24.0, 32.0, 48.0, 64.0, 128.0, 256.0)


def gaussian_stack(
    window: float, photons: float, background: float, points: int, margin: float = 0.0
) -> dict[str, Any]:
    """Arguments of `local_bound`: means (θ, slice), √F, step, width and γ², for an echo of `photons` over all slices and
    `background` per slice; slices reach `margin` beyond the window."""
    delay = np.arange(-margin, window + margin + 1e-9, _STEP)
    theta = np.linspace(0.0, window, points)
    u = theta[:, None] - delay
    signal = photons * _STEP / math.sqrt(2.0 * math.pi) * np.exp(-0.5 * u**2)
    mu = signal + background
    first, second = -u * signal, (u**2 - 1.0) * signal
    root = np.sqrt((first**2 / mu).sum(axis=1))
    return {
        "mu": mu, "slope": root, "step": float(theta[1]), "width": 1.0, "bend": curvature(mu, first, second, 1.0 / mu),
    }  # fmt: skip


def rectangular_stack(window: float, photons: float, background: float, points: int) -> dict[str, Any]:
    """As `gaussian_stack`, R a trapezoid of base 4 and top 2 before scaling to σ_R = 1."""
    scale = 1.0 / math.sqrt((1.0**2 + 3.0**2) / 12.0)
    delay = np.arange(0.0, window + 1e-9, _STEP)
    theta = np.linspace(0.0, window, points)
    u = np.abs(theta[:, None] - delay) / scale
    signal = photons * _STEP / (3.0 * scale) * np.clip(2.0 - u, 0.0, 1.0)
    first = np.where((u > 1.0) & (u < 2.0), -np.sign(theta[:, None] - delay), 0.0)
    first *= photons * _STEP / (3.0 * scale**2)
    mu = signal + background
    return {
        "mu": mu, "slope": np.sqrt((first**2 / mu).sum(axis=1)), "step": float(theta[1]), "width": 1.0, "bend": 0.0,
    }  # fmt: skip


_STACKS = {"gaussian": gaussian_stack, "rectangular": rectangular_stack}


def _errors(mu: Float, step: float, draws: int, seed: int) -> tuple[Float, Float, npt.NDArray[np.intp]]:
    """Errors of the posterior mean and of the posterior maximum (parabola through the top), and the true indices."""
    rng = np.random.Generator(np.random.PCG64(seed))
    truth = (np.arange(draws) * mu.shape[0]) // draws
    mean, maximum = np.empty(draws), np.empty(draws)
    theta = step * np.arange(mu.shape[0])
    for first in range(0, draws, 500):
        at = truth[first : first + 500]
        y = rng.poisson(mu[at])
        like = y @ np.log(mu).T - mu.sum(axis=1)
        weight = np.exp(like - like.max(axis=1)[:, None])
        mean[first : first + 500] = (weight @ theta) / weight.sum(axis=1) - theta[at]
        best = like.argmax(axis=1)
        inner, rows = best.clip(1, mu.shape[0] - 2), np.arange(at.size)
        left, top, right = (like[rows, inner + k] for k in (-1, 0, 1))
        bend = np.minimum(left - 2.0 * top + right, -1e-12)
        shift = np.where(inner == best, np.clip(0.5 * (left - right) / bend, -0.5, 0.5), 0.0)
        maximum[first : first + 500] = step * (best + shift) - theta[at]
    return mean, maximum, truth


def threshold_row(
    window: float, photons: float, background: float, *, draws: int = 8000, response: str = "gaussian"
) -> dict[str, float]:
    """One line of the table."""
    points = 1 + 30 * math.ceil(window)
    made = _STACKS[response](window, photons, background, points)
    found = local_bound(**made)
    bayes = posterior_bound(made["mu"], made["step"], draws=draws // 2, seed=2)
    mean, maximum, truth = _errors(made["mu"], made["step"], draws, 5)
    middle = np.zeros(points, bool)
    middle[points // 4 : points - points // 4] = True
    chosen = (middle & found.regular)[truth]
    rms = {"mean": float(np.sqrt((mean**2).mean())), "maximum": float(np.sqrt((maximum**2).mean()))}
    with np.errstate(divide="ignore", invalid="ignore"):
        crb = float(np.sqrt((found.crb[middle] ** 2).mean()))
        regular = float(found.regular[middle].mean())
        over = np.where(chosen, maximum / found.crb[truth], 0.0)
    return {
        "photons": photons, "crb": crb, "ziv_zakai": found.mean, "m_ary": bayes.m_ary, "tight": bayes.tight,
        "bayes": bayes.mmse, "mean/bayes": rms["mean"] / bayes.mmse, "mean/tight": rms["mean"] / bayes.tight,
        "mean/m_ary": rms["mean"] / bayes.m_ary, "mean/zz": rms["mean"] / found.mean,
        "ml/bayes": rms["maximum"] / bayes.mmse, "regular": regular,
        "ml/crb": float(np.sqrt((over[chosen] ** 2).mean())) if chosen.any() else math.nan,
    }  # fmt: skip


def main() -> int:
    """Print the table for two responses, three windows and two backgrounds."""
    for response in _STACKS:
        for window in (4.0, 8.0, 16.0):
            for background in (0.05, 1.0):
                print(f"{response} response, window {window:g} σ_R, background {background:g} per slice")
                for number, photons in enumerate(_PHOTONS):
                    row = threshold_row(window, photons, background, response=response)
                    if number == 0:
                        print("".join(f"{name:>11}" for name in row))
                    print("".join(f"{value:11.4g}" for value in row.values()), flush=True)
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
