"""Several returns of a shot: maximum likelihood of as many echoes as the samples require."""

from __future__ import annotations

from typing import Literal

import numpy as np
import numpy.typing as npt
import xarray as xr

from ...scenes.errors import InputError
from ..fit import Fit, Weigh, scoring
from ..registry import estimator
from ..result import range_result
from .background import least_snr
from .per_pulse import per_pulse
from .record import WaveformRecord, read_record
from .start import fit_echo, likelihood_weights

__all__ = ["waveform_several_returns"]

Float = npt.NDArray[np.float64]
Index = npt.NDArray[np.intp]

#: Least amplitude of a return in its standard errors.
_LEAST_AMPLITUDE = 3.0


@estimator("waveform", cites="Hernandez-Marin, Wallace and Gibson, IEEE Trans. PAMI 29(12):2170, 2007 (not verified)")
@per_pulse
def waveform_several_returns(
    capture: xr.Dataset,
    *,
    pick: Literal["first", "last", "brightest"] = "first",
    most: int = 4,
    min_gain: float = 20.0,
    min_snr: float | None = None,
) -> xr.Dataset:
    """Maximum likelihood of μ_k = Σ_i A_i R(τ_i − t_k) + B with one echo, and with one more while the samples require it.

    The next echo starts where it explains most of what the fit leaves (score over its standard error, on a grid of half a σ
    of R); all are then fitted together. It is kept where 2 ln(L_i+1/L_i) > min_gain and every amplitude exceeds 3 of its
    standard errors. Likelihood and background as `waveform-ml`. The method of the source is Bayesian; the likelihood-ratio
    test replaces it here.
    Other arguments: pick: the echo whose range is returned. most: echoes tried for, 1 … 8. min_gain: see above; the place
    of an echo is searched over the record, so that 20 stands for about 1 of 1,000 shots. min_snr: least A of the echo that
    is returned, in its standard errors (null: 4, and 0 for single photons).
    Returns range, sigma [m] (Fisher information, all other parameters profiled) and valid (shot), as the stage asks; and
    beside them the ranges of all returns of a shot in order, return_range, and return_sigma [m] (shot, return), NaN beyond
    their number. Raises InputError for parameters out of range.
    """
    if not 1 <= most <= 8 or min_gain < 0:
        raise InputError(
            "A parameter is out of range.", where="waveform-several-returns[most, min_gain]", value=(most, min_gain),
            allowed="most 1 … 8, min_gain >= 0",
        )  # fmt: skip
    record = read_record(capture)
    least = least_snr(record, min_snr, "waveform-several-returns")
    tau, height, tau_sigma, height_sigma = _echoes(record, most, min_gain)
    low, high = record.window_s
    with np.errstate(invalid="ignore"):
        good = (height > least * height_sigma) & (tau_sigma < record.width_s) & (tau > low) & (tau < high)
    known = np.isfinite(tau)
    if pick == "brightest":
        at = np.argmax(np.where(known, height, -np.inf), axis=1)
    else:
        at = np.zeros(len(tau), np.intp) if pick == "first" else np.maximum(known.sum(axis=1) - 1, 0)
    rows = np.arange(len(tau))
    result = range_result(
        record.range_m(tau[rows, at]), tau_sigma[rows, at] * record.m_per_s, record.usable & good[rows, at]
    )
    shown = result["valid"].values[:, None] & good
    for name, values in (("return_range", tau), ("return_sigma", tau_sigma)):
        long_name = "radial range of each return" if name == "return_range" else "standard error of return_range"
        data = np.where(shown, record.range_m(values) if name == "return_range" else values * record.m_per_s, np.nan)
        result[name] = (("shot", "return"), data, {"units": "m", "long_name": long_name})
    return result


