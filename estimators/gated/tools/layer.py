"""The least squares of the learned estimator's layer: sums of products over the pixels, by one thread, block by block.

The products of numpy take all processors and wait for one another: where others use these, minutes go by in a single call, which
no signal ends. Here a block takes some hundredths of a second, and no matrix of all pixels is held.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import numpy.typing as npt

from ....optics.jit import kernel

__all__ = ["BLOCK", "normal_sums"]

Float = npt.NDArray[np.float64]
#: Most pixels of a block, and most products: between two blocks a signal ends the process, and progress is told.
BLOCK = 8192
_PRODUCTS = 120_000_000
#: Pixels whose rows stay in the cache of a processor while their products are added.
_ROWS = 32


@kernel(error_model="numpy")
def _add(features, targets, centre, scale, hidden, bias, products, right):  # type: ignore[no-untyped-def]
    n, units = centre.size, bias.size
    width = 1 + n + units
    x = np.empty((_ROWS, width))
    for begin in range(0, features.shape[0], _ROWS):
        rows = min(_ROWS, features.shape[0] - begin)
        for r in range(rows):
            p = begin + r
            x[r, 0] = 1.0
            for i in range(n):
                x[r, 1 + i] = (features[p, i] - centre[i]) * scale[i]
            for u in range(units):
                t = bias[u]
                for i in range(n):
                    t += hidden[u, i] * x[r, 1 + i]
                x[r, 1 + n + u] = np.tanh(t)
        for i in range(width):
            for r in range(rows):
                a = x[r, i]
                right[i] += a * targets[begin + r]
                for j in range(i, width):
                    products[i, j] += a * x[r, j]


def normal_sums(
    features: Float, targets: Float, layer: tuple[Float, Float, Float, Float], tell: Callable[[int], None]
) -> tuple[Float, Float]:
    """XᵀX and Xᵀy of the rows x = (1, f, tanh(H·f + b)), f the scaled features.

    layer: centre, scale (feature); H (unit, feature); b (unit). tell: receives the number of pixels so far, after each block.
    """
    width = 1 + layer[0].size + layer[3].size
    products, right = np.zeros((width, width)), np.zeros(width)
    block = max(1, min(BLOCK, _PRODUCTS // width**2))
    for begin in range(0, targets.size, block):
        end = min(begin + block, targets.size)
        _add(features[begin:end], targets[begin:end], *layer, products, right)
        tell(end)
    return np.triu(products) + np.triu(products, 1).T, right
