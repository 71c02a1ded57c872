"""Cook-Torrance microfacets over a Lambert base.

Fresnel: Schlick 1994 from the reflectance at normal incidence `f0`. Masking and shadowing by Smith's Λ, exact for each
distribution, in one of two named forms:

"height-correlated": G = 1/(1 + Λ(θi) + Λ(θo)) (Heitz 2014, eq. 99). Facets are correlated in height; the two directions
    are taken as independent. The usual form, right for directions far apart.
"height-direction-correlated": G = 1/(1 + max Λ + λ min Λ), λ = 4.41φ/(4.41φ + 1), φ the angle between the azimuths of the two
    directions (van Ginneken, Stavridi and Koenderink, Appl. Opt. 37:130, 1998; Heitz 2014). For φ = 0 it is exact: the facets
    that the steeper direction sees, the other one sees too. So a coaxial rig (ωi = ωo) has G = 1/(1 + Λ).

A coaxial rig sees facets brighter than the first form says, by (1 + 2Λ)/(1 + Λ). Its inverse, the first form over the exact one:

    roughness            60°    70°    80°
    Beckmann  .2       1.000   .999   .962
    Beckmann  .5        .987   .934   .779
    Beckmann 1          .889   .785   .652
    GGX       .2        .972   .938   .831
    GGX       .5        .878   .794   .666
    GGX      1          .750   .671   .587
"""

from __future__ import annotations

from typing import Literal

import numpy as np

from .angles import Angles, Array, lit, tangent_squared

__all__ = ["Distribution", "Masking", "cook_torrance", "facet_density", "schlick"]

Distribution = Literal["beckmann", "ggx"]
Masking = Literal["height-correlated", "height-direction-correlated"]


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


def _independence(angles: Angles, ci: Array, co: Array) -> Array:
    """λ of two directions: 0 where their azimuths are equal, .93 where they are opposite."""
    across = np.sqrt(np.maximum(1.0 - ci * ci, 0.0) * np.maximum(1.0 - co * co, 0.0))
    # wi·wo = 2 (wi·h)² − 1 = cosθi cosθo + sinθi sinθo cosφ; at the normal Λ = 0, whatever φ.
    cosine = (2.0 * np.square(angles.cos_d) - 1.0 - ci * co) / np.maximum(across, 1e-150)
    apart = 4.41 * np.arccos(np.clip(cosine, -1.0, 1.0))
    return np.asarray(apart / (apart + 1.0))


def cook_torrance(
    angles: Angles,
    *,
    diffuse_albedo: float | Array,
    f0: float | Array,
    roughness: float | Array,
    distribution: Distribution,
    masking: Masking = "height-correlated",
) -> Array:
    """Response f·cosθi [1/sr] with f = kd/π + F D G/(4 cosθi cosθo), G as named by `masking` (see the module).

    Energy: the facets alone return at most 1 at any angle (light that facets send to other facets is lost), so
    kd + the facets' albedo ≤ 1 must hold; at grazing incidence F tends to 1, so a bright base under facets can exceed
    unity there: see `albedo.albedo_limit`. f is reciprocal. Raises ValueError for another name of a distribution or masking.
    Sources: R. L. Cook and K. E. Torrance, ACM Trans. Graphics 1(1), 1982; E. Heitz, JCGT 3(2), 2014.
    """
    above = lit(angles)
    ci = np.where(above, angles.cos_i, 1.0)
    co = np.where(above, angles.cos_o, 1.0)
    density = facet_density(angles.cos_h, roughness, distribution)
    fresnel = schlick(angles.cos_d, f0)
    # cosθi cosθo/G = ci co + co·ciΛi + ci·coΛo (or with max and λ min), symmetric and finite at grazing.
    first, second = co * _masking(ci, roughness, distribution), ci * _masking(co, roughness, distribution)
    if masking == "height-direction-correlated":
        hidden = np.maximum(first, second) + _independence(angles, ci, co) * np.minimum(first, second)
    elif masking == "height-correlated":
        hidden = first + second
    else:
        raise ValueError(f"unknown masking {masking!r}; allowed: height-correlated, height-direction-correlated")
    shade = ci * co + hidden
    f = diffuse_albedo / np.pi + 0.25 * fresnel * density / np.maximum(shade, 1e-300)
    return np.where(above, f * ci, 0.0)
