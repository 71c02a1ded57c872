"""How far a stack is from the truth, by two independent references: relative, in units of the noise, and in the answer."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ...scenes.rigs.gated import gated_rig
from ...scenes.scene import Scene
from ..noise import noise_variance
from ..random import resampler

__all__ = ["relative_noise", "replicate_error", "stack_error", "task_error"]

Float = NDArray[np.float64]
Stack = NDArray[np.float32]


def stack_error(x: Stack, one: Stack, two: Stack, seed: int = 0, draws: int = 400) -> tuple[float, float, float]:
    """ε of stack x (slices, rows, cols) against two independent references, ε² = Σ(x − R₁)(x − R₂)/ΣR₁R₂, and its 95 %
    interval by a bootstrap over pixels. What is negative by noise is zero."""
    a, b, c = (v.astype(np.float64).reshape(len(v), -1) for v in (x, one, two))
    above, below = np.sum((a - b) * (a - c), axis=0), np.sum(b * c, axis=0)
    if not below.sum() > 0:
        return 0.0, 0.0, 0.0
    pick = resampler(seed).multinomial(above.size, np.full(above.size, 1 / above.size), size=draws)
    ratios = (pick @ above) / np.maximum(pick @ below, 1e-300)
    low, high = np.sqrt(np.maximum(np.percentile(ratios, [2.5, 97.5]), 0.0))
    return float(np.sqrt(max(float(above.sum() / below.sum()), 0.0))), float(low), float(high)


def replicate_error(x: Stack, ones: Stack, twos: Stack) -> tuple[float, float, float]:
    """ε of this very stack x (slices, rows, cols), and its 95 % interval by the references' noise alone.

    Main arguments:
        ones, twos (2, slices, rows, cols): two independent replicates of R₁ and of R₂; R₁ and R₂ are their means.

    A pixel's Σ(x − R₁)(x − R₂) from the first replicates and that from the second differ by noise alone, d; pixels are
    independent, so that the variance of the sum's mean is Σd²/4 (more than that of the product of the means, which is used).
    """
    a, one, two = (v.astype(np.float64) for v in (x, ones, twos))
    below = float(np.sum(one.mean(axis=0) * two.mean(axis=0)))
    if not below > 0:
        return 0.0, 0.0, 0.0
    square = float(np.sum((a - one.mean(axis=0)) * (a - two.mean(axis=0)))) / below
    by_pixel = np.sum((a - one) * (a - two), axis=1)
    spread = 1.96 * 0.5 * float(np.sqrt(np.sum((by_pixel[0] - by_pixel[1]) ** 2))) / below
    error, low, high = np.sqrt(np.maximum([square, square - spread, square + spread], 0.0))
    return float(error), float(low), float(high)


def task_error(x: Stack, references: tuple[Stack, Stack], slope: Stack, variance: Float | Stack) -> float:
    """Bias that the error of stack x causes in the time of a maximum-likelihood estimate, in units of its bound:
    sqrt of the mean over pixels of |Σ ∂S·ΔS/V|²/J, J = Σ(∂S)²/V.

    Main arguments (slices, rows, cols):
        references: R₁ and R₂; one factor of the square is taken against each, so that their noise drops out.
        slope: dS/dτ of the target's own return; pixels without are left out.
        variance: V of a sample, electrons².
    """
    d, v = slope.astype(np.float64), np.maximum(np.asarray(variance, dtype=np.float64), 1e-12)
    information = np.sum(d * d / v, axis=0)
    one, two = (np.sum(d * (x.astype(np.float64) - r) / v, axis=0) for r in references)
    # Pixels that hold no signal have no answer to bias.
    seen = information > 1e-6 * information.max(initial=0.0)
    if not seen.any():
        return 0.0
    return float(np.sqrt(max(float(np.mean((one * two)[seen] / information[seen])), 0.0)))


def relative_noise(scene: Scene, electrons: Float) -> float:
    """rms of the detector's noise relative to the rms of the signal `electrons`, within 1e-4 … 0.5."""
    mean_square = float(np.mean(electrons**2))
    variance = noise_variance(gated_rig(scene).detector, electrons)
    return float(np.clip(np.sqrt(np.mean(variance) / mean_square), 1e-4, 0.5)) if mean_square > 0 else 0.5
