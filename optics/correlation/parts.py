"""The elementary shapes of which pulses and gates consist, with their first and second upper integrals.

Every part f has three methods on arrays: `density(x)` = f(x), `upper(x)` = S(x) = ∫_x^∞ f and
`upper2(x)` = Q(x) = ∫_x^∞ S = ∫ (t − x)₊ f(t) dt. All correlations in `forms.py` are sums of these.
Times in s, values in the unit of f.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import TypeAlias

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.special import erfc, erfcx

__all__ = ["Array", "Decay", "ExGaussian", "Gaussian", "Part", "PiecewiseLinear", "ramps", "samples"]

Array: TypeAlias = NDArray[np.float64]

_SQRT2 = float(np.sqrt(2.0))
_SQRT_2PI = float(np.sqrt(2.0 * np.pi))
#: An edge shorter than this fraction of the whole shape is treated as a jump at its middle: its slope would amplify
#: rounding (1e-16 / 1e-7), while the displaced area is below half of this fraction.
_JUMP_FRACTION = 1e-7
#: Gaussians end where exp(−z²/2) < 1e-14, decays where exp(−z) < 1e-14.
_GAUSS_REACH = 8.1
_DECAY_REACH = 33.0


@dataclass(frozen=True)
class Gaussian:
    """f(x) = area · N(x; mean, sigma)."""

    mean: float
    sigma: float
    area: float = 1.0

    @property
    def support(self) -> tuple[float, float]:
        """Where f is above 1e-14 of its peak."""
        return self.mean - _GAUSS_REACH * self.sigma, self.mean + _GAUSS_REACH * self.sigma

    def density(self, x: Array) -> Array:
        """f(x)."""
        z = (x - self.mean) / self.sigma
        return np.asarray(self.area / (_SQRT_2PI * self.sigma) * np.exp(-0.5 * z * z), dtype=np.float64)

    def upper(self, x: Array) -> Array:
        """∫_x^∞ f = area·erfc(z/√2)/2."""
        return np.asarray(0.5 * self.area * erfc((x - self.mean) / (_SQRT2 * self.sigma)), dtype=np.float64)

    def upper2(self, x: Array) -> Array:
        """area·σ·(φ(z) − z·Φ(−z)); for z > 0 with φ factored out, so that the tail decays to zero without rounding noise."""
        z = (x - self.mean) / self.sigma
        phi = np.exp(-0.5 * z * z) / _SQRT_2PI
        # np.abs keeps erfcx finite where the other branch is taken.
        tail = phi * np.maximum(1.0 - np.abs(z) * np.sqrt(0.5 * np.pi) * erfcx(np.abs(z) / _SQRT2), 0.0)
        # E[(t−x)₊] − E[(x−t)₊] = mean − x gives the side z < 0 from the same tail.
        return np.asarray(self.area * self.sigma * (tail + np.maximum(-z, 0.0)), dtype=np.float64)


@dataclass(frozen=True)
class ExGaussian:
    """f = area · (N(0, sigma) convolved with an exponential decay of constant `tail`), centroid at `mean`.

    With z = x − mean + tail: f = area/(2 tail)·exp(−z²/2σ²)·erfcx((σ/tail − z/σ)/√2) (Grushka, Anal. Chem. 44:1733,
    1972, in the overflow-free form; erfcx's argument below zero takes the exp·erfc form, whose exponent is negative).
    """

    mean: float
    sigma: float
    tail: float
    area: float = 1.0

    @property
    def support(self) -> tuple[float, float]:
        """Where f is above about 1e-14 of its peak."""
        start = self.mean - self.tail
        return start - _GAUSS_REACH * self.sigma, start + _GAUSS_REACH * self.sigma + _DECAY_REACH * self.tail

    @cached_property
    def _gauss(self) -> Gaussian:
        return Gaussian(self.mean - self.tail, self.sigma, self.area)

    def density(self, x: Array) -> Array:
        """f(x)."""
        z = np.asarray(x, dtype=np.float64) - (self.mean - self.tail)
        ratio = self.sigma / self.tail
        y = (ratio - z / self.sigma) / _SQRT2
        near = np.exp(-0.5 * (z / self.sigma) ** 2) * erfcx(np.maximum(y, 0.0))
        # y < 0 means z > σ²/tail, where the exponent is below −(σ/tail)²/2.
        far = np.exp(np.minimum(0.5 * ratio * ratio - z / self.tail, 0.0)) * erfc(np.minimum(y, 0.0))
        return np.asarray(0.5 * self.area / self.tail * np.where(y >= 0.0, near, far), dtype=np.float64)

    def upper(self, x: Array) -> Array:
        """∫_x^∞ f = S_gauss + tail·f (from f' = (gauss − f)/tail)."""
        return self._gauss.upper(x) + self.tail * self.density(x)

    def upper2(self, x: Array) -> Array:
        """∫_x^∞ S = Q_gauss + tail·S."""
        return self._gauss.upper2(x) + self.tail * self.upper(x)

    def derivative(self, x: Array) -> Array:
        """f'(x) = (gauss(x) − f(x))/tail."""
        return (self._gauss.density(x) - self.density(x)) / self.tail


@dataclass(frozen=True)
class Decay:
    """f(x) = height·exp(−(x − start)/tail) for x ≥ start, else 0."""

    start: float
    tail: float
    height: float

    @property
    def support(self) -> tuple[float, float]:
        """Where f is above 1e-14 of its peak."""
        return self.start, self.start + _DECAY_REACH * self.tail

    def density(self, x: Array) -> Array:
        """f(x)."""
        z = (x - self.start) / self.tail
        return np.asarray(np.where(z >= 0.0, self.height * np.exp(-np.maximum(z, 0.0)), 0.0), dtype=np.float64)

    def upper(self, x: Array) -> Array:
        """∫_x^∞ f, constant before `start`."""
        z = np.maximum((x - self.start) / self.tail, 0.0)
        return np.asarray(self.height * self.tail * np.exp(-z), dtype=np.float64)

    def upper2(self, x: Array) -> Array:
        """∫_x^∞ S, a straight line before `start`."""
        return self.tail * (self.upper(x) + self.height * np.maximum(self.start - x, 0.0))


@dataclass(frozen=True, eq=False)
class PiecewiseLinear:
    """Straight lines between knots x₀ < … < x_n, jumps allowed at knots, zero outside.

    `left[i]` and `right[i]` are the limits at knot i; left[0] = right[n] = 0.
    """

    knot: Array
    left: Array
    right: Array

    @property
    def support(self) -> tuple[float, float]:
        """First and last knot."""
        return float(self.knot[0]), float(self.knot[-1])

    @cached_property
    def _slope(self) -> Array:
        return (self.left[1:] - self.right[:-1]) / np.diff(self.knot)

    @cached_property
    def jumps(self) -> Array:
        """J_i: f(x_i+) − f(x_i−)."""
        return self.right - self.left

    @cached_property
    def bends(self) -> Array:
        """D_i: f'(x_i+) − f'(x_i−)."""
        return np.diff(self._slope, prepend=0.0, append=0.0)

    @cached_property
    def _above(self) -> tuple[Array, Array]:
        """S and Q at the knots, summed from the right so that the far end is exactly zero."""
        d = np.diff(self.knot)
        cell = 0.5 * d * (self.right[:-1] + self.left[1:])
        upper = np.append(np.cumsum(cell[::-1])[::-1], 0.0)
        cell2 = d * (upper[1:] + d * (self.left[1:] / 2.0 - self._slope * d / 6.0))
        return upper, np.append(np.cumsum(cell2[::-1])[::-1], 0.0)

    def _locate(self, x: Array) -> tuple[NDArray[np.intp], Array, Array]:
        """Cell index, distance to the cell's right knot (0…cell width), and distance before the first knot."""
        before = np.maximum(self.knot[0] - x, 0.0)
        inside = np.clip(x, self.knot[0], self.knot[-1])
        cell = np.clip(np.searchsorted(self.knot, inside, side="right") - 1, 0, self.knot.size - 2)
        return cell, self.knot[cell + 1] - inside, before

    def density(self, x: Array) -> Array:
        """f(x), from the right at jumps."""
        x = np.asarray(x, dtype=np.float64)
        cell, d, _ = self._locate(x)
        inside = (x >= self.knot[0]) & (x < self.knot[-1])
        return np.where(inside, self.left[cell + 1] - self._slope[cell] * d, 0.0)

    def upper(self, x: Array) -> Array:
        """∫_x^∞ f."""
        cell, d, _ = self._locate(np.asarray(x, dtype=np.float64))
        value = self._above[0][cell + 1] + d * (self.left[cell + 1] - 0.5 * d * self._slope[cell])
        return np.asarray(value, dtype=np.float64)

    def upper2(self, x: Array) -> Array:
        """∫_x^∞ S."""
        cell, d, before = self._locate(np.asarray(x, dtype=np.float64))
        inner = self.left[cell + 1] / 2.0 - self._slope[cell] * d / 6.0
        value = self._above[1][cell + 1] + d * (self._above[0][cell + 1] + d * inner) + before * self._above[0][0]
        return np.asarray(value, dtype=np.float64)

    @cached_property
    def area(self) -> float:
        """∫ f."""
        return float(self._above[0][0])

    @cached_property
    def centroid(self) -> float:
        """∫ x f / ∫ f."""
        return float(self.knot[0] + self._above[1][0] / self._above[0][0])

    def moment2(self, about: float) -> float:
        """∫ (x − about)² f dx, exact by Gauss-Legendre with two nodes a cell (cubic integrand)."""
        d = np.diff(self.knot)
        total = 0.0
        for node in (0.5 - np.sqrt(1.0 / 12.0), 0.5 + np.sqrt(1.0 / 12.0)):
            x = self.knot[:-1] + node * d
            total += float(np.sum(0.5 * d * (self.right[:-1] + self._slope * node * d) * (x - about) ** 2))
        return total

    def moved(self, shift: float, scale: float) -> PiecewiseLinear:
        """scale · f(x − shift)."""
        return PiecewiseLinear(self.knot + shift, self.left * scale, self.right * scale)


Part: TypeAlias = Gaussian | ExGaussian | Decay | PiecewiseLinear


def ramps(points: list[tuple[float, float]]) -> PiecewiseLinear:
    """Piecewise-linear shape through (x, f) points in order; (nearly) equal x make a jump. Zero outside."""
    x = np.array([p[0] for p in points], dtype=np.float64)
    f = np.array([p[1] for p in points], dtype=np.float64)
    span = x[-1] - x[0]
    knot, left, right = [x[0]], [0.0], [f[0]]
    for i in range(1, x.size):
        if x[i] - x[i - 1] <= _JUMP_FRACTION * span:
            knot[-1] = 0.5 * (x[i] + x[i - 1])
            right[-1] = f[i]
        else:
            knot.append(x[i])
            left.append(f[i])
            right.append(f[i])
    right[-1] = 0.0
    return PiecewiseLinear(np.array(knot), np.array(left), np.array(right))


def samples(start: float, step: float, value: ArrayLike) -> PiecewiseLinear:
    """Linear between even samples, zero outside."""
    v = np.asarray(value, dtype=np.float64)
    if v.ndim != 1 or v.size < 2:
        raise ValueError(f"samples need one dimension and at least 2 values, not shape {v.shape}")
    left, right = v.copy(), v.copy()
    left[0] = right[-1] = 0.0
    knot = np.asarray(start + step * np.arange(v.size), dtype=np.float64)
    return PiecewiseLinear(knot, left, right)
