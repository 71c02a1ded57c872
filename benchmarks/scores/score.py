"""Scores of one estimate against the truth: every column of the table, for unmixed and for mixed elements apart.

With e = estimate − truth over the n elements that have a truth, V those of them marked valid, b the bound and X the
failure threshold:

    coverage = |V|/n                    failure_rate = share of n invalid or with |e| > L,
                                        L = max(X, min(5 b, 2 X, or cσ_R/2n_g if that is more))
    bias, rmse, mae, p95 over V         rmse_full: invalid elements count with the prior's error, window/√12
    bound = √mean(b²) over V            efficiency = 1/mean((e/b)²) over V, outliers included;
    z_rms = √mean((e/σ)²) over V        NaN where coverage < .99 or the bias is real
    cover95 = share of V with |e| ≤ 1.96 σ

A bias is real where |bias| exceeds .1 rmse by more than chance explains, 3 rmse/√|V| (`statistics.bias_is_real`).
`efficiency_lo`, `_hi` are NaN where a few blocks of pixels hold most of the squared error (`statistics.concentrated`).
X = ½·cσ_R/2n_g for gated captures (σ_R: standard deviation of the response R), or the suite's `failure_at`. L is five
bounds as long as that is within the echo; an answer off by more than the echo's own width has found something else, and
fails however little light there was. `bound_kind` is "exact" or "quasi" where all elements of the row are regular, that
is where the Cramér-Rao bound can be reached, and "ziv-zakai" or "bayes" where not (`bounds.regular`).
A mixed element sees several surfaces: its error is the signed distance to the nearer of truth_first and truth_last, so
that a range between two surfaces, where nothing is, is an error; no bound is asserted. A run that did not end "ok" has
coverage 0 and failure rate 1.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt
import xarray as xr

from ..statistics.pooled import bias_is_real, block_bootstrap_ratio, block_ids

__all__ = [
    "ACCURACY", "COLUMNS", "KEY", "REGULAR_KINDS", "TIMES", "Bound", "Truth", "errors_of", "failure_limit", "score_rows",
    "truth_of",
]  # fmt: skip

Float = npt.NDArray[np.float64]
Bool = npt.NDArray[np.bool_]

#: What names a row, before `modality,quantity`.
KEY = (
    "suite", "scene", "stress", "level", "stress2", "level2", "seed", "condition", "stage", "estimator", "params",
)  # fmt: skip
COLUMNS = (
    *KEY, "modality", "quantity", "unit", "n", "coverage", "failure_rate", "failure_at", "bias", "rmse", "rmse_full",
    "mae", "p95", "bound", "bound_kind", "efficiency", "efficiency_lo", "efficiency_hi", "z_rms", "cover95", "cpu_s",
    "wall_s", "throughput", "peak_bytes", "status",
)  # fmt: skip
#: Columns that differ between two runs of equal seeds; all others are byte-identical on one machine.
TIMES = ("cpu_s", "wall_s", "throughput", "peak_bytes")
ACCURACY = tuple(name for name in COLUMNS if name not in TIMES)

#: Kinds of bound of a row all of whose elements are regular.
REGULAR_KINDS = ("exact", "quasi")

_EFFICIENT_COVERAGE = 0.99


@dataclass(frozen=True)
class Bound:
    """Per-element bound of the standard error, and what of the rig sets the scale of failure.

    Main arguments:
        sigma (row, col), or (shot): m; infinite where the capture holds no information, NaN where there is no truth.
        kind: "exact" or "quasi"; "ziv-zakai" or "bayes"; "none". response_m: cσ_R/2n_g. window_m: span of range that the
        stack can answer.
    """

    sigma: Float
    kind: str
    response_m: float
    window_m: float

    @property
    def prior_m(self) -> float:
        """Standard error of knowing only the window: window/√12."""
        return self.window_m / math.sqrt(12.0)


@dataclass(frozen=True)
class Truth:
    """What an estimate is compared with, (row, col): the true range, and the two surfaces of mixed elements, m."""

    range: Float
    mixed: Bool
    first: Float
    last: Float


def truth_of(capture: xr.Dataset) -> Truth:
    """The truth of a capture; an element of a one-detector ranger is never mixed."""
    true_range = np.asarray(capture["truth_range"].values, np.float64)
    if "truth_mixed" not in capture:
        return Truth(true_range, np.zeros(true_range.shape, bool), true_range, true_range)
    return Truth(
        true_range,
        np.asarray(capture["truth_mixed"].values, bool),
        np.asarray(capture["truth_first"].values, np.float64),
        np.asarray(capture["truth_last"].values, np.float64),
    )


def errors_of(estimate: Float, truth: Truth) -> Float:
    """estimate − truth, m; for mixed elements the signed distance to the nearer of first and last. NaN where either is
    missing."""
    to_first, to_last = estimate - truth.first, estimate - truth.last
    nearer = np.where(np.abs(to_first) <= np.abs(to_last), to_first, to_last)
    return np.where(truth.mixed, nearer, estimate - truth.range)


def failure_limit(sigma: Float, bound: Bound, failure_at: float | None = None) -> Float:
    """|error| beyond which an element has failed, m: five bounds, but at least X and at most the larger of 2X and the
    response's standard deviation; X where there is no bound.

    Main arguments:
        sigma: bounds of the elements wanted, m, any shape. bound: of the capture, for its scale.
    Other arguments:
        failure_at: X, m; half the response's standard deviation if None.
    """
    at = failure_at if failure_at is not None else 0.5 * bound.response_m
    # fmax: elements without a bound are judged by X.
    return np.asarray(np.minimum(np.fmax(5.0 * sigma, at), max(2.0 * at, bound.response_m)), np.float64)


def score_rows(
    key: dict[str, Any],
    truth: Truth,
    bound: Bound,
    estimate: dict[str, np.ndarray] | None,
    *,
    status: str,
    cpu_s: float = math.nan,
    wall_s: float = math.nan,
    peak_bytes: float = math.nan,
    failure_at: float | None = None,
    modality: str = "gated",
) -> list[dict[str, Any]]:
    """The table's rows for one estimate: quantity "range", and "range-mixed" where there are mixed elements.

    Main arguments:
        key: values of the key columns. estimate: `range`, `sigma`, `valid` (row, col), or None if there is none.
        status: "ok", or what went wrong: then the estimate is not looked at.
    Other arguments:
        modality: of the capture; what is (row, col) in a gated one is (shot) in the others.
    """
    shape = truth.range.shape
    has_truth = np.isfinite(truth.range)
    if status != "ok" or estimate is None:
        nothing = np.full(shape, math.nan)
        estimate = {"range": nothing, "sigma": nothing, "valid": np.zeros(shape, bool)}
    errors = errors_of(estimate["range"], truth)
    threshold = failure_at if failure_at is not None else 0.5 * bound.response_m
    blocks = block_ids((shape[0], shape[1] if len(shape) > 1 else 1)).reshape(shape)
    rows = []
    for quantity, chosen in (("range", has_truth & ~truth.mixed), ("range-mixed", has_truth & truth.mixed)):
        if quantity == "range-mixed" and not chosen.any():
            continue
        unmixed = quantity == "range"
        sigma_bound = bound.sigma[chosen] if unmixed else np.full(int(chosen.sum()), math.nan)
        figures = _figures(
            errors[chosen], estimate["sigma"][chosen], estimate["valid"][chosen], sigma_bound, blocks[chosen],
            failure_limit(sigma_bound, bound, failure_at), bound.prior_m,
        )  # fmt: skip
        figures["bound_kind"] = _kind(bound, sigma_bound) if unmixed else "none"
        row = {
            **key, "modality": modality, "quantity": quantity, "unit": "m", "failure_at": threshold, **figures,
            "cpu_s": cpu_s, "wall_s": wall_s, "throughput": has_truth.size / wall_s if wall_s > 0 else math.nan,
            "peak_bytes": peak_bytes, "status": status,
        }  # fmt: skip
        rows.append({name: row[name] for name in COLUMNS})
    return rows


def _kind(bound: Bound, sigma: Float) -> str:
    """Elements whose bound exceeds the prior's error are held at it, so that the mean is no longer an exact bound."""
    return "quasi" if bound.kind == "exact" and np.any(sigma > bound.prior_m) else bound.kind


