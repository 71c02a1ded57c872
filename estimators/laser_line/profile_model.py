"""The pixel-integrated Gaussian and its gradient, compiled, from a table of the normal distribution.

    μ_j = B + A [Φ(u_{j+1}) − Φ(u_j)],    u_j = (j − h − ½ − c)/s,    j = 0 … 2h.

Φ and its density φ come from their values at the nearest of nodes 1/128 apart and Taylor's series from there: the next terms are
below 1e-11, where `erf` and `exp` of the mathematics library cost five times as much.
"""

from __future__ import annotations

from functools import lru_cache

import numpy as np
import numpy.typing as npt
from scipy.special import ndtr

from ...optics.jit import kernel

__all__ = ["normal_table", "profile"]

Float = npt.NDArray[np.float64]

#: Nodes per unit, and where the table ends: Φ(−8.5) is 1e-17.
_PER_UNIT, _END = 128, 8.5


@lru_cache(maxsize=1)
def normal_table() -> tuple[Float, Float]:
    """(Φ, φ) at the nodes."""
    u = np.arange(-int(_END * _PER_UNIT), int(_END * _PER_UNIT) + 1) / _PER_UNIT
    return ndtr(u), np.exp(-0.5 * u * u) / np.sqrt(2.0 * np.pi)


@kernel(error_model="numpy", fastmath={"contract", "reassoc", "nsz"})
def profile(c, height, level, s, table, edge, mu, by_c, by_height, by_s):  # type: ignore[no-untyped-def]
    """μ (2h + 1) and its derivatives by c, A and ln s, into the four arrays; that by B is 1. `edge` (2, 2h + 2) is space."""
    size = mu.size
    per_s = 1.0 / s
    first = (-0.5 - size // 2 - c) * per_s
    areas, densities = table
    for j in range(size + 1):
        u = min(max(first + j * per_s, -8.49), 8.49)
        node = np.uint32((u + 8.5) * 128.0 + 0.5)
        at = node * 0.0078125 - 8.5
        d = u - at
        near = densities[node]
        t = -d * (at + 0.5 * d)
        edge[0, j] = areas[node] + near * d * (1.0 + d * (d * (at * at - 1.0) / 6.0 - 0.5 * at))
        edge[1, j] = near * (1.0 + t * (1.0 + t * (0.5 + t / 6.0)))
    for j in range(size):
        low = first + j * per_s
        share = edge[0, j + 1] - edge[0, j]
        by_height[j] = share
        by_c[j] = -height * per_s * (edge[1, j + 1] - edge[1, j])
        by_s[j] = -height * ((low + per_s) * edge[1, j + 1] - low * edge[1, j])
        mu[j] = level + height * share
