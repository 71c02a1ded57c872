"""Rows of what was not scored: an estimator of another modality, or one whose package is not installed.

Such a row has a status "skip: reason", no elements and no figures, and takes no part in any ranking. An estimator that
gave up after too many exceeded limits is no such case: it had its chance, and scores as one that answered nothing.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from typing import Any

from ...estimators.labels import label_of

__all__ = ["GAVE_UP", "not_applicable", "skip_reason", "skipped_rows", "skips_of"]

#: How the status of a capture begins that was not tried, after an estimator exceeded its limits too often.
GAVE_UP = "skip: gave up after it exceeded its limits"

_FIGURES = (
    "coverage", "failure_rate", "failure_at", "bias", "rmse", "rmse_full", "mae", "p95", "bound", "efficiency",
    "efficiency_lo", "efficiency_hi", "z_rms", "cover95", "cpu_s", "wall_s", "throughput", "peak_bytes",
)  # fmt: skip


def not_applicable(status: str) -> bool:
    """Whether a status says that the estimator is none for this capture or machine (another modality, a package that is
    not installed): then it has no score. One that gave up does: it answered nothing."""
    return status.startswith("skip:") and not status.startswith(GAVE_UP)


def skip_reason(status: str) -> str:
    """Why a row was skipped, "" where it was not."""
    return status.removeprefix("skip:").strip() if status.startswith("skip:") else ""


def skipped_rows(rows: list[dict[str, Any]]) -> list[dict[str, Any]]:
    """The rows of one estimate; where its status says that it does not apply, one row without figures."""
    if not rows or not not_applicable(str(rows[0]["status"])):
        return rows
    return [{**rows[0], **dict.fromkeys(_FIGURES, math.nan), "n": 0, "bound_kind": "none"}]


def skips_of(rows: Iterable[Mapping[str, Any]]) -> list[dict[str, Any]]:
    """One record per estimator and reason: how many rows, and an example of where."""
    found: dict[tuple[str, str], dict[str, Any]] = {}
    for row in rows:
        status = str(row["status"])
        if reason := skip_reason(status):
            label = label_of(str(row["estimator"]), str(row["params"]))
            record = found.setdefault(
                (label, reason),
                {"estimator": label, "reason": reason, "rows": 0, "scene": str(row["scene"]),
                 "scored": status.startswith(GAVE_UP)},
            )  # fmt: skip
            record["rows"] += 1
    return list(found.values())
