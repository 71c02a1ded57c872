"""How much too bright or too dark a stack is, against references of other code, and what bias these could have seen.

Where both references of ε² = Σ(X − R₁)(X − R₂)/ΣR₁R₂ come from our own `full` rung, a systematic error of that rung is in X,
R₁ and R₂ alike and cancels: a rung that agrees with `full` is *self-consistent*, no more. With two independent stacks P₁, P₂ of
other code the scale of X is known:

    β = Σ X P̄/Σ P₁P₂ − 1,   P̄ = (P₁ + P₂)/2,

free of the noise of the references. A bias b is found with 95 % power at 95 % confidence where |b| ≥ (1.960 + 1.645) σ_β.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

__all__ = ["BIASES", "Bias", "scale_bias"]

Stack = NDArray[np.float32]

#: Biases of which it is stated whether they would have been seen, from the smallest.
BIASES = (0.01, 0.02, 0.05)

#: Standard errors of a bias that is found with 95 % power at 95 % confidence, two-sided.
_POWER = 1.960 + 1.645


@dataclass(frozen=True)
class Bias:
    """The scale error of a stack, relative: estimate and standard error."""

    value: float
    sigma: float

    @property
    def interval(self) -> tuple[float, float]:
        """95 % interval."""
        return self.value - 1.96 * self.sigma, self.value + 1.96 * self.sigma

    @property
    def seen(self) -> float:
        """The smallest of `BIASES` that would have been found; NaN where none would."""
        return next((bias for bias in BIASES if bias >= _POWER * self.sigma), float("nan"))


def scale_bias(x: Stack, one: Stack, two: Stack, seed: int = 0, draws: int = 400) -> Bias:
    """β of stack x (slices, rows, cols) against two independent stacks of other code, and its standard error by a bootstrap
    over pixels, whose noise is independent. Both are NaN where the references are dark."""
    a, b, c = (v.astype(np.float64).reshape(len(v), -1) for v in (x, one, two))
    above, below = np.sum(a * 0.5 * (b + c), axis=0), np.sum(b * c, axis=0)
    if not below.sum() > 0:
        return Bias(float("nan"), float("nan"))
    pick = np.random.default_rng(seed).multinomial(above.size, np.full(above.size, 1 / above.size), size=draws)
    ratios = (pick @ above) / np.maximum(pick @ below, 1e-300)
    return Bias(float(above.sum() / below.sum()) - 1.0, float(ratios.std(ddof=1)))
