"""Rows that are better than their bound by more than chance, and rows without any error: not ranked until they are explained.

n (rmse/bound)² of n independent Gaussian errors of an estimator at its bound follows χ²(n). A row is beyond its bound where
bound²/rmse² exceeds both n/χ²(n) at a probability of 10⁻⁶ and a factor that depends on the kind of the bound: 1.2 for an exact
one, for errors that are correlated; 4 (half the error) for one that holds approximately ("quasi"). Bounds on average over the
window ("ziv-zakai", "bayes") condemn nobody: truth lies in a part of the window, where a row may err less, and who answers
only what is sure beats the average of all without knowing the truth (`amcw-ml` at 15 µW: .02 m of the answered 70 %, 5.6 m on
average over 55 m). The rule needs neither full coverage nor an error without bias, as `efficiency` does, so that neither a few
refusals nor a small offset hides a row. It cannot tell a smoother, which gives up resolution, from an estimator that knows the
truth: both are shown with the reason, and people decide.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from typing import Any

from ...estimators.labels import label_of

__all__ = ["EXACT", "beyond", "suspicion", "suspects_of"]

#: Probability that chance alone takes an efficient estimator beyond the limit, per row.
_CHANCE = 1e-6
_FACTORS = {"exact": 1.2, "quasi": 4.0}
#: The suspicion of a row without any error.
EXACT = "rmse 0"


def beyond(rmse: float, bound: float, n: float, kind: str) -> float:
    """bound²/rmse² where it is beyond the limit above, else 0.

    Main arguments:
        rmse, bound: over the same n valid elements, in one unit; NaN is never beyond. kind: of the bound.
    """
    if not (rmse > 0 and bound > 0 and n >= 1 and kind in _FACTORS) or not math.isfinite(bound):
        return 0.0
    excess = (bound / rmse) ** 2
    if excess <= _FACTORS[kind]:
        return 0.0
    from scipy.special import gammaincinv

    return excess if excess > n / float(2.0 * gammaincinv(0.5 * n, _CHANCE)) else 0.0


def suspicion(rmse: float, bound: float, n: float, kind: str) -> str:
    """Why a row is not ranked, or "". Arguments as for `beyond`; a bound of 0 (no noise) allows an error of 0."""
    if n >= 1 and rmse == 0 and bound != 0:
        return EXACT
    excess = beyond(rmse, bound, n, kind)
    return f"mean square {excess:.3g} times below the {kind} bound" if excess else ""


def suspects_of(rows: Iterable[Mapping[str, Any]]) -> dict[str, str]:
    """{label: why} of the estimators that are suspect in a scene, from rows of one quantity and condition, seeds pooled."""
    from .pooled import weakest_kind

    cells: dict[tuple[str, ...], list[Mapping[str, Any]]] = {}
    for row in rows:
        label = label_of(str(row["estimator"]), str(row["params"]))
        cells.setdefault((label, *(str(row[name]) for name in _CELL)), []).append(row)
    found: dict[str, str] = {}
    for key, cell in cells.items():
        valid = [float(row["n"]) * float(row["coverage"]) if float(row["n"]) > 0 else 0.0 for row in cell]
        answered = [(row, count) for row, count in zip(cell, valid, strict=True) if count > 0]
        total = sum(count for _, count in answered)
        if not total:
            continue
        rmse, bound = (
            math.sqrt(sum(count * float(row[name]) ** 2 for row, count in answered) / total)
            for name in ("rmse", "bound")
        )
        kind = weakest_kind(str(row["bound_kind"]) for row, _ in answered)
        # One seed that is suspect is not hidden by others.
        reasons = [
            suspicion(float(row["rmse"]), float(row["bound"]), count, str(row["bound_kind"])) for row, count in answered
        ]
        if reason := next(filter(None, [*reasons, suspicion(rmse, bound, total, kind)]), ""):
            found.setdefault(key[0], f"{key[1]}: {reason}")
    return found


_CELL = ("scene", "stress", "level", "stress2", "level2")
