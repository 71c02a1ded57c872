"""Compiled lookups in a cubic Hermite table of R(u). LLVM inlines them where other kernels call them."""

from __future__ import annotations

from typing import Any

from ..jit import kernel

__all__ = ["hermite_slope", "hermite_value"]


@kernel
def hermite_value(start: float, inv_step: float, value: Any, slope: Any, u: float) -> float:
    """R(u) from a table: `start` [s], `inv_step` [1/s], `value`(n), `slope`(n) [1/s], `u` [s].

    Outside the table the result is the value of the nearest end (of the first node for NaN); tables of `tabulate` end
    in zeros.
    """
    last = value.size - 1
    x = (u - start) * inv_step
    x = x if x > 0.0 else 0.0  # also catches NaN
    i = min(int(min(x, float(last))), last - 1)
    s = min(x - i, 1.0)
    a = value[i]
    b = value[i + 1]
    h = 1.0 / inv_step
    ma = slope[i] * h
    mb = slope[i + 1] * h
    d = b - a
    return a + s * (ma + s * (3.0 * d - 2.0 * ma - mb + s * (ma + mb - 2.0 * d)))  # type: ignore[no-any-return]


@kernel
def hermite_slope(start: float, inv_step: float, value: Any, slope: Any, u: float) -> float:
    """dR/du [1/s]: the derivative of `hermite_value` inside the table, the slope of the end (zero) outside."""
    last = value.size - 1
    x = (u - start) * inv_step
    x = x if x > 0.0 else 0.0
    i = min(int(min(x, float(last))), last - 1)
    s = min(x - i, 1.0)
    h = 1.0 / inv_step
    ma = slope[i] * h
    mb = slope[i + 1] * h
    d = value[i + 1] - value[i]
    return inv_step * (ma + s * (2.0 * (3.0 * d - 2.0 * ma - mb) + 3.0 * s * (ma + mb - 2.0 * d)))  # type: ignore[no-any-return]
