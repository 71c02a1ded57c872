"""Scores of range estimates with given truth and bound."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from beambench.benchmarks.scores.score import score_rows
from beambench.benchmarks.scores.truth import Bound, Truth
from beambench.captures.layouts import stage_of

RANGE = stage_of("gated")


def range_rows(
    key: Mapping[str, Any], truth: Truth, bound: Bound, estimate: dict[str, np.ndarray] | None, **options: Any
) -> list[dict[str, Any]]:
    """`score_rows` of one range estimate of an image."""
    return score_rows(dict(key), RANGE, {"range": truth}, {"range": bound}, estimate, **options)
