"""The phase of a sampled complex field by weighted least squares, and its branch points.

Where a field has zeros its phase is no function: around a zero it gains ±2π. With wrapped differences δ = arg(u_b u_a*)
between neighbours

    residue of a cell of 2 × 2 samples = (sum of δ around it)/2π ∈ {−1, 0, 1},
    φ = argmin Σ w (φ_b − φ_a − δ)²,

the gradient part of δ; the rotational part that branch points leave is not in φ. Solved by conjugate gradients with the
cosine transform as preconditioner, which is exact for a rectangle of even weight.

Sources: D. L. Fried and J. L. Vaughn, Appl. Opt. 31:2865, 1992 (branch points); D. C. Ghiglia and L. A. Romero, JOSA A
11:107, 1994.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.fft import dctn, idctn
from scipy.ndimage import label
from scipy.sparse.linalg import LinearOperator, cg

__all__ = ["at_branch_points", "least_squares_phase", "residues"]

Float = NDArray[np.float64]
Bool = NDArray[np.bool_]


def residues(field: ArrayLike) -> NDArray[np.int8]:
    """Charge (rows − 1, cols − 1) of the cell whose corners are (i, j) … (i + 1, j + 1): 1 where the phase gains 2π when
    going from x (columns) to y (rows), −1 the other way round."""
    across, down = _differences(_field(field))
    turn = across[:-1] + down[:, 1:] - across[1:] - down[:, :-1]
    return np.asarray(np.rint(turn / (2.0 * np.pi)), np.int8)


def at_branch_points(field: ArrayLike, mask: ArrayLike | None = None) -> Bool:
    """Whether a sample (rows, cols) is a corner of a cell with a residue; only cells that lie in `mask` count."""
    charge = residues(field) != 0
    if mask is not None:
        m = np.asarray(mask, bool)
        charge &= m[:-1, :-1] & m[1:, :-1] & m[:-1, 1:] & m[1:, 1:]
    out = np.zeros((charge.shape[0] + 1, charge.shape[1] + 1), bool)
    for i in (0, 1):
        for j in (0, 1):
            out[i : i + charge.shape[0], j : j + charge.shape[1]] |= charge
    return out


def least_squares_phase(
    field: ArrayLike,
    mask: ArrayLike | None = None,
    *,
    by_light: bool = False,
    tolerance: float = 1e-10,
    steps: int = 2000,
) -> Float:
    """φ (rows, cols) [rad], NaN outside `mask` and at branch points; of zero mean over each connected part of the mask.

    Main arguments:
        field (rows, cols): complex samples, close enough that neighbours differ by less than π away from zeros.

    Other arguments:
        mask (rows, cols): samples that count; all by default. by_light: w = |u_a u_b| instead of 1. tolerance: of the
        residual of the
            normal equations over its start. steps: at most.

    Raises ValueError for a field or mask of another shape, or where the steps do not suffice.
    """
    u = _field(field)
    inside = np.ones(u.shape, bool) if mask is None else np.asarray(mask, bool)
    if inside.shape != u.shape or not inside.any():
        raise ValueError(f"mask must have the field's shape {u.shape} and at least one sample, not {inside.shape}.")
    delta = _differences(u)
    pairs = (inside[:, 1:] & inside[:, :-1], inside[1:] & inside[:-1])
    size = np.abs(u)
    light = (size[:, 1:] * size[:, :-1], size[1:] * size[:-1])
    weight = [pair * (value if by_light else 1.0) for pair, value in zip(pairs, light, strict=True)]
    right = _against(weight[0] * delta[0], weight[1] * delta[1])
    phase = _solved(weight, right, tolerance, steps)
    part, count = label(inside)
    for k in range(1, count + 1):
        phase[part == k] -= phase[part == k].mean()
    return np.where(inside & ~at_branch_points(u, inside), phase, np.nan)


def _solved(weight: list[Float], right: Float, tolerance: float, steps: int) -> Float:
    shape = right.shape
    rows, cols = (4.0 * np.sin(0.5 * np.pi * np.arange(n) / n) ** 2 for n in shape)
    eigenvalue = rows[:, None] + cols[None, :]
    eigenvalue[0, 0] = np.inf
    mean = max(float(np.mean([w.mean() for w in weight if w.size])), 1e-300)

    def normal(flat: Float) -> Float:
        phi = flat.reshape(shape)
        return _against(weight[0] * np.diff(phi, axis=1), weight[1] * np.diff(phi, axis=0)).ravel()

    def rough(flat: Float) -> Float:
        return np.asarray(idctn(dctn(flat.reshape(shape), type=2) / eigenvalue, type=2) / mean).ravel()

    if not right.any():
        return np.zeros(shape)
    size = right.size
    operator: Any = LinearOperator((size, size), matvec=normal, dtype=np.float64)
    preconditioner: Any = LinearOperator((size, size), matvec=rough, dtype=np.float64)
    found, fault = cg(operator, right.ravel(), rtol=tolerance, atol=0.0, maxiter=steps, M=preconditioner)
    if fault:
        raise ValueError(f"The phase did not settle to tolerance = {tolerance!r} within steps = {steps!r}.")
    return np.asarray(found, np.float64).reshape(shape)


def _differences(u: NDArray[np.complex128]) -> tuple[Float, Float]:
    return np.angle(u[:, 1:] * np.conj(u[:, :-1])), np.angle(u[1:] * np.conj(u[:-1]))


def _against(across: Float, down: Float) -> Float:
    """Transpose of the differences of both axes."""
    out = np.zeros((across.shape[0], down.shape[1]))
    out[:, 1:] += across
    out[:, :-1] -= across
    out[1:] += down
    out[:-1] -= down
    return out


def _field(field: ArrayLike) -> NDArray[np.complex128]:
    u = np.asarray(field, np.complex128)
    if u.ndim != 2 or min(u.shape) < 2:
        raise ValueError(f"field needs two dimensions of at least 2 samples, not {u.shape}.")
    return u
