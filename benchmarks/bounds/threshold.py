"""Tables of the threshold of a rig: the ratio of a bound to the Cramér-Rao bound over delay, amplitude and background.

Nodes lie at fixed multiples of .25 in ln α and .35 in ln β, so that a value does not depend on earlier lookups. They are
computed when first needed, and the tables of the last rigs are kept, so that the levels of a suite share them. A node takes
some milliseconds (Ziv-Zakai), or some tenths of a second if the Bayesian bound is simulated, which is done only next to
irregular elements.
"""

from __future__ import annotations

import math
from collections import OrderedDict
from collections.abc import Iterator
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
import numpy.typing as npt

from .bayes import posterior_square
from .scan import Scan
from .ziv_zakai import REACHED, REGULAR, Arc, curvature, local_bound

__all__ = ["ThresholdTable", "table_of"]

Float = npt.NDArray[np.float64]
Int = npt.NDArray[np.int64]
Bool = npt.NDArray[np.bool_]

_AMPLITUDE_STEP = 0.25  # in ln α: the threshold is about 1.5 wide
_BACKGROUND_STEP = 0.35
_DARK = -(10**6)  # index of the node without any background
_FAINTEST = 1e-2  # photoelectrons over all samples, equivalent to none
_BAYES_PER_WIDTH = 16.0  # and at least three delays per Cramér-Rao bound, as the grid must resolve the posterior …
_BAYES_DELAYS = 20_000  # … up to this many
_BAYES_CELLS = 8_000_000
_LEAST = 1e-3  # least relative excess of the mean square error that the simulation resolves
_KEPT = 8
_kept: OrderedDict[str, ThresholdTable] = OrderedDict()


@dataclass(frozen=True)
class _Node:
    """Over the scan's grid: `LocalBound.worst`, ln of the predicted excess of maximum likelihood, ln of ε [s]; the median
    Cramér-Rao bound [s]."""

    worst: Float
    log_excess: Float
    log_epsilon_s: Float
    crb_s: float


