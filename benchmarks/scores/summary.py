"""summary.csv: seeds pooled per scene, stress level, condition and estimator, with intervals.

Mean squares are pooled, weighted by the number of elements. Only seeds are independent, so that all intervals are over seeds,
and a single seed has none. Rates have the interval of proportions in clusters (`clustered_interval`; if no element failed, or
all did, each seed counts as one element), `rmse_full` Student's t of the logarithm of the mean square, and `efficiency` that
of its inverse. An efficiency is NaN if a seed has none or if the pooled bias is real (`statistics.bias_is_real`); its interval
is NaN if few seeds hold most of the squared error (`statistics.concentrated`). With one seed the interval of the efficiency
is the one over blocks of pixels. `regular` is the fraction of seeds whose bound is the Cramér-Rao bound, which an efficient
estimator reaches ("exact", "quasi"); `bound_kind` is the weakest kind of all seeds.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from typing import Any

import numpy as np

from ..statistics.pooled import bias_is_real, concentrated, weakest_kind
from ..statistics.rates import clustered_interval, wilson_interval
from .score import REGULAR_KINDS

__all__ = ["SUMMARY_COLUMNS", "summarise", "wilson_interval"]

_GROUP = (
    "suite", "scene", "stress", "level", "stress2", "level2", "condition", "stage", "estimator", "params", "modality",
    "quantity", "unit",
)  # fmt: skip
SUMMARY_COLUMNS = (
    *_GROUP, "seeds", "n", "coverage", "coverage_lo", "coverage_hi", "failure_rate", "failure_rate_lo",
    "failure_rate_hi",
    "bias", "rmse", "rmse_full", "rmse_full_lo", "rmse_full_hi", "bound", "bound_kind", "regular", "efficiency",
    "efficiency_lo", "efficiency_hi", "z_rms", "cover95", "cpu_s", "cpu_s_lo", "cpu_s_hi", "throughput", "peak_bytes", "status",
)  # fmt: skip


def _mean_interval(values: list[float], weights: list[float]) -> tuple[float, float]:
    """95 % interval of the mean Σ w v/Σ w of non-negative values of independent seeds; it contains that mean.

    Student's t of the logarithm, linearised, because squares are skewed and not negative. (NaN, NaN) with one seed.
    """
    from scipy.special import stdtrit

    pairs = [(v, w) for v, w in zip(values, weights, strict=True) if not math.isnan(v) and w > 0]
    if len(pairs) < 2:
        return math.nan, math.nan
    value, weight = np.array(pairs).T
    share = weight / weight.sum()
    mean = float((share * value).sum())
    if mean == 0:
        return 0.0, 0.0
    spread = float(((share * (value / mean - 1.0)) ** 2).sum()) * len(pairs) / (len(pairs) - 1)
    half = float(stdtrit(len(pairs) - 1, 0.975)) * math.sqrt(spread)
    return mean * math.exp(-half), mean * math.exp(half)


def _mean(values: list[float], weights: list[float]) -> float:
    pairs = [(v, w) for v, w in zip(values, weights, strict=True) if not math.isnan(v) and w > 0]
    return sum(v * w for v, w in pairs) / sum(w for _, w in pairs) if pairs else math.nan


def summarise(rows: Iterable[dict[str, Any]]) -> list[dict[str, Any]]:
    """Pool the seeds of each cell, in the order of first appearance."""
    groups: dict[tuple[Any, ...], list[dict[str, Any]]] = {}
    for row in rows:
        groups.setdefault(tuple(str(row[name]) for name in _GROUP), []).append(row)
    return [_pool(group) for group in groups.values()]


def _pool(group: list[dict[str, Any]]) -> dict[str, Any]:
    def column(name: str) -> list[float]:
        return [float(row[name]) for row in group]

    first, n = group[0], column("n")
    valid = [count * c if not math.isnan(c) else 0.0 for count, c in zip(n, column("coverage"), strict=True)]
    total = int(sum(n))
    (coverage, coverage_lo, coverage_hi), (failure, failure_lo, failure_hi) = (
        clustered_interval(np.array(column(name)) * n, n) for name in ("coverage", "failure_rate")
    )
    bias, rmse = _mean(column("bias"), valid), math.sqrt(_mean([v * v for v in column("rmse")], valid))
    full_lo, full_hi = map(math.sqrt, _mean_interval([v * v for v in column("rmse_full")], n))
    inverse = [1.0 / v for v in column("efficiency")]
    whole = [] if any(map(math.isnan, inverse)) or bias_is_real(bias, rmse, sum(valid)) else inverse
    low, high = _mean_interval(whole, [1.0] * len(whole)) if whole and not concentrated(whole) else (math.nan, math.nan)
    cpu, speed, memory = (
        [v for v in column(name) if not math.isnan(v)] for name in ("cpu_s", "throughput", "peak_bytes")
    )
    one = len(group) == 1
    kinds = [str(row["bound_kind"]) for row in group]
    bad = sorted({str(row["status"]) for row in group} - {"ok"})
    return {
        **{name: first[name] for name in _GROUP},
        "seeds": len(group), "n": total,
        "coverage": coverage, "coverage_lo": coverage_lo, "coverage_hi": coverage_hi,
        "failure_rate": failure, "failure_rate_lo": failure_lo, "failure_rate_hi": failure_hi,
        "bias": bias, "rmse": rmse,
        "rmse_full": math.sqrt(_mean([v * v for v in column("rmse_full")], n)),
        "rmse_full_lo": full_lo, "rmse_full_hi": full_hi,
        "bound": math.sqrt(_mean([v * v for v in column("bound")], valid)),
        "bound_kind": weakest_kind(kinds),
        "regular": _mean([math.nan if k == "none" else float(k in REGULAR_KINDS) for k in kinds], [1.0] * len(kinds)),
        "efficiency": 1.0 / float(np.mean(whole)) if whole else math.nan,
        # The interval is that of 1/efficiency, inverted.
        "efficiency_lo": float(first["efficiency_lo"]) if one else 1.0 / high,
        "efficiency_hi": float(first["efficiency_hi"]) if one else 1.0 / low,
        "z_rms": math.sqrt(_mean([v * v for v in column("z_rms")], valid)),
        "cover95": _mean(column("cover95"), valid),
        "cpu_s": float(np.median(cpu)) if cpu else math.nan,
        "cpu_s_lo": min(cpu, default=math.nan), "cpu_s_hi": max(cpu, default=math.nan),
        "throughput": float(np.median(speed)) if speed else math.nan,
        "peak_bytes": max(memory, default=math.nan),
        "status": "; ".join(bad) or "ok",
    }  # fmt: skip
