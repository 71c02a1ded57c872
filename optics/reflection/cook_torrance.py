"""Cook-Torrance microfacets over a Lambert base.

Geometry: Smith's height-correlated masking and shadowing, G = 1/(1 + Λ(θi) + Λ(θo)) (Heitz 2014, eq. 99), with the
exact Λ of each distribution. Fresnel: Schlick 1994 from the reflectance at normal incidence `f0`.
"""

from __future__ import annotations

from typing import Literal

import numpy as np

from .angles import Angles, Array, lit, tangent_squared

__all__ = ["Distribution", "cook_torrance", "facet_density", "schlick"]

Distribution = Literal["beckmann", "ggx"]


def facet_density(cos_h: Array, roughness: float | Array, distribution: Distribution) -> Array:
    """Density D of facet normals [1/sr], ∫ D cosθ dω = 1 over the hemisphere; zero for cos_h <= 0.

    Beckmann: exp(−tan²θ/α²)/(πα²cos⁴θ) (Beckmann and Spizzichino 1963). GGX: α²/(π cos⁴θ (α² + tan²θ)²) (Walter et
    al., EGSR 2007, eq. 33). Raises ValueError for another name.
    """
    alpha2 = np.square(np.asarray(roughness, dtype=np.float64))
    c = np.maximum(cos_h, 1e-70)
    if distribution == "beckmann":
        # In logs: the exponential underflows where cos⁻⁴ overflows.
        density = np.exp(-tangent_squared(c) / alpha2 - 4.0 * np.log(c)) / (np.pi * alpha2)
    elif distribution == "ggx":
        c2 = c * c
        density = alpha2 / (np.pi * np.square(alpha2 * c2 + np.maximum(1.0 - c2, 0.0)))
    else:
        raise ValueError(f"unknown facet distribution {distribution!r}; allowed: beckmann, ggx")
    return np.where(cos_h > 0.0, density, 0.0)


def schlick(cos_d: Array, f0: float | Array) -> Array:
    """Fresnel reflectance f0 + (1 − f0)(1 − cosθd)⁵ (C. Schlick, Computer Graphics Forum 13(3), 1994, eq. 15)."""
    return np.asarray(f0 + (1.0 - np.asarray(f0)) * np.power(1.0 - cos_d, 5))


def _masking(c: Array, roughness: float | Array, distribution: Distribution) -> Array:
    """cosθ·Λ(θ): finite and accurate up to grazing, where Λ alone diverges."""
    s = np.sqrt(np.maximum(1.0 - c * c, 0.0))
    width = roughness * s
    if distribution == "ggx":
        # (√(c² + α²s²) − c)/2 without the cancellation at small roughness.
        return np.asarray(0.5 * width * width / (np.sqrt(c * c + width * width) + c))
    from scipy.special import erfc

    a = c / np.maximum(width, 1e-150)
    return np.asarray(np.maximum(0.5 * (width * np.exp(-a * a) / np.sqrt(np.pi) - c * erfc(a)), 0.0))


def cook_torrance(
    angles: Angles,
    *,
    diffuse_albedo: float | Array,
    f0: float | Array,
    roughness: float | Array,
    distribution: Distribution,
) -> Array:
    """Response f·cosθi [1/sr] with f = kd/π + F D G/(4 cosθi cosθo).

    Energy: the facets alone return at most 1 at any angle (light that facets send to other facets is lost), so
    kd + the facets' albedo ≤ 1 must hold; at grazing incidence F tends to 1, so a bright base under facets can exceed
    unity there: see `albedo.albedo_limit`. f is reciprocal.
    Sources: R. L. Cook and K. E. Torrance, ACM Trans. Graphics 1(1), 1982; E. Heitz, JCGT 3(2), 2014.
    """
    above = lit(angles)
    ci = np.where(above, angles.cos_i, 1.0)
    co = np.where(above, angles.cos_o, 1.0)
    density = facet_density(angles.cos_h, roughness, distribution)
    fresnel = schlick(angles.cos_d, f0)
    # G/(cosθi cosθo) = 1/(ci co + co·ciΛi + ci·coΛo), symmetric and finite at grazing.
    shade = ci * co + co * _masking(ci, roughness, distribution) + ci * _masking(co, roughness, distribution)
    f = diffuse_albedo / np.pi + 0.25 * fresnel * density / np.maximum(shade, 1e-300)
    return np.where(above, f * ci, 0.0)
