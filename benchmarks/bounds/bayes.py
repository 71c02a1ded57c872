"""Bayesian bounds on the delay of an echo in a gated stack, exact through the threshold, by simulated posteriors.

Prior: uniform over the grid of delays, amplitude and background known. With the posterior p(θ|y) of many simulated
stacks,

    mmse² = E var(θ|y)                                       the smallest mean square error of any estimator, attained
                                                             by the posterior mean;
    tight² = ∫₀^W (h/2) [1 − E max_c ∫_{c−h/2}^{c+h/2} p(θ|y) dθ] dh,
    m_ary² = ∫₀^W (h/2) V{ 1 − E ∫₀^h max_k p(φ+kh|y) dφ } dh,

all three by the identity ε² = ∫ (h/2) P(abs(error) >= h/2) dh of Ziv and Zakai. In `m_ary`, P is the least error of a
decision between all delays φ + kh of the window; these sets divide the prior, each delay being in one of them, so that the
factor 1/(M−1) of the bound of Bell et al. is absent and M is as large as the window allows. In `tight`, P is the least value
that any decision rule attains at that h. Hence ziv_zakai <= m_ary <= tight <= mmse (the first inequality by the choice of h,
with M = 2 only where pairs decide), and `tight` is the limit of every bound of this family. In the threshold of wide windows
it is up to a third below mmse. There no Ziv-Zakai bound equals the error of the best estimator, since the best rule differs
from h to h. The maximum of the likelihood is not the best estimate below threshold: without a visible echo its error is
W/√6, that of the posterior mean W/√12.

Source: H. L. Van Trees, Detection, Estimation, and Modulation Theory I, 1968, sec. 2.4; K. L. Bell, Y. Steinberg,
Y. Ephraim and H. L. Van Trees, IEEE Trans. Inf. Theory 43:624, 1997 (identity, M hypotheses, valley filling).
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

__all__ = ["PosteriorBound", "posterior_bound", "posterior_square"]

Float = npt.NDArray[np.float64]

_BLOCK = 512


@dataclass(frozen=True)
class PosteriorBound:
    """`mmse`, its standard error from the simulation (`error`), `tight` and `m_ary`, in the unit of the grid's step;
    `maximum`: rms error of the posterior's maximum on the same draws. `tight` and `m_ary` are NaN if not requested."""

    mmse: float
    error: float
    tight: float
    m_ary: float
    maximum: float


def posterior_bound(
    mu: npt.ArrayLike, step: float, *, draws: int = 4000, seed: int = 1, family: bool = True
) -> PosteriorBound:
    """Bounds from simulated stacks and their posteriors.

    Main arguments:
        mu (θ, slice): means > 0 of Poisson samples on a uniform grid of delays that spans the window. Read noise is included
        as a shifted Poisson distribution: add σ² to every mean. step: step of the grid, which must resolve the posterior (a
        third of the Cramér-Rao bound or finer).
    Other arguments:
        draws: number of stacks, with delays spread uniformly over the grid. seed: random seed of the draws. family: whether
        to compute `tight` and `m_ary`, which cost more than `mmse`.
    Raises ValueError for means that are not positive.
    """
    mean = np.asarray(mu, np.float64)
    if mean.ndim != 2 or not np.all(mean > 0.0):
        raise ValueError("mu must be (θ, slice) and positive")
    n = mean.shape[0]
    rng = np.random.Generator(np.random.PCG64(seed))
    truth = (np.arange(draws) * n) // draws
    theta = step * np.arange(n)
    log_mean, total = np.log(mean).T, mean.sum(axis=1)
    # Window widths h in grid steps: all widths up to 24 steps, then sparser up to the largest.
    widths = np.unique(np.concatenate([np.arange(1, min(25, n)), np.geomspace(1, n - 1, 40).astype(int)]))
    variance, square = np.empty(draws), np.empty(draws)
    outside, lattice = np.zeros(widths.size), np.zeros(widths.size)
    for first in range(0, draws, _BLOCK):
        at = truth[first : first + _BLOCK]
        y = rng.poisson(mean[at]).astype(np.float64)
        logs = y @ log_mean - total
        logs -= logs.max(axis=1, keepdims=True)
        p = np.exp(logs)
        p /= p.sum(axis=1, keepdims=True)
        centre = p @ theta
        variance[first : first + at.size] = np.maximum(p @ theta**2 - centre**2, 0.0)
        square[first : first + at.size] = (theta[logs.argmax(axis=1)] - theta[at]) ** 2
        if not family:
            continue
        mass = np.concatenate([np.zeros((at.size, 1)), np.cumsum(p, axis=1)], axis=1)
        for k, width in enumerate(widths):
            outside[k] += (1.0 - (mass[:, width:] - mass[:, :-width]).max(axis=1)).sum()
            lattice[k] += _decided_wrong(p, int(width))
    mmse = math.sqrt(float(variance.mean()))
    spread = float(variance.std(ddof=1)) / math.sqrt(draws) / (2.0 * mmse) if mmse > 0 else 0.0
    maximum = math.sqrt(float(square.mean()))
    if not family:
        return PosteriorBound(mmse, spread, math.nan, math.nan, maximum)
    # A window of w grid points contains errors below w·step/2; delays w points apart are distinguished at h = w·step.
    h = np.concatenate([[0.0], widths * step, [n * step]])
    miss = np.concatenate([[1.0], outside / draws, [0.0]])
    wrong = np.maximum.accumulate(np.concatenate([[1.0], lattice / draws, [0.0]])[::-1])[::-1]
    tight, m_ary = (math.sqrt(float(np.trapezoid(0.5 * h * chance, h))) for chance in (miss, wrong))
    return PosteriorBound(mmse, spread, tight, m_ary, maximum)