class ThresholdTable:
    """Linear interpolation between nodes. Delays outside the searched part have the nearest value; those outside the window
    are never regular."""

    def __init__(self, scan: Scan) -> None:
        self.scan = scan
        self.delay_s = scan.grid()
        self._r, self._slope, self._bend = scan.shapes(self.delay_s)
        self._arc = Arc() if scan.noise is None else Arc(_table(scan))
        self._nodes: dict[tuple[int, int], _Node] = {}
        self._excess: dict[tuple[int, int], tuple[Float, Float]] = {}
        light = max(float(self._r.sum(axis=1).max()), 1e-300)
        self._lowest = math.floor(math.log(_FAINTEST / light) / _AMPLITUDE_STEP)

    def regular(self, delay_s: npt.ArrayLike, amplitude: npt.ArrayLike, background: npt.ArrayLike) -> Bool:
        """Whether delays (of the light from laser to target to camera, s) are regular at these amplitudes and mean backgrounds."""
        worst = self._look("worst", delay_s, amplitude, background)
        excess = self._look("log_excess", delay_s, amplitude, background)
        low, high = self.scan.window_s
        delay = np.asarray(delay_s, np.float64)
        with np.errstate(invalid="ignore"):
            inside = (delay >= low) & (delay <= high) & (np.asarray(amplitude) > 0)
        return np.asarray(inside & (worst <= math.log(REGULAR)) & (excess <= math.log(REACHED)))

    def epsilon_s(self, delay_s: npt.ArrayLike, amplitude: npt.ArrayLike, background: npt.ArrayLike) -> Float:
        """ε(θ), s, whose mean square over delays is the squared Ziv-Zakai bound."""
        return np.exp(self._look("log_epsilon_s", delay_s, amplitude, background))

    def bayes_s(self, delay_s: npt.ArrayLike, amplitude: npt.ArrayLike, background: npt.ArrayLike) -> Float:
        """√E[(E[θ|y] − θ)²] for true delays near θ, s, whose mean square over delays is the least mean square error. It is ε(θ)
        times a factor for wrong cells, which is simulated in a few parts of the window, shorter ones at its ends."""
        wrong = np.exp(self._look("log_wrong", delay_s, amplitude, background))
        return self.epsilon_s(delay_s, amplitude, background) * np.sqrt(1.0 + wrong)

    def _look(self, field: str, delay_s: npt.ArrayLike, amplitude: npt.ArrayLike, background: npt.ArrayLike) -> Float:
        delay, a, b = np.broadcast_arrays(*(np.asarray(v, np.float64) for v in (delay_s, amplitude, background)))
        out = np.full(delay.size, np.nan)
        keep = np.flatnonzero(np.isfinite(delay).ravel() & (a > 0).ravel() & np.isfinite(b).ravel())
        if keep.size == 0:
            return out.reshape(delay.shape)
        theta = delay.ravel()[keep]
        i, f = _place(np.log(a.ravel()[keep]) / _AMPLITUDE_STEP, self._lowest)
        level = b.ravel()[keep]
        lit = level > 0
        j, g = _place(np.log(np.where(lit, level, 1.0)) / _BACKGROUND_STEP, -(10**5))
        j, g = np.where(lit, j, _DARK), np.where(lit, g, 0.0)
        total = np.zeros(keep.size)
        for di, dj in ((0, 0), (0, 1), (1, 0), (1, 1)):
            weight = (f if di else 1.0 - f) * (g if dj else 1.0 - g)
            some = np.flatnonzero(weight > 0)
            for ia, ib, own in _groups(i[some] + di, j[some] + dj):
                its = some[own]
                total[its] += weight[its] * self._value(field, ia, ib, theta[its])
        out[keep] = total
        return out.reshape(delay.shape)

    def _value(self, field: str, ia: int, ib: int, theta: Float) -> Float:
        if field == "log_wrong":
            # ln of the excess falls a little faster than linearly with the light: between nodes the bound remains valid.
            return np.asarray(np.interp(theta, *self._wrong(ia, ib)), np.float64)
        return np.asarray(np.interp(theta, self.delay_s, getattr(self._node(ia, ib), field)), np.float64)

    def _means(self, ia: int, ib: int, r: Float) -> Float:
        b = 0.0 if ib == _DARK else math.exp(_BACKGROUND_STEP * ib)
        return np.asarray(math.exp(_AMPLITUDE_STEP * ia) * r + b * self.scan.share)

    def _node(self, ia: int, ib: int) -> _Node:
        if (ia, ib) not in self._nodes:
            a = math.exp(_AMPLITUDE_STEP * ia)
            mu = self._means(ia, ib, self._r)
            j = self.scan.information(mu)
            first, second = a * self._slope, a * self._bend
            root = np.sqrt((j * first**2).sum(axis=1))
            step = float(self.delay_s[1] - self.delay_s[0])
            found = local_bound(mu, root, step, self.scan.width_s, self._arc, curvature(mu, first, second, j))
            with np.errstate(divide="ignore"):
                excess = np.log(found.excess)
            # Without any information these are infinite; a large number keeps lookups finite, and the elements irregular.
            self._nodes[ia, ib] = _Node(
                np.minimum(found.worst, 50.0),
                np.clip(np.nan_to_num(excess, nan=50.0), 0.0, 50.0),
                np.log(np.maximum(found.epsilon, 1e-300)),
                float(np.median(found.crb)),
            )
        return self._nodes[ia, ib]

    def _wrong(self, ia: int, ib: int) -> tuple[Float, Float]:
        """Middles of parts of the window [s], and ln(mean (E[θ|y] − θ)²/mean ε² − 1) there, at least ln 10⁻³."""
        if (ia, ib) not in self._excess:
            node = self._node(ia, ib)
            per_width = max(_BAYES_PER_WIDTH, 3.0 * self.scan.width_s / max(node.crb_s, 1e-300))
            low, high = self.scan.searched_s
            per_width = min(per_width, _BAYES_DELAYS * self.scan.width_s / (high - low))
            theta = self.scan.grid(per_width)
            mean = self.scan.poisson_mean(self._means(ia, ib, self.scan.shapes(theta)[0]))
            edges = _parts(theta.size, (theta.size - 1) * self.scan.width_s / (high - low))
            each = int(min(max(_BAYES_CELLS / theta.size / (edges.size - 1), 40), 240))
            truth = np.concatenate([a + (np.arange(each) * (b - a)) // each for a, b in pairwise(edges)])
            spread = posterior_square(mean, float(theta[1] - theta[0]), truth).reshape(-1, each).mean(axis=1)
            local = (
                np.exp(2.0 * np.interp(theta[truth], self.delay_s, node.log_epsilon_s)).reshape(-1, each).mean(axis=1)
            )
            middle = theta[truth].reshape(-1, each).mean(axis=1)
            self._excess[ia, ib] = middle, np.log(np.maximum(spread / np.maximum(local, 1e-300) - 1.0, _LEAST))
        return self._excess[ia, ib]


def _parts(points: int, width: float) -> Int:
    """Indices that divide a grid into parts: .75 widths long at both ends; from three widths inwards
    each part is twice as long as the one before."""
    ends = [0.75 * width * k for k in range(5)]
    while ends[-1] < 0.5 * points:
        ends.append(ends[-1] + 2.0 * (ends[-1] - ends[-2]))
    left = np.array([round(end) for end in ends if end < 0.45 * points], np.int64)
    return np.concatenate([left, points - left[::-1]])


def _table(scan: Scan):  # type: ignore[no-untyped-def]
    from ...optics.likelihood.fisher_table import information_table

    assert scan.noise is not None
    return information_table(scan.noise)


def _place(x: Float, lowest: int) -> tuple[Int, Float]:
    """The node below x, but not below `lowest`, and the fraction of the step to the next."""
    x = np.maximum(x, lowest)
    i = np.floor(x)
    return i.astype(np.int64), x - i


def _groups(i: Int, j: Int) -> Iterator[tuple[int, int, Int]]:
    """Each pair (i, j) that occurs, in order, and the places where it does, in order."""
    if i.size == 0:
        return
    low = int(j.min())
    key = i * (int(j.max()) - low + 1) + (j - low)
    order = np.argsort(key, kind="stable")
    for own in np.split(order, np.flatnonzero(np.diff(key[order])) + 1):
        yield int(i[own[0]]), int(j[own[0]]), own


def table_of(scan: Scan) -> ThresholdTable:
    """The table of a scan; the last eight are kept."""
    if scan.key in _kept:
        _kept.move_to_end(scan.key)
    else:
        _kept[scan.key] = ThresholdTable(scan)
        while len(_kept) > _KEPT:
            _kept.popitem(last=False)
    return _kept[scan.key]