def _figures(
    error: Float, sigma: Float, valid: Bool, bound: Float, block: npt.NDArray[np.intp], limit: Float, prior: float
) -> dict[str, Any]:
    nan = math.nan
    n = int(error.size)
    figures: dict[str, Any] = dict.fromkeys(
        ("coverage", "failure_rate", "bias", "rmse", "rmse_full", "mae", "p95", "bound", "efficiency", "efficiency_lo",
         "efficiency_hi", "z_rms", "cover95"), nan,
    )  # fmt: skip
    figures["n"] = n
    if n == 0:
        return figures
    with np.errstate(invalid="ignore"):
        failed = ~valid | ~(np.abs(error) <= limit)
    figures["coverage"] = float(valid.mean())
    figures["failure_rate"] = float(failed.mean())
    figures["rmse_full"] = float(np.sqrt((np.where(valid, error, prior) ** 2).mean()))
    if not valid.any():
        return figures
    e, s, b = error[valid], sigma[valid], np.minimum(bound[valid], prior)
    figures["bias"], figures["rmse"] = float(e.mean()), float(np.sqrt((e**2).mean()))
    figures["mae"], figures["p95"] = float(np.abs(e).mean()), float(np.quantile(np.abs(e), 0.95))
    figures["z_rms"] = float(np.sqrt(((e / s) ** 2).mean()))
    figures["cover95"] = float((np.abs(e) <= 1.96 * s).mean())
    if np.isfinite(b).all():
        figures["bound"] = float(np.sqrt((b**2).mean()))
        fair = not bias_is_real(figures["bias"], figures["rmse"], e.size)
        if figures["coverage"] >= _EFFICIENT_COVERAGE and fair and figures["rmse"] > 0:
            square = (e / b) ** 2
            low, high = block_bootstrap_ratio(square, block[valid])
            figures["efficiency"] = float(1.0 / square.mean())
            figures["efficiency_lo"], figures["efficiency_hi"] = 1.0 / high, 1.0 / low
    return figures
