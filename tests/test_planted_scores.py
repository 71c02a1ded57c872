"""Efficiency and coverage of the score table where two formulas that look alike give different numbers."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from scipy.stats import norm

from beambench.benchmarks.scores.score import KEY
from beambench.benchmarks.scores.truth import Bound, Truth

from ._scores import range_rows


def scored(error: Any, sigma: Any, bound: Any) -> dict[str, Any]:
    """The row of errors (n), stated σ (n) and bounds (n), all valid; the prior, 100/√12, is far above all bounds."""
    e, s, b = (np.atleast_2d(np.asarray(a, np.float64)) for a in np.broadcast_arrays(error, sigma, bound))
    estimate = {"range": 5.0 + e, "sigma": s.copy(), "valid": np.ones(e.shape, bool)}
    (row,) = range_rows(
        dict.fromkeys(KEY, ""), Truth.plain(np.full(e.shape, 5.0)), Bound(b.copy(), "exact", 50.0, 100.0), estimate,
        status="ok",
    )  # fmt: skip
    return row


def test_efficiency_is_the_inverse_of_the_mean_ratio() -> None:
    """(e/b)² = 1, 1, ¼, ¼: mean 5/8, efficiency 8/5. A ratio of means would give (2·1 + 2·16)/(2·1 + 2·4) = 3.4."""
    row = scored([1.0, -1.0, 2.0, -2.0], 1.0, [1.0, 1.0, 4.0, 4.0])
    assert row["efficiency"] == pytest.approx(1.6, rel=1e-12)
    assert row["rmse"] == pytest.approx(math.sqrt(2.5), rel=1e-12)
    assert row["bound"] == pytest.approx(math.sqrt(8.5), rel=1e-12)


def test_cover95_ends_at_1_96_sigma() -> None:
    """|e| of 1.95 σ is covered, 1.97 σ is not: three of five. At 2.58 or at 1.645 σ it would be five or none."""
    row = scored([1.95, -1.95, 1.97, -1.97, 3.9], [1.0, 1.0, 1.0, 1.0, 2.0], 1.0)
    assert row["cover95"] == pytest.approx(0.6)
    # Quantiles of the normal law: of 9,999 errors at evenly spaced quantiles 95.0 % are covered, to one in 9,999.
    error = norm.ppf(np.arange(1, 10_000) / 10_000.0)
    assert scored(error, 1.0, 1.0)["cover95"] == pytest.approx(0.95, abs=2e-4)


def test_z_rms_divides_each_error_by_its_own_sigma() -> None:
    """e/σ = 1, −1, ½, −½: √(5/8). The ratio of rms values would be √(2.5/8.5)."""
    assert scored([1.0, -1.0, 2.0, -2.0], [1.0, 1.0, 4.0, 4.0], 1.0)["z_rms"] == pytest.approx(math.sqrt(0.625))


def test_a_bound_beyond_the_prior_is_held_at_it() -> None:
    """Bounds 1 and 400 with a prior of 100/√12 = 28.87: the second counts as 28.87."""
    row = scored([1.0, -1.0], 1.0, [1.0, 400.0])
    prior = 100.0 / math.sqrt(12.0)
    assert row["bound"] == pytest.approx(math.sqrt((1.0 + prior**2) / 2.0), rel=1e-12)
    assert row["bound_kind"] == "quasi"
