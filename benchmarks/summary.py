"""summary.csv: seeds pooled per scene, stress level, condition and estimator, with intervals.

Squares are pooled as squares (weights: elements). Rates have Wilson intervals on the number of elements; `rmse_full`
and `efficiency` have t intervals over seeds, which is what varies independently, and none with one seed. `regular` is
the share of seeds whose bound is the Cramér-Rao bound, reached by an efficient estimator ("exact", "quasi"); `bound_kind`
is the weakest of theirs.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from typing import Any

import numpy as np

from .inference_rates import wilson_interval
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

#: What a pooled bound may still be called.
_WEAKEST_FIRST = ("none", "ziv-zakai", "bayes", "quasi", "exact")


def _t_interval(values: list[float]) -> tuple[float, float]:
    """95 % t interval of the mean of a few independent values."""
    from scipy.stats import t

    if len(values) < 2:
        return math.nan, math.nan
    mean, error = float(np.mean(values)), float(np.std(values, ddof=1)) / math.sqrt(len(values))
    half = float(t.ppf(0.975, len(values) - 1)) * error
    return mean - half, mean + half


def _mean(values: list[float], weights: list[float]) -> float:
    pairs = [(v, w) for v, w in zip(values, weights, strict=True) if not math.isnan(v) and w > 0]
    return sum(v * w for v, w in pairs) / sum(w for _, w in pairs) if pairs else math.nan


def summarise(rows: Iterable[dict[str, Any]]) -> list[dict[str, Any]]:
    """Pool the seeds of each cell; the order of first appearance is kept."""
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
    coverage, failure = _mean(column("coverage"), n), _mean(column("failure_rate"), n)
    full = [v for v in column("rmse_full") if not math.isnan(v)]
    inverse = [1.0 / v for v in column("efficiency")]
    whole = inverse if not any(map(math.isnan, inverse)) else []
    low, high = _t_interval(whole)
    coverage_lo, coverage_hi = wilson_interval(coverage * total, total) if total else (math.nan, math.nan)
    failure_lo, failure_hi = wilson_interval(failure * total, total) if total else (math.nan, math.nan)
    full_lo, full_hi = _t_interval(full)
    cpu = [v for v in column("cpu_s") if not math.isnan(v)]
    one = len(group) == 1
    kinds = [str(row["bound_kind"]) for row in group]
    bad = sorted({str(row["status"]) for row in group} - {"ok"})
    return {
        **{name: first[name] for name in _GROUP},
        "seeds": len(group), "n": total,
        "coverage": coverage, "coverage_lo": coverage_lo, "coverage_hi": coverage_hi,
        "failure_rate": failure, "failure_rate_lo": failure_lo, "failure_rate_hi": failure_hi,
        "bias": _mean(column("bias"), valid),
        "rmse": math.sqrt(_mean([v * v for v in column("rmse")], valid)),
        "rmse_full": math.sqrt(_mean([v * v for v in column("rmse_full")], n)),
        "rmse_full_lo": max(full_lo, 0.0), "rmse_full_hi": full_hi,
        "bound": math.sqrt(_mean([v * v for v in column("bound")], valid)),
        "bound_kind": min(kinds, key=_WEAKEST_FIRST.index),
        "regular": _mean([math.nan if k == "none" else float(k in REGULAR_KINDS) for k in kinds], [1.0] * len(kinds)),
        "efficiency": 1.0 / float(np.mean(whole)) if whole else math.nan,
        # With one seed the interval is the one over blocks of pixels; an interval of 1/efficiency is inverted.
        "efficiency_lo": float(first["efficiency_lo"]) if one else 1.0 / high,
        "efficiency_hi": float(first["efficiency_hi"]) if one else (1.0 / low if low > 0 else math.nan),
        "z_rms": math.sqrt(_mean([v * v for v in column("z_rms")], valid)),
        "cover95": _mean(column("cover95"), valid),
        "cpu_s": float(np.median(cpu)) if cpu else math.nan,
        "cpu_s_lo": min(cpu, default=math.nan), "cpu_s_hi": max(cpu, default=math.nan),
        "throughput": float(np.median(column("throughput"))),
        "peak_bytes": max(column("peak_bytes")),
        "status": "; ".join(bad) or "ok",
    }  # fmt: skip