def posterior_square(mu: npt.ArrayLike, step: float, truth: npt.NDArray[np.intp], *, seed: int = 1) -> Float:
    """w·(E[θ|y] − θ)² of one simulated stack per true index in `truth` (draw); other arguments as for `posterior_bound`.

    The mean over stacks of one true delay is the contribution of that delay to the least mean square error; its mean over
    delays is mmse². The mean of var(θ|y) has the same mean over delays, but not the same contribution of each: inside the
    window the posterior variance exceeds the squared error, as the posterior also allows rare echoes just outside; at the
    ends of the window it is smaller. Every other stack is drawn halfway (with the geometric mean of the means) to a delay
    spread uniformly over the window, and w = p(y|θ)/q(y) with q half of p and half of the mean of those densities, so that
    w <= 2. Therefore wrong cells with a probability of 10⁻⁴, which contribute 10⁴ times the variance of the rest, are half of
    the draws, not one stack in 10⁴; otherwise the bound would be zero or a hundred times too high there. Neighbours in
    `truth` should be close to each other.
    Source: A. Owen and Y. Zhou, J. Am. Stat. Assoc. 95:135, 2000 (mixtures with a defensive part).
    """
    mean = np.asarray(mu, np.float64)
    rng = np.random.Generator(np.random.PCG64(seed))
    points = mean.shape[0]
    theta = step * np.arange(points)
    log_mean, total, root = np.log(mean).T, mean.sum(axis=1), np.sqrt(mean)
    other = ((np.arange(truth.size) + 0.5) * (math.sqrt(5.0) - 1.0) / 2.0 % 1.0 * points).astype(np.intp)
    other[::2] = truth[::2]
    out = np.empty(truth.size)
    for first in range(0, truth.size, _BLOCK):
        at, toward = truth[first : first + _BLOCK], other[first : first + _BLOCK]
        rows = np.arange(at.size)
        plain = rng.poisson(root[at] * root[toward]) @ log_mean
        logs = plain - total
        # ln of (density drawn halfway to each delay)/(density of the true one).
        drawn = 0.5 * (plain - plain[rows, at][:, None]) - root[at] @ root.T + total[at][:, None]
        highest = np.maximum(drawn.max(axis=1), 0.0)
        even = np.exp(drawn - highest[:, None]).mean(axis=1)
        weight = 2.0 * np.exp(-highest) / (np.exp(-highest) + even)
        p = np.exp(logs - logs.max(axis=1, keepdims=True))
        p /= p.sum(axis=1, keepdims=True)
        out[first : first + at.size] = weight * (p @ theta - theta[at]) ** 2
    return out


def _decided_wrong(p: Float, width: int) -> float:
    """Σ over draws of 1 − Σ_r max_k p(r + k·width | y): the residues r divide the delays into sets, with one decision each.
    Any window of `width` delays contains one delay of each set, so that this is at most the miss of the best window."""
    rows = -(-p.shape[1] // width)
    padded = np.zeros((p.shape[0], rows * width))
    padded[:, : p.shape[1]] = p
    return float(p.shape[0] - padded.reshape(p.shape[0], rows, width).max(axis=1).sum())
