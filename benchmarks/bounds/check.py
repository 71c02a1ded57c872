"""The bounds against simulated estimators, from below the threshold to above it.

    python -m beambench.benchmarks.bounds.check

Gaussian response of σ_R = 1, delays every .4, Poisson samples, uniform prior over the window. Columns: photoelectrons of
the echo; then in units of σ_R the Cramér-Rao bound (root mean over the window's middle half), Ziv-Zakai, its tight form,
the Bayesian bound; simulated rms errors over the Bayesian bound (posterior mean) and over Ziv-Zakai (both estimators);
the share of delays in the middle half marked regular, and maximum likelihood's rms error there over the Cramér-Rao bound.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import numpy.typing as npt

from .bayes import posterior_bound
from .ziv_zakai import curvature, local_bound

__all__ = ["gaussian_stack", "threshold_row"]

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


def _errors(mu: Float, step: float, draws: int, seed: int) -> tuple[Float, Float, npt.NDArray[np.intp]]:
    """Errors of the posterior's mean and of its maximum (parabola through the top), and the true indices."""
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


def threshold_row(window: float, photons: float, background: float, *, draws: int = 8000) -> dict[str, float]:
    """One line of the table."""
    points = 1 + 30 * math.ceil(window)
    made = gaussian_stack(window, photons, background, points)
    found = local_bound(**made)
    bayes = posterior_bound(made["mu"], made["step"], draws=draws // 2, seed=2)
    mean, maximum, truth = _errors(made["mu"], made["step"], draws, 5)
    middle = np.zeros(points, bool)
    middle[points // 4 : points - points // 4] = True
    chosen = (middle & found.regular)[truth]
    rms = {"mean": float(np.sqrt((mean**2).mean())), "maximum": float(np.sqrt((maximum**2).mean()))}
    return {
        "photons": photons, "crb": float(np.sqrt((found.crb[middle] ** 2).mean())), "ziv_zakai": found.mean,
        "tight": bayes.tight, "bayes": bayes.mmse, "mean/bayes": rms["mean"] / bayes.mmse,
        "mean/zz": rms["mean"] / found.mean, "ml/zz": rms["maximum"] / found.mean,
        "regular": float(found.regular[middle].mean()),
        "ml/crb": float(np.sqrt(((maximum / found.crb[truth])[chosen] ** 2).mean())) if chosen.any() else math.nan,
    }  # fmt: skip


def main() -> int:
    """Print the table for three windows and two backgrounds."""
    for window in (4.0, 8.0, 16.0):
        for background in (0.05, 1.0):
            print(f"window {window:g} σ_R, background {background:g} per slice")
            for number, photons in enumerate(_PHOTONS):
                row = threshold_row(window, photons, background)
                if number == 0:
                    print("".join(f"{name:>11}" for name in row))
                print("".join(f"{value:11.4g}" for value in row.values()), flush=True)
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
