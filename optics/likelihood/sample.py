"""The exact likelihood of one sample in DN, given its mean photoelectrons: Poisson ⊗ gamma ⊗ Gaussian ⊗ ADC."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..reflection.angles import Array
from .model import NoiseModel

__all__ = ["Distribution", "NoiseModel", "distribution", "information", "log_pmf", "pmf", "score"]


#: Codes per σ of the read noise at which the share of the information of a code is computed, near an end code.
_CODES_PER_SIGMA = 12.0


@dataclass(frozen=True, slots=True)
class Distribution:
    """P(first_dn + k) = `p[k]` and its slope dP/dμ = `slope[k]` [1/electron]; codes outside have P below 1e-15."""

    first_dn: int
    p: Array
    slope: Array

    @property
    def dn(self) -> NDArray[np.int64]:
        """The codes, in DN."""
        return self.first_dn + np.arange(self.p.size)

    @property
    def information(self) -> float:
        """J = Σ (dP/dμ)²/P [1/electron²]; codes with P below 1e-16 are omitted (rounding errors)."""
        keep = self.p > 1e-16
        return float(np.sum(np.square(self.slope[keep]) / self.p[keep]))


def _check(mu: float) -> None:
    if not (mu > 0.0 and np.isfinite(mu)):
        raise ValueError(f"The mean number of photoelectrons must be positive and finite, not {mu!r}.")


def distribution(noise: NoiseModel, mu: float) -> Distribution:
    """Distribution of the DN of one sample at μ > 0 mean photoelectrons. Raises ValueError for another μ.

    Bare sensor: a sum over the Poisson count, exact to rounding. Intensified: `gamma.py`, J accurate to 3e-4.
    """
    _check(mu)
    if noise.intensified:
        from .gamma import intensified_cells

        return Distribution(*intensified_cells(noise, float(mu)))
    first, last = _window(noise, mu)
    p, slope = np.empty(last - first + 1), np.empty(last - first + 1)
    _fill(noise, mu, first, 1, p, slope)
    return Distribution(first, p, slope)


def _window(noise: NoiseModel, mu: float) -> tuple[int, int]:
    from .kernels import code_window

    return code_window(
        noise.mean_e(mu), noise.well_variance_e2(mu), noise.read_noise_e, noise.gain_dn_per_e, noise.offset_dn,
        noise.adc_max_dn, noise.full_well_e,
    )  # fmt: skip


def _fill(noise: NoiseModel, mu: float, first: int, stride: int, p: Array, slope: Array) -> None:
    from .kernels import bare_cells

    bare_cells(
        mu + noise.dark_e, noise.read_noise_e, noise.gain_dn_per_e, noise.offset_dn, noise.adc_max_dn,
        noise.full_well_e, first, stride, p, slope,
    )  # fmt: skip


def information(noise: NoiseModel, mu: float) -> float:
    """Exact Fisher information J(μ) = Σ_y (dP/dμ)²/P [1/electron²] of one sample about its mean photoelectrons.

    Where the read noise spans many codes, its cost does not grow with it. Where neither end code is reached, (dP)²/P is
    smooth in y, and every stride-th code, at least 1.5 per read noise σ, gives the same sum (rectangle rule, error
    exp(−2π²·1.5²/2) < 1e-9).
    """
    _check(mu)
    if noise.intensified:
        return distribution(noise, mu).information
    first, last = _window(noise, mu)
    stride = max(1, int(noise.read_noise_e * noise.gain_dn_per_e / 1.5))
    if first == 0 or last == noise.adc_max_dn:
        return _clipped_information(noise, mu, first, last)
    p, slope = np.empty((last - first) // stride + 1), np.empty((last - first) // stride + 1)
    _fill(noise, mu, first, stride, p, slope)
    return stride * Distribution(first, p, slope).information


def _clipped_information(noise: NoiseModel, mu: float, first: int, last: int) -> float:
    """J where an end code is reached, at a cost that does not grow with the read noise.

    The end codes, which collect what lies beyond, are summed as they are. Between them (dP)²/P is smooth: codes a twelfth of the
    read noise's σ apart are joined by a cubic spline, whose relative error is about (1/12)⁴/4 = 1e-5.
    """
    stride = max(1, int(noise.read_noise_e * noise.gain_dn_per_e / _CODES_PER_SIGMA))
    if stride == 1 or last - first < 8 * stride:
        return _coded(noise, mu, first, last, 1).information
    low, high = max(first, 1), min(last, noise.adc_max_dn - 1)
    whole = low + (high - low) // stride * stride
    ends = [_coded(noise, mu, code, code, 1) for code in (0, noise.adc_max_dn) if first <= code <= last]
    # The last interval is shorter: its end is a node too, so that only nodes and end codes are computed.
    nodes = [_coded(noise, mu, low, whole, stride), _coded(noise, mu, high, high, 1)][: 2 if high > whole else 1]
    p, slope = (np.concatenate([getattr(part, name) for part in nodes]) for name in ("p", "slope"))
    share = np.where(p > 1e-16, np.square(slope) / np.maximum(p, 1e-300), 0.0)
    from scipy.interpolate import CubicSpline

    at = np.append(np.arange(low, whole + 1, stride), high)[: share.size]
    between = CubicSpline(at, share)(np.arange(low, high + 1))
    return float(between.sum()) + sum(part.information for part in ends)


def _coded(noise: NoiseModel, mu: float, first: int, last: int, stride: int) -> Distribution:
    p, slope = np.empty((last - first) // stride + 1), np.empty((last - first) // stride + 1)
    _fill(noise, mu, first, stride, p, slope)
    return Distribution(first, p, slope)


def pmf(noise: NoiseModel, mu: ArrayLike) -> Array:
    """P(DN = 0 … adc_max; μ) for μ of any shape; the result has one more axis, of adc_max_dn + 1 codes."""
    means = np.asarray(mu, dtype=np.float64)
    out = np.zeros((means.size, noise.adc_max_dn + 1))
    for row, value in zip(out, means.ravel(), strict=True):
        law = distribution(noise, float(value))
        row[law.first_dn : law.first_dn + law.p.size] = law.p
    return out.reshape((*means.shape, noise.adc_max_dn + 1))


def log_pmf(noise: NoiseModel, dn: ArrayLike, mu: ArrayLike) -> Array:
    """log P(DN; μ), broadcast over `dn` (whole codes) and `mu` (> 0; NaN elsewhere).

    Bare sensor: summed in logarithms, hence finite however far `dn` is from μ (−inf only where P is zero: outside the
    ADC's codes, or impossible without read noise). Intensified: −inf below 1e-15, the rounding error of the transform.
    """
    return _log_and_score(noise, dn, mu)[0]


def score(noise: NoiseModel, dn: ArrayLike, mu: ArrayLike) -> Array:
    """d log P(DN; μ)/dμ [1/electron], broadcast like `log_pmf`; NaN where P is zero."""
    return _log_and_score(noise, dn, mu)[1]


def _log_and_score(noise: NoiseModel, dn: ArrayLike, mu: ArrayLike) -> tuple[Array, Array]:
    codes, means = np.broadcast_arrays(np.asarray(dn, dtype=np.int64), np.asarray(mu, dtype=np.float64))
    y, m = np.ascontiguousarray(codes).ravel(), np.ascontiguousarray(means).ravel()
    value, slope = np.full(y.size, np.nan), np.full(y.size, np.nan)
    if noise.intensified:
        for mean in np.unique(m[(m > 0.0) & np.isfinite(m)]):
            law = distribution(noise, float(mean))
            at = np.flatnonzero(m == mean)
            k = y[at] - law.first_dn
            inside = (k >= 0) & (k < law.p.size)
            p = np.where(inside, law.p[np.clip(k, 0, law.p.size - 1)], 0.0)
            p[p < 1e-15] = 0.0
            with np.errstate(divide="ignore", invalid="ignore"):
                value[at] = np.log(p)
                slope[at] = np.where(p > 0.0, law.slope[np.clip(k, 0, law.p.size - 1)] / p, np.nan)
    else:
        from .kernels import bare_log_pmf

        bare_log_pmf(
            y, m + noise.dark_e, noise.read_noise_e, noise.gain_dn_per_e, noise.offset_dn, noise.adc_max_dn,
            noise.full_well_e, value, slope,
        )  # fmt: skip
        bad = ~(m > 0.0)
        value[bad], slope[bad] = np.nan, np.nan
    return value.reshape(codes.shape), slope.reshape(codes.shape)
