"""Direction cosines of a reflection, the one input of every BRDF here.

`wi` points from the surface to the light, `wo` from the surface to the eye, both of unit length, in any frame.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

__all__ = ["Angles", "Array", "angles", "lit", "monostatic", "tangent_squared"]

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class Angles:
    """Direction cosines, arrays of one broadcast shape.

    `cos_i` = n·wi, `cos_o` = n·wo, `cos_h` = n·h, `cos_d` = wi·h, `cos_r` = mirror(wi)·wo, with h the unit half vector
    of wi and wo and mirror(wi) = 2(n·wi)n − wi.
    """

    cos_i: Array
    cos_o: Array
    cos_h: Array
    cos_d: Array
    cos_r: Array


def angles(normal: ArrayLike, wi: ArrayLike, wo: ArrayLike) -> Angles:
    """Angles of unit vectors `normal`, `wi`, `wo`, each (..., 3), broadcast together; results are (...).

    Where wi = −wo the half vector does not exist; one of the two is then below the surface (or both are tangent to it),
    the response is zero, and the cosines of h are set to zero.
    """
    n, i, o = (np.asarray(v, dtype=np.float64) for v in (normal, wi, wo))
    cos_i, cos_o, cos_io = (np.einsum("...k,...k->...", a, b) for a, b in ((n, i), (n, o), (i, o)))
    half = i + o
    length = np.sqrt(np.einsum("...k,...k->...", half, half))
    safe = np.where(length > 0.0, length, np.inf)
    cos_h = np.clip((cos_i + cos_o) / safe, -1.0, 1.0)
    cos_d = np.clip(0.5 * length, 0.0, 1.0)  # |wi + wo| = 2 wi·h
    cos_r = np.clip(2.0 * cos_i * cos_o - cos_io, -1.0, 1.0)
    out = np.broadcast_arrays(cos_i, cos_o, cos_h, cos_d, cos_r)
    return Angles(*(np.asarray(v) for v in out))


def monostatic(cos_theta: ArrayLike) -> Angles:
    """Angles of a coaxial rig: wi = wo at θ from the normal, any shape."""
    c = np.asarray(cos_theta, dtype=np.float64)
    return Angles(cos_i=c, cos_o=c, cos_h=c, cos_d=np.ones_like(c), cos_r=2.0 * c * c - 1.0)


def lit(a: Angles) -> NDArray[np.bool_]:
    """True where both light and eye are above the surface: elsewhere every response is zero."""
    return (a.cos_i > 0.0) & (a.cos_o > 0.0)


def tangent_squared(cosine: Array) -> Array:
    """tan² of an angle from its cosine, finite for any cosine above 1e-150."""
    c2 = np.square(np.maximum(cosine, 1e-150))
    return np.maximum(1.0 - c2, 0.0) / c2
