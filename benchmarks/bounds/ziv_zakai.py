"""Ziv-Zakai bound on the delay of an echo in a gated stack, with a uniform prior over a window of width W.

A delay estimator also decides between θ and θ + h, and its error rate is at least that of the best test:

    ε² >= (1/W) ∫₀^W h V{ ∫ P(θ, θ+h) dθ } dh,        V f(h) = max_{ξ>=0} f(h + ξ) (valley filling).

P is the least error of a decision between two equally likely stacks of known means. The bound takes amplitude and background
as known (this can only reduce the error, so that it also bounds the profiled problem). Far above threshold ε is the Cramér-Rao
bound, far below it the error of the prior, W/√12. ε² is also the mean over the window of

    ε²(θ) = ½ ∫ h [P(θ, θ+h) + P(θ, θ−h)] dh,        pairs within the window only,

which shows *where* a delay is regular; ε(θ) itself is not a bound, only its mean is.

P = Q(d/2), d² = Σ_k (v(μ_k(θ)) − v(μ_k(θ')))², v(μ) = ∫ √J dμ: the length, per sample, in the Fisher metric of its exact
likelihood. For h → 0 this is the exact Fisher information; for Poisson samples v = 2√μ, and d²/8 is the Bhattacharyya
exponent, exact for any pair. `poisson_error` is the saddlepoint value with which tests compare it.

The bound compares two delays at a time, an estimator many. With c cells of width σ_R its probability of a wrong cell is up to
c times that of the test, so that in the threshold region of a wide window the bound is too low (see `bayes` for a tight one).

Source: J. Ziv and M. Zakai, IEEE Trans. Inf. Theory 15:386, 1969; K. L. Bell et al., IEEE Trans. Inf. Theory 43:624, 1997.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from ...optics.likelihood.fisher_table import InformationTable

__all__ = [
    "REACHED", "REGULAR", "Arc", "LocalBound", "curvature", "distances", "local_bound", "poisson_error", "ziv_zakai",
]  # fmt: skip

Float = npt.NDArray[np.float64]


class Arc:
    """v(μ) = ∫₀^μ √J(m) dm, tabulated over ln μ; v = 2√μ for Poisson samples (`Arc()`), otherwise from the table of a likelihood.

    Below the first node of the table √J is taken as constant (as it is with read noise); above the last, where the sample is
    saturated, v is constant.
    """

    def __init__(self, table: InformationTable | None = None) -> None:
        self._log: Float | None = None
        if table is None:
            return
        # Simpson's rule on the nodes of the spline, refined three times.
        x = np.linspace(table.log_mu[0], table.log_mu[-1], 8 * table.log_mu.size + 1)
        mu = np.exp(x)
        rate = np.sqrt(table(mu)) * mu
        self._log = x
        middle = 0.5 * (x[1:] + x[:-1])
        half = np.sqrt(table(np.exp(middle))) * np.exp(middle)
        first = float(rate[0])
        self._v = first + np.concatenate([[0.0], np.cumsum((rate[:-1] + 4.0 * half + rate[1:]) * np.diff(x) / 6.0)])

    def __call__(self, mu: npt.ArrayLike) -> Float:
        """v [dimensionless: standard deviations] for mean photoelectrons of any shape."""
        m = np.asarray(mu, np.float64)
        if self._log is None:
            return np.asarray(2.0 * np.sqrt(m))
        step = self._log[1] - self._log[0]
        at = (np.log(np.maximum(m, 1e-300)) - self._log[0]) / step
        i = np.clip(at, 0.0, self._v.size - 1.001).astype(np.intp)
        f = np.clip(at - i, 0.0, 1.0)
        # ln v against ln μ is almost linear (slope 1 to ½).
        log_v = np.log(self._v)
        value = np.exp(log_v[i] * (1.0 - f) + log_v[i + 1] * f)
        return np.asarray(np.where(at < 0.0, self._v[0] * m / math.exp(float(self._log[0])), value))


def distances(mu: npt.ArrayLike, arc: Arc | None = None) -> Float:
    """d (θ, θ') between all pairs of stacks of means mu (θ, slice) [photoelectrons]."""
    v = (arc or Arc())(mu)
    v = v - v.mean(axis=0)  # only differences count; without the mean the Gram form has smaller rounding errors
    square = np.einsum("ij,ij->i", v, v)
    return np.asarray(np.sqrt(np.maximum(square[:, None] + square[None, :] - 2.0 * v @ v.T, 0.0)))


#: A delay is regular if the Ziv-Zakai bound is within this factor of the Cramér-Rao bound …
REGULAR = 1.05
#: … and if wrong cells and curvature raise the error of maximum likelihood above it by at most this factor.
REACHED = 1.02


@dataclass(frozen=True)
class LocalBound:
    """Per delay of a grid, in the unit of the delay: ε(θ), the Cramér-Rao bound, and the excess of maximum likelihood.

    far² = Σ over both sides and cells of width σ_R beyond 2σ_R of max h² P: the union over cells outside the main lobe,
    which is the error of an estimator that searches the whole window. `curvature`: γ² of Efron, the relative excess of its
    variance within the main lobe (1/N for N photoelectrons of a Gaussian echo without background). `mean` is the bound
    itself: √ of the mean of ε², with valley filling.
    """

    epsilon: Float
    crb: Float
    far: Float
    curvature: Float
    mean: float
    step: float

    @property
    def ratio(self) -> Float:
        """ε/CRB, below 1 where the prior holds more information than the stack."""
        with np.errstate(divide="ignore", invalid="ignore"):
            return self.epsilon / self.crb

    @property
    def excess(self) -> Float:
        """Predicted ratio of the rms error of maximum likelihood to the Cramér-Rao bound, valid near 1."""
        with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
            return np.asarray(np.sqrt(1.0 + (self.far / self.crb) ** 2 + self.curvature))

    @property
    def worst(self) -> Float:
        """The largest abs(ln ε/CRB) within 3ε on either side: at corners of R the information jumps from delay to delay,
        and ε crosses the Cramér-Rao bound without being equal to it nearby."""
        with np.errstate(divide="ignore"):
            off = np.abs(np.log(self.ratio))
        off = np.where(np.isfinite(off), off, np.inf)
        reach = np.where(np.isfinite(self.epsilon), 3.0 * self.epsilon / self.step, 0.0).astype(np.intp)
        return np.array([off[max(i - r, 0) : i + r + 1].max() for i, r in enumerate(reach)])

    @property
    def regular(self) -> npt.NDArray[np.bool_]:
        """Delays with 1/1.05 <= ε/CRB <= 1.05, also within 3ε on either side, and excess <= 1.02."""
        return np.asarray((self.worst <= math.log(REGULAR)) & (self.excess <= REACHED))


def curvature(mu: npt.ArrayLike, first: npt.ArrayLike, second: npt.ArrayLike, information: npt.ArrayLike) -> Float:
    """γ² (θ) of a stack: (F₂₂ − F₁₂²/F₁₁)/F₁₁², from arrays (θ, slice).

    Main arguments:
        mu and its first and second derivatives with respect to the delay; information J(μ), 1/μ for Poisson samples.
    With the score Σ J μ' (y − μ), the second derivative of the likelihood varies by Σ κ (y − μ), κ = (Jμ')': F₁₁ = Σ Jμ'²,
    F₁₂ = Σ κμ', F₂₂ = Σ κ²/J; J' is taken as −J², exact for Poisson samples. Amplitude and background are taken as known.
    Source: B. Efron, Ann. Stat. 3:1189, 1975.
    """
    m, d1, d2, j = (np.asarray(v, np.float64) for v in (mu, first, second, information))
    live = (m > 0) & (j > 0)
    safe = np.where(live, j, 1.0)
    kappa = np.where(live, safe * d2 - (safe * d1) ** 2, 0.0)
    f11, f12 = (np.where(live, safe * d1 * d1, 0.0)).sum(-1), (kappa * d1).sum(-1)
    f22 = np.where(live, kappa * kappa / safe, 0.0).sum(-1)
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.asarray(np.where(f11 > 0, np.maximum(f22 - f12 * f12 / f11, 0.0) / f11**2, np.inf))


def local_bound(
    mu: npt.ArrayLike, slope: npt.ArrayLike, step: float, width: float, arc: Arc | None = None,
    bend: npt.ArrayLike = 0.0,
) -> LocalBound:  # fmt: skip
    """Bounds on a uniform grid of delays that spans the window of the prior.

    Main arguments:
        mu (θ, slice): mean photoelectrons. slope (θ): √F, the root of the Fisher information about θ.
        step: step of the grid, at most a sixth of `width`. width: σ_R, in the unit of `step`.
    Other arguments:
        arc: arc of the likelihood; Poisson by default. bend (θ): γ² from `curvature`; 0 neglects it.
    Below one grid step d is h(√F + (d₁/step − √F)h/step), so that a bound far finer than the grid is exact; between grid points
    d is linear, and h·Q(d/2) is integrated in closed form.
    """
    from .ziv_zakai_kernel import local_sums

    root = np.ascontiguousarray(slope, np.float64)
    d = distances(mu, arc)
    if step > width / 5.99:
        raise ValueError(f"the grid's step {step:g} must be at most a sixth of the width {width:g}")
    epsilon2, far2, error = local_sums(d, root, step, width)
    with np.errstate(divide="ignore"):
        crb = 1.0 / root
    # Valley filling changes the mean over the window; a refinement of the first step has no effect on it, so the grid is used.
    h = step * np.arange(d.shape[0])
    window = h[-1]
    filled = np.maximum.accumulate(error[::-1])[::-1]
    gain = float(np.trapezoid(h * (filled - error), dx=step)) / window
    mean = math.sqrt(float(np.trapezoid(epsilon2, dx=step)) / window + gain)
    bent = np.broadcast_to(np.asarray(bend, np.float64), crb.shape)
    return LocalBound(np.sqrt(epsilon2), crb, np.sqrt(far2), bent, mean, step)


def ziv_zakai(mu: npt.ArrayLike, slope: npt.ArrayLike, step: float, width: float, arc: Arc | None = None) -> float:
    """The bound ε in the unit of `step`; arguments as for `local_bound`."""
    return local_bound(mu, slope, step, width, arc).mean


def poisson_error(mu0: npt.ArrayLike, mu1: npt.ArrayLike) -> Float:
    """Least error P of a decision between two equally likely vectors of Poisson means, by saddlepoint; shape (…).

    Main arguments:
        mu0, mu1 (…, sample): means > 0; they broadcast.
    The test statistic is L = Σ y ln(μ1/μ0) − Σ(μ1 − μ0), with cumulant function under the first hypothesis
    K(s) = Σ μ0^(1−s) μ1^s − (1−s)μ0 − sμ1 and K(1 + s) under the second; P = ½[P₀(L > 0) + P₁(L < 0)] by
    Lugannani and Rice at K'(s) = 0. Counts are discrete: with few photoelectrons and no background L has few
    values, and the error of the formula is some hundredths. For equal means P = ½.
    Source: R. Lugannani and S. Rice, Adv. Appl. Probab. 12:475, 1980; H. Chernoff, Ann. Math. Stat. 23:493, 1952.
    """
    a, b = np.broadcast_arrays(np.asarray(mu0, np.float64), np.asarray(mu1, np.float64))
    log_ratio = np.log(b / a)
    s = np.full(a.shape[:-1], 0.5)
    low, high = np.zeros_like(s), np.ones_like(s)
    for _ in range(40):  # K is convex: Newton's step, limited to the bracket
        tilted = a * np.exp(s[..., None] * log_ratio)
        first = (tilted * log_ratio).sum(-1) - (b - a).sum(-1)
        second = (tilted * log_ratio**2).sum(-1)
        low, high = np.where(first < 0.0, s, low), np.where(first > 0.0, s, high)
        with np.errstate(invalid="ignore", divide="ignore"):
            new = s - first / second
        new = np.where((new > low) & (new < high), new, 0.5 * (low + high))
        done = np.abs(new - s) < 1e-13
        s = new
        if done.all():
            break
    tilted = a * np.exp(s[..., None] * log_ratio)
    value = tilted.sum(-1) - (1.0 - s) * a.sum(-1) - s * b.sum(-1)
    second = (tilted * log_ratio**2).sum(-1)
    p = 0.5 * (_tail(value, s, second) + _tail(value, 1.0 - s, second))
    return np.asarray(np.where(second > 1e-18, np.minimum(p, 0.5), 0.5))


def _tail(value: Float, s: Float, second: Float) -> Float:
    """Q(w) + φ(w)(1/u − 1/w), w = √(−2K), u = s√K''."""
    from scipy.special import ndtr

    with np.errstate(invalid="ignore", divide="ignore"):
        w = np.sqrt(np.maximum(-2.0 * value, 0.0))
        u = s * np.sqrt(second)
        density = np.exp(-0.5 * w * w) / math.sqrt(2.0 * math.pi)
        correction = np.where((w > 1e-6) & (u > 1e-6), density * (1.0 / u - 1.0 / w), 0.0)
    return np.asarray(ndtr(-w) + correction)
