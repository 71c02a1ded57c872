"""Per-pixel gate offsets."""

from __future__ import annotations

import numpy as np
import pytest

from beambench.optics.correlation.gate_maps import gate_offset_map


def test_iris_and_skew() -> None:
    iris = gate_offset_map(5, 7, 2e-10, (0.0, 0.0))
    assert iris.shape == (5, 7)
    assert iris[2, 3] == 0.0
    np.testing.assert_allclose(iris, iris[::-1, ::-1], atol=0.0)
    # ρ² of the corner pixel's centre: (3² + 2²)/(3.5² + 2.5²)
    np.testing.assert_allclose(iris[0, 0], 2e-10 * 13.0 / 18.5, rtol=1e-14)
    skew = gate_offset_map(5, 7, 0.0, (1e-10, -3e-10))
    np.testing.assert_allclose(skew[2, :], 1e-10 * np.arange(-3, 4) / 3.5, rtol=1e-14, atol=1e-26)
    np.testing.assert_allclose(skew[:, 3], -3e-10 * np.arange(-2, 3) / 2.5, rtol=1e-14, atol=1e-26)


def test_bounds_and_zero() -> None:
    both = gate_offset_map(64, 48, 1e-10, (2e-10, 3e-10))
    assert np.max(np.abs(both)) < 6e-10
    assert not np.any(gate_offset_map(4, 4, 0.0, (0.0, 0.0)))
    assert gate_offset_map(1, 1, 1e-10, (1e-10, 1e-10))[0, 0] == 0.0
    with pytest.raises(ValueError, match="at least 1"):
        gate_offset_map(0, 4, 0.0, (0.0, 0.0))