def _echoes(record: WaveformRecord, most: int, min_gain: float) -> tuple[Float, Float, Float, Float]:
    """(τ, A, σ_τ, σ_A), each (shot, most), in order of τ; NaN beyond the number of echoes, and where none was found."""
    weigh = likelihood_weights(record)
    fit = fit_echo(record, weigh)
    shots = len(fit.value)
    held = np.full((4, shots, most), np.nan)
    # (B, τ_1, A_1, τ_2, A_2, …): the background first, for the parts that are added.
    theta = fit.value[:, [2, 0, 1]]
    objective = _objective(record, weigh, theta, np.arange(shots))
    rows: Index = np.flatnonzero(fit.settled)
    _keep(held, rows, theta[rows], fit.variance[rows][:, [2, 0, 1]])
    theta, objective = theta[rows], objective[rows]
    for number in range(1, most):
        if rows.size == 0:
            break
        start = np.concatenate([theta, _next(record, weigh, theta, rows)], axis=1)
        more = _fit_all(record, weigh, start, rows)
        with np.errstate(invalid="ignore"):
            better = more.settled & (
                2 * (objective - (there := _objective(record, weigh, more.value, rows))) > min_gain
            )
            sigma = np.sqrt(more.variance[:, 2::2])
            better &= (more.value[:, 2::2] > _LEAST_AMPLITUDE * sigma).all(axis=1)
        rows, theta, objective = rows[better], more.value[better], there[better]
        _keep(held, rows, theta, more.variance[better])
        assert theta.shape[1] == 2 * number + 3
    return held[0], held[1], held[2], held[3]


def _keep(held: Float, rows: Index, theta: Float, variance: Float) -> None:
    """Write the echoes of these shots into held (τ, A, σ_τ, σ_A; shot; echo), in order of τ."""
    order = np.argsort(theta[:, 1::2], axis=1)
    number = order.shape[1]
    parts = (theta[:, 1::2], theta[:, 2::2], np.sqrt(variance[:, 1::2]), np.sqrt(variance[:, 2::2]))
    for k, part in enumerate(parts):
        held[k, rows, :number] = np.take_along_axis(part, order, axis=1)


def _model(record: WaveformRecord, theta: Float) -> tuple[Float, Float]:
    """Mean (shot, sample) and its derivatives (parameter, shot, sample)."""
    r, slope = record.template(theta[:, 1::2])
    mean = theta[:, :1] + (theta[:, 2::2, None] * r).sum(axis=1)
    columns = [np.ones_like(mean)]
    for i in range(r.shape[1]):
        columns += [theta[:, 2 + 2 * i, None] * slope[:, i], r[:, i]]
    return mean, np.stack(columns)


def _objective(record: WaveformRecord, weigh: Weigh, theta: Float, rows: Index) -> Float:
    """−log likelihood (shot), without constants; not finite where theta is not."""
    with np.errstate(invalid="ignore"):
        return weigh(_model(record, theta)[0], rows)[0]


def _next(record: WaveformRecord, weigh: Weigh, theta: Float, rows: Index) -> Float:
    """(τ, A) of the echo that explains most of what a fit leaves (shot, 2); a score of zero or below gives a faint one."""
    low, high = record.window_s
    tau = np.arange(low, high, max(0.5 * record.width_s, (high - low) / 2048))
    r, _ = record.template(tau)
    _, w, e, _ = weigh(_model(record, theta)[0], rows)
    square = w @ (r * r).T
    with np.errstate(divide="ignore", invalid="ignore"):
        score = np.where(square > 0, (w * e) @ r.T / np.sqrt(square), -np.inf)
        best = np.argmax(score, axis=1)
        pick = np.arange(len(best)), best
        height = score[pick] / np.sqrt(square[pick])
    faint = 1e-3 * np.abs(theta[:, 2::2]).max(axis=1)
    return np.stack([tau[best], np.where(np.isfinite(height), np.maximum(height, faint), faint)], axis=1)


def _fit_all(record: WaveformRecord, weigh: Weigh, start: Float, rows: Index) -> Fit:
    """Scoring of all echoes together. It works on the given shots only: their indices are passed on to the weights."""
    low_s, high_s = record.window_s
    echoes = (start.shape[1] - 1) // 2
    low = np.tile([record.least_mean, *[low_s - record.width_s, 0.0] * echoes], (len(start), 1))
    high = np.tile([np.inf, *[high_s + record.width_s, np.inf] * echoes], (len(start), 1))
    reach = np.array([np.inf, *[0.7 * record.width_s, np.inf] * echoes])
    judged = tuple(range(1, start.shape[1], 2))
    return scoring(
        lambda theta, _: _model(record, theta),
        lambda mean, some: weigh(mean, rows[some]),
        start,
        low,
        high,
        reach,
        judged,
    )
