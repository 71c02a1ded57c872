"""Covariance of slopes that square lenslets average, for any structure function.

The mean gradient over a square of side d is the difference of the means of φ over its two opposite edges, over d. With ⟨φφ'⟩ → −D/2
the covariance of the x gradients of lenslets Δ apart is one integral,

    C_xx(Δ) = 1/(2d²) ∫₋₁¹ (1 − |t|) [D(Δx + d, Δy + td) + D(Δx − d, Δy + td) − 2 D(Δx, Δy + td)] dt,

C_yy with the axes exchanged, and C_xy a double integral over edges at right angles. [rad²/m²]; over k² [rad²].

Sources: D. L. Fried, Radio Sci. 10:71, 1975; E. P. Wallner, JOSA 73:1771, 1983; derived here.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import ArrayLike, NDArray

from .strength import positive

__all__ = ["gradient_covariance", "gradient_variance"]

Float = NDArray[np.float64]
Radial = Callable[[Float], Float]

_NODES = 24


def gradient_variance(structure: Radial, side_m: float) -> float:
    """Variance [rad²/m²] per axis of the mean gradient over one square lenslet; for Kolmogorov 6.405 d^{−1/3} r₀^{−5/3},
    which is .162 (λ/d)² (d/r₀)^{5/3} rad² as a slope."""
    return float(gradient_covariance(structure, np.zeros((1, 2)), side_m)[0, 0])


def gradient_covariance(structure: Radial, centres_m: ArrayLike, side_m: float) -> Float:
    """⟨g gᵀ⟩ (2·lenslets, 2·lenslets) [rad²/m²] of mean gradients, ordered (lenslet, axis), axis x then y.

    Main arguments:
        structure: D of separations [m] → rad². centres_m (lenslets, 2): x, y. side_m: d, sides parallel to x and y.

    Raises ValueError for centres of another shape or a side that is not positive.
    """
    centre, d = np.asarray(centres_m, np.float64), positive(side_m, "side_m")
    if centre.ndim != 2 or centre.shape[1] != 2:
        raise ValueError(f"centres_m needs the shape (lenslets, 2), not {centre.shape}.")
    apart = centre[:, None, :] - centre[None, :, :]
    # Equal differences (a regular grid has few) are computed once.
    key = np.rint(apart / (1e-9 * d)).astype(np.int64).reshape(-1, 2)
    _, first, inverse = np.unique(key, axis=0, return_index=True, return_inverse=True)
    dx, dy = apart.reshape(-1, 2)[first].T
    xx, yy, xy = _along(structure, dx, dy, d), _along(structure, dy, dx, d), _across(structure, dx, dy, d)
    n = len(centre)
    out = np.empty((n, 2, n, 2))
    for (i, j), value in (((0, 0), xx), ((1, 1), yy), ((0, 1), xy), ((1, 0), xy)):
        out[:, i, :, j] = value[np.ravel(inverse)].reshape(n, n)
    return np.asarray(out.reshape(2 * n, 2 * n))


def _along(structure: Radial, along: Float, across: Float, d: float) -> Float:
    """C of gradients along one axis, lenslets `along` and `across` apart."""
    t, weight = _tent_nodes()
    y = across[:, None] + t * d
    total = structure(np.hypot(along[:, None] + d, y)) + structure(np.hypot(along[:, None] - d, y))
    total = total - 2.0 * structure(np.hypot(along[:, None], y))
    return np.asarray(total @ weight / (2.0 * d * d))


def _across(structure: Radial, dx: Float, dy: Float, d: float) -> Float:
    """C_xy: edges along y of one lenslet with edges along x of the other; zero by symmetry for dx = 0 or dy = 0."""
    node, weight = np.polynomial.legendre.leggauss(_NODES)
    u, w = 0.5 * node, 0.5 * weight
    total = np.zeros(dx.size)
    for side, sign_a in ((0.5, 1.0), (-0.5, -1.0)):
        for end, sign_b in ((0.5, 1.0), (-0.5, -1.0)):
            # Points (side, u) d of one and (v, end) d of the other.
            x = dx[:, None, None] + d * (side - u[None, None, :])
            y = dy[:, None, None] + d * (u[None, :, None] - end)
            total += sign_a * sign_b * np.einsum("kuv,u,v->k", structure(np.hypot(x, y)), w, w)
    return np.asarray(-0.5 * total / (d * d))


def _tent_nodes() -> tuple[Float, Float]:
    """Nodes and weights of ∫₋₁¹ (1 − |t|) f(t) dt, denser at 0 where D has its cusp (t = ±s³)."""
    node, weight = np.polynomial.legendre.leggauss(_NODES)
    s, w = 0.5 * (node + 1.0), 0.5 * weight
    t, jacobian = s**3, 3.0 * s**2 * w
    return np.concatenate([-t, t]), np.concatenate([jacobian * (1.0 - t)] * 2)
