"""The bound of one parameter while the others are unknown, from the Fisher matrix of each element."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

__all__ = ["profiled_sigma"]

Float = npt.NDArray[np.float64]


def profiled_sigma(information: Float, gradient: Float) -> Float:
    """√(F⁻¹)₀₀ (shot) of F = Σ_k J_k a_k a_kᵀ; infinite if F has no inverse.

    Main arguments:
        information (shot, sample), gradient (parameter, shot, sample): σ is that of the first parameter.
    """
    f = np.einsum("psk,qsk,sk->spq", gradient, gradient, information)
    # Scaled to a unit diagonal first: the parameters differ by many orders.
    d = np.sqrt(np.maximum(np.diagonal(f, axis1=1, axis2=2), 1e-300))
    scaled = f / (d[:, :, None] * d[:, None, :])
    good = np.isfinite(scaled).all(axis=(1, 2)) & (np.abs(np.linalg.det(np.nan_to_num(scaled))) > 1e-12)
    inverse = np.linalg.inv(np.where(good[:, None, None], scaled, np.eye(f.shape[1])))
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.where(good, np.sqrt(inverse[:, 0, 0]) / d[:, 0], np.inf)
