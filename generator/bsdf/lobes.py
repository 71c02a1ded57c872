"""Directions and densities that the reflection laws share: drjit arrays in the local frame, normal along z."""

from __future__ import annotations

from typing import Any

from ..rays.backend import mitsuba

__all__ = ["cosine_direction", "facet_density", "facet_direction", "reflect"]


def cosine_direction(point: Any) -> Any:
    """Direction with density cosθ/π."""
    return mitsuba().warp.square_to_cosine_hemisphere(point)


def facet_direction(point: Any, alpha: Any, ggx: bool) -> Any:
    """Facet normal with density D(h) cosθh: tan²θ = −α² ln(1 − u) (Beckmann) or α² u/(1 − u) (GGX)."""
    import drjit as dr

    u = dr.minimum(point.x, 1.0 - 6e-8)
    tan2 = dr.square(alpha) * (u / (1.0 - u) if ggx else -dr.log(1.0 - u))
    cosine = dr.rsqrt(1.0 + tan2)
    sine = dr.sqrt(tan2) * cosine
    sin_phi, cos_phi = dr.sincos(2.0 * dr.pi * point.y)
    return mitsuba().Vector3f(sine * cos_phi, sine * sin_phi, cosine)


def facet_density(cosine: Any, tan2: Any, alpha: Any, ggx: bool) -> Any:
    """D [1/sr] of facet normals with ∫ D cosθ dω = 1, from cosθ > 0 and tan²θ (accurate near 0, unlike 1 − cos²θ)."""
    import drjit as dr

    a2, c2 = dr.square(alpha), dr.square(cosine)
    if ggx:
        return a2 / (dr.pi * dr.square(c2 * (a2 + tan2)))
    # In logs: the exponential underflows where cos⁻⁴ overflows.
    return dr.exp(-tan2 / a2 - 2.0 * dr.log(c2)) / (dr.pi * a2)


def reflect(wi: Any, half: Any) -> Any:
    """wi mirrored at the facet."""
    import drjit as dr

    return 2.0 * dr.dot(wi, half) * half - wi
