"""Compiled sums over the Poisson count of a bare sensor: P(DN; μ), its slope, and log P far in the tails."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from ..jit import kernel

__all__ = ["bare_cells", "bare_log_pmf"]

_REACH = 9.0  # standard deviations kept on either side: 1e-19 of the mass is omitted
#: Electrons between which P(y | n) is computed, per standard deviation of the read noise.
_STEPS_PER_SIGMA = 100.0


@kernel
def _cell(x: float, low: float, high: float, sigma: float) -> float:
    """P(low <= x + σz < high), with the relative accuracy of erfc in both tails."""
    if sigma == 0.0:
        return 1.0 if low <= x < high else 0.0
    a = (low - x) / (sigma * math.sqrt(2.0))
    b = (high - x) / (sigma * math.sqrt(2.0))
    if a > 0.0:
        return float(0.5 * (math.erfc(a) - math.erfc(b)))
    if b < 0.0:
        return float(0.5 * (math.erfc(-b) - math.erfc(-a)))
    return float(1.0 - 0.5 * (math.erfc(b) + math.erfc(-a)))


@kernel
def _spread(
    x: float,
    w: float,
    dw: float,
    sigma: float,
    gain: float,
    offset: float,
    top: int,
    first: int,
    stride: int,
    p: Any,
    dp: Any,
) -> None:
    """Adds to p and dp the codes that x electrons can give, every `stride` codes from `first`."""
    centre = gain * x + offset
    reach = _REACH * sigma * gain + 1.0
    low = max(math.floor(centre - reach), 0)
    high = min(math.ceil(centre + reach), top)
    if low > top:
        low = top
    if high < 0:
        high = 0
    k = (low - first + stride - 1) // stride
    while k < p.size:
        y = first + k * stride
        if y > high:
            break
        if k >= 0:
            below = -math.inf if y == 0 else (y - 0.5 - offset) / gain
            above = math.inf if y == top else (y + 0.5 - offset) / gain
            q = _cell(x, below, above, sigma)
            p[k] += w * q
            dp[k] += dw * q
        k += 1


@kernel
def bare_cells(
    mean: float,
    sigma: float,
    gain: float,
    offset: float,
    top: int,
    well: float,
    first: int,
    stride: int,
    p: Any,
    dp: Any,
) -> None:
    """Fills p with P(y) and dp with dP/d(mean) at y = first + k·stride; `mean` counts all Poisson electrons.

    d/dμ Poisson(n; μ) = Poisson(n−1; μ) − Poisson(n; μ), so both need one pass over n. P(y | n) is computed at every h-th n and
    taken as straight between, h = σ/100 or 1: an error of h²/12 of its curvature, 1e-5 of its peak. As h ≤ √μ, the counts
    average over many h, and the slope errs by as little.
    """
    p[:] = 0.0
    dp[:] = 0.0
    root = math.sqrt(mean)
    low = max(0, math.floor(mean - _REACH * root - 8.0))
    high = math.ceil(mean + _REACH * root + 30.0)
    log_w = (low * math.log(mean) if low > 0 else 0.0) - mean - math.lgamma(low + 1.0)
    w = math.exp(log_w)
    before = w * low / mean
    full_w = 0.0
    full_dw = 0.0
    step = max(1, int(min(sigma / _STEPS_PER_SIGMA, root)))
    node, here, d_here, ahead, d_ahead = low, 0.0, 0.0, 0.0, 0.0
    for n in range(low, high + 1):
        if n >= well:
            full_w += w
            full_dw += before - w
        else:
            if n == node + step:
                _spread(float(node), here, d_here, sigma, gain, offset, top, first, stride, p, dp)
                node, here, d_here, ahead, d_ahead = n, ahead, d_ahead, 0.0, 0.0
            part = (n - node) / step
            here += w * (1.0 - part)
            d_here += (before - w) * (1.0 - part)
            ahead += w * part
            d_ahead += (before - w) * part
        before = w
        w *= mean / (n + 1.0)
    _spread(float(node), here, d_here, sigma, gain, offset, top, first, stride, p, dp)
    if step > 1:
        _spread(float(node + step), ahead, d_ahead, sigma, gain, offset, top, first, stride, p, dp)
    # Mass above `high` leaves the window: its slope is the last weight, so that Σ dp = 0 exactly.
    full_dw += before
    if full_w > 0.0 or high >= well:
        _spread(well, full_w, full_dw, sigma, gain, offset, top, first, stride, p, dp)


@kernel
def _log_erfc(x: float) -> float:
    if x < 25.0:
        return math.log(math.erfc(x))
    return float(-x * x - math.log(x * math.sqrt(math.pi)) + math.log1p(-0.5 / (x * x)))


@kernel
def _log_cell(x: float, low: float, high: float, sigma: float) -> float:
    """log P(low <= x + σz < high), finite for any finite distance where σ > 0."""
    if sigma == 0.0:
        return 0.0 if low <= x < high else -math.inf
    a = (low - x) / (sigma * math.sqrt(2.0))
    b = (high - x) / (sigma * math.sqrt(2.0))
    if b < 0.0:
        a, b = -b, -a
    if a <= 0.0:
        return math.log(1.0 - 0.5 * (math.erfc(b) + math.erfc(-a)))
    outer = _log_erfc(a)
    if b == math.inf:
        return float(outer - math.log(2.0))
    drop = _log_erfc(b) - outer
    return float(outer - math.log(2.0) + math.log(-math.expm1(drop)))


@kernel
def bare_log_pmf(
    dn: Any, mean: Any, sigma: float, gain: float, offset: float, top: int, well: float, out: Any, score: Any
) -> None:
    """log P(dn; mean) and d log P/d mean per element (1-D arrays), summed in logarithms: stable in any tail."""
    for e in range(dn.size):
        y = dn[e]
        mu = mean[e]
        if y < 0 or y > top or not mu > 0.0:
            out[e] = math.nan if not mu > 0.0 else -math.inf
            score[e] = math.nan
            continue
        below = -math.inf if y == 0 else (y - 0.5 - offset) / gain
        above = math.inf if y == top else (y + 0.5 - offset) / gain
        # The counts that contribute lie between the mean and the observed level.
        seen = max(0.0, min((y - offset) / gain, well))
        near = min(mu, seen)
        far = max(mu, seen)
        low = max(0, math.floor(near - _REACH * (math.sqrt(near) + sigma) - 8.0 - 1.0 / gain))
        high = math.ceil(far + _REACH * (math.sqrt(far) + sigma) + 30.0 + 1.0 / gain)
        best = -math.inf
        total = 0.0
        moment = 0.0
        log_w = (low * math.log(mu) if low > 0 else 0.0) - mu - math.lgamma(low + 1.0)
        for n in range(low, high + 1):
            t = log_w + _log_cell(min(float(n), well), below, above, sigma)
            if t > best:
                scale = math.exp(best - t) if best > -math.inf else 0.0
                total = total * scale + 1.0
                moment = moment * scale + n
                best = t
            elif t > -math.inf:
                v = math.exp(t - best)
                total += v
                moment += v * n
            log_w += math.log(mu) - math.log(n + 1.0)
        if best == -math.inf:
            out[e] = -math.inf
            score[e] = math.nan
        else:
            out[e] = best + math.log(total)
            score[e] = moment / total / mu - 1.0  # E[n | y]/μ − 1


def code_window(
    mean: float, variance: float, sigma: float, gain: float, offset: float, top: int, well: float
) -> tuple[int, int]:
    """First and last code with non-negligible probability, for a well of this mean and variance and a read noise σ."""
    spread = _REACH * np.sqrt(variance)
    low = gain * (min(max(mean - spread - 8.0, 0.0), well) - _REACH * sigma) + offset - 2.0
    high = gain * (min(mean + spread + 30.0, well) + _REACH * sigma) + offset + 2.0
    first = int(min(max(np.floor(low), 0.0), top))
    return first, int(max(min(np.ceil(high), top), first))
