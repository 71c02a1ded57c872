"""Failure rates of one estimator at one stress level, and their confidence bounds.

A *trial* is one capture: n elements, of which some failed, in one of four modes. The scenes of a suite are fixed; its seeds
are random. The rate of a level is the mean over scenes of the failed fraction over seeds,

    p = (1/S) Σ_s k_s/n_s,     var p = (1/S²) Σ_s φ p_s(1 − p_s)/n_s,

with p_s smoothed by half a failure, so that no scene has a variance of zero. φ ≥ 1 is the overdispersion: Pearson's χ² of
the trials about the rate of their scene, over its degrees of freedom, pooled over all levels (McCullagh and Nelder 1989,
sec. 4.5) and shrunk towards 1 with a weight of six degrees of freedom, as a few trials determine it poorly. It is near 1 if
elements fail independently, and near n if whole captures fail. Bounds are Wilson's (1927), with the effective number of elements
p(1 − p)/var p.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np

__all__ = ["MODES", "Dispersion", "Trial", "dispersion", "failure_rate", "mode_of", "rate_bounds"]

#: Modes of failure of an element: displaced in other seeds too; far off in this seed only; no valid value; no estimate.
MODES = ("bias", "outlier", "refusal", "crash")


#: Degrees of freedom of the prior φ = 1: elements fail independently until trials show otherwise.
_PRIOR_DF = 6.0


@dataclass(frozen=True)
class Trial:
    """One capture: `n` elements with truth, and how many of them failed in each mode."""

    scene: str
    seed: int
    n: int
    bias: int = 0
    outlier: int = 0
    refusal: int = 0
    crash: int = 0

    @property
    def failed(self) -> int:
        """Number of failed elements, over all modes."""
        return self.bias + self.outlier + self.refusal + self.crash


@dataclass(frozen=True)
class Dispersion:
    """Overdispersion φ of trials, and the degrees of freedom of its estimate (inf: known)."""

    phi: float
    df: float


def _by_scene(trials: Iterable[Trial]) -> dict[str, list[Trial]]:
    scenes: dict[str, list[Trial]] = {}
    for trial in trials:
        if trial.n > 0:
            scenes.setdefault(trial.scene, []).append(trial)
    return scenes


def dispersion(levels: Iterable[Sequence[Trial]]) -> Dispersion:
    """φ pooled over levels and scenes; 1 if no scene fails partially, or if there is only one seed."""
    chi2, df = _PRIOR_DF, _PRIOR_DF
    for trials in levels:
        for group in _by_scene(trials).values():
            total = sum(t.n for t in group)
            p = sum(t.failed for t in group) / total
            if len(group) > 1 and 0.0 < p < 1.0:
                chi2 += sum((t.failed - t.n * p) ** 2 / (t.n * p * (1.0 - p)) for t in group)
                df += len(group) - 1
    return Dispersion(max(chi2 / df, 1.0), df)


def failure_rate(trials: Iterable[Trial]) -> float:
    """Mean over scenes of the failed fraction; NaN without elements."""
    groups = _by_scene(trials).values()
    rates = [sum(t.failed for t in g) / sum(t.n for t in g) for g in groups]
    return float(np.mean(rates)) if rates else math.nan


def rate_bounds(trials: Iterable[Trial], spread: Dispersion, alpha: float) -> tuple[float, float]:
    """(lower, upper) bound of the failure rate, each wrong with probability `alpha`."""
    from scipy.stats import norm, t

    groups = list(_by_scene(trials).values())
    if not groups:
        return 0.0, 1.0
    p = failure_rate(trials := [trial for group in groups for trial in group])
    variance = 0.0
    for group in groups:
        n, failed = sum(trial.n for trial in group), sum(trial.failed for trial in group)
        smooth = (failed + 0.5) / (n + 1.0)
        variance += spread.phi * smooth * (1.0 - smooth) / n
    variance /= len(groups) ** 2
    total = sum(trial.n for trial in trials)
    middle = min(max(p, 0.5 / total), 1.0 - 0.5 / total)
    n_eff = min(middle * (1.0 - middle) / variance, total / spread.phi)
    z = float(norm.isf(alpha) if math.isinf(spread.df) else t.isf(alpha, spread.df))
    z2 = z * z
    centre = (p + z2 / (2 * n_eff)) / (1 + z2 / n_eff)
    half = z / (1 + z2 / n_eff) * math.sqrt(p * (1 - p) / n_eff + z2 / (4 * n_eff**2))
    return max(centre - half, 0.0), min(centre + half, 1.0)


def mode_of(trials: Iterable[Trial]) -> str:
    """The most frequent mode of failure, the more severe one of equals; "none" without failures."""
    counts = dict.fromkeys(MODES, 0)
    for trial in trials:
        for name in MODES:
            counts[name] += getattr(trial, name)
    worst = max(reversed(MODES), key=lambda name: counts[name])
    return worst if counts[worst] else "none"
