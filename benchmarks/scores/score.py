"""Scores of one estimate against the truth: every column of the table, separately for unmixed and mixed elements.

With e = estimate − truth over the n elements with truth, V the valid ones of these, b the bound and X the failure
threshold:

    coverage = |V|/n                    failure_rate = fraction of n invalid or with |e| > L,
                                        L = max(X, min(5 b, max(2 X, scale)))
    bias, rmse, mae, p95 over V         rmse_full: invalid elements count with the error of the best constant guess,
                                        at most window/√12 (`refusal_error`)
    bound = √mean(b²) over V            efficiency = 1/mean((e/b)²) over V, outliers included;
    z_rms = √mean((e/σ)²) over V        NaN where coverage < .99 or the bias is real
    cover95 = fraction of V with |e| ≤ 1.96 σ; both NaN where no σ is stated

A bias is real if |bias| exceeds .1 rmse by more than 3 standard errors, 3 rmse/√|V| (`statistics.pooled.bias_is_real`).
`efficiency_lo`, `_hi` are NaN if a few blocks of pixels hold most of the squared error (`concentrated`).
X is half of the bound's scale (for ranges ½·cσ_R/2n_g, σ_R the standard deviation of the response R), or the suite's
`failure_at`. L is five bounds, but not beyond the width of the echo: an estimate with a larger error follows something other
than the echo, and fails however weak the light is. `bound_kind` is "exact" or "quasi" if all elements of the row are regular,
i.e. if the Cramér-Rao bound can be reached, otherwise "ziv-zakai" or "bayes" (`bounds.regular`). A mixed element has several
true values, such as the ranges of two surfaces in one pixel. Its error is the signed distance to the nearest one, so that a
range in the gap between two surfaces is an error; no bound is asserted. A run with another status than "ok" has coverage 0
and failure rate 1.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

import numpy as np
import numpy.typing as npt

from ...captures.quantities import Quantity, Stage
from ..statistics.pooled import bias_is_real, block_bootstrap_ratio, block_ids
from .truth import Bound, Truth, aligned, errors_of, failure_limit, refusal_error

__all__ = ["ACCURACY", "COLUMNS", "KEY", "REGULAR_KINDS", "TIMES", "mixed_name", "score_rows"]

Float = npt.NDArray[np.float64]
Bool = npt.NDArray[np.bool_]

#: Key columns of a row, before `modality,quantity`.
KEY = (
    "suite", "scene", "stress", "level", "stress2", "level2", "seed", "condition", "stage", "estimator", "params",
)  # fmt: skip
COLUMNS = (
    *KEY, "modality", "quantity", "unit", "n", "coverage", "failure_rate", "failure_at", "bias", "rmse", "rmse_full",
    "mae", "p95", "bound", "bound_kind", "efficiency", "efficiency_lo", "efficiency_hi", "z_rms", "cover95", "cpu_s",
    "wall_s", "throughput", "peak_bytes", "status",
)  # fmt: skip
#: Columns that differ between two runs with equal seeds; all others are byte-identical on one machine.
TIMES = ("cpu_s", "wall_s", "throughput", "peak_bytes")
ACCURACY = tuple(name for name in COLUMNS if name not in TIMES)

#: Kinds of the bound of a row with regular elements only.
REGULAR_KINDS = ("exact", "quasi")

_EFFICIENT_COVERAGE = 0.99


def score_rows(
    key: dict[str, Any],
    stage: Stage,
    truth: Mapping[str, Truth],
    bound: Mapping[str, Bound],
    estimate: dict[str, npt.NDArray[Any]] | None,
    *,
    status: str,
    cpu_s: float = math.nan,
    wall_s: float = math.nan,
    peak_bytes: float = math.nan,
    failure_at: float | None = None,
) -> list[dict[str, Any]]:
    """The rows of one estimate: one per quantity of the stage with truth, and one for its mixed elements.

    Main arguments:
        key: values of the key columns except `stage`. stage: stage of the estimator.
        truth, bound: by name of the quantity; a quantity without truth has no row.
        estimate: the stage's variables by name, or None.
        status: "ok", or the reason of a failure; then the estimate is ignored.
    Other arguments:
        failure_at: see `failure_limit`; for the main quantity only.
    """
    rows: list[dict[str, Any]] = []
    for number, quantity in enumerate(stage.gives):
        if quantity.name not in truth:
            continue
        rows += _quantity_rows(
            quantity, truth[quantity.name], bound[quantity.name],
            None if status != "ok" or estimate is None
            else aligned(estimate, stage, quantity, truth[quantity.name].value.shape),
            failure_at if number == 0 else None,
        )  # fmt: skip
    common = {
        **key, "stage": stage.name, "modality": stage.modality, "cpu_s": cpu_s, "wall_s": wall_s,
        "peak_bytes": peak_bytes, "status": status,
    }  # fmt: skip
    for row in rows:
        row |= common
        row["throughput"] = row.pop("elements") / wall_s if wall_s > 0 else math.nan
    return [{name: row[name] for name in COLUMNS} for row in rows]


def _quantity_rows(
    quantity: Quantity, truth: Truth, bound: Bound, estimate: tuple[Float, Float, Bool] | None, failure_at: float | None
) -> list[dict[str, Any]]:
    """Scores of the elements with one true value, and of the mixed elements, if any."""
    shape = truth.value.shape
    has_truth = np.isfinite(truth.value)
    if estimate is None:
        nothing = np.full(shape, math.nan)
        estimate = nothing, nothing, np.zeros(shape, bool)
    value, sigma, valid = estimate
    errors = errors_of(value, truth)
    threshold = failure_at if failure_at is not None else 0.5 * bound.scale
    blocks = block_ids((shape[0], math.prod(shape[1:]))).reshape(shape)
    # x, y and z of a point are one element: time is counted once for them.
    elements = math.prod(shape[: len(shape) - len(quantity.components)])
    rows = []
    for name, chosen in (
        (quantity.name, has_truth & ~truth.mixed),
        (mixed_name(quantity.name), has_truth & truth.mixed),
    ):
        unmixed = name == quantity.name
        if not unmixed and not chosen.any():
            continue
        sigma_bound = bound.sigma[chosen] if unmixed else np.full(int(chosen.sum()), math.nan)
        figures = _figures(
            errors[chosen], sigma[chosen], valid[chosen], sigma_bound, blocks[chosen],
            failure_limit(sigma_bound, bound, failure_at), bound.prior,
            refusal_error(truth, chosen, bound),
        )  # fmt: skip
        figures["bound_kind"] = _kind(bound, sigma_bound) if unmixed else "none"
        rows.append({
            "quantity": name, "unit": quantity.unit, "failure_at": threshold, "elements": elements, **figures,
        })  # fmt: skip
    return rows


def mixed_name(quantity: str) -> str:
    """Name in the table of a quantity of mixed elements."""
    return f"{quantity}-mixed"


def _kind(bound: Bound, sigma: Float) -> str:
    """The kind of a bound whose elements are limited to the prior's error, which is then no longer exact."""
    return "quasi" if bound.kind == "exact" and np.any(sigma > bound.prior) else bound.kind


def _figures(
    error: Float,
    sigma: Float,
    valid: Bool,
    bound: Float,
    block: npt.NDArray[np.intp],
    limit: Float,
    prior: float,
    refusal: float,
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
    figures["rmse_full"] = float(np.sqrt((np.where(valid, error, refusal) ** 2).mean()))
    if not valid.any():
        return figures
    e, s, b = error[valid], sigma[valid], np.minimum(bound[valid], prior)
    figures["bias"], figures["rmse"] = float(e.mean()), float(np.sqrt((e**2).mean()))
    figures["mae"], figures["p95"] = float(np.abs(e).mean()), float(np.quantile(np.abs(e), 0.95))
    if np.isfinite(s).all():  # a program may state no sigma
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
