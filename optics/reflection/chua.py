"""The reflection law of Guo et al. 2017, Eq. 4, in named conventions.

    K_S/cos⁶θ · exp(−tan²θ/s²) + K_D cosᵐθ

It is stated for a coaxial rig: one θ is «the angle of incidence and reflection». Its specular term is Beckmann's
D/(4cos²θ) times 4πs²K_S, facets without masking: a BRDF, without foreshortening. Its diffuse term is Lambert's BRDF for
m = 0, and Lambert *with* foreshortening for m = 1. So at m = 0 both terms are BRDFs, and the convention "brdf" (or
"reciprocal") is the right reading; Eq. 6, which multiplies by no further cosθ, then lacks it. At m = 1 "as-printed-radiance"
makes the diffuse term right and the specular one too bright by 1/cosθ. The document gives no m, so the reading is a named choice.
"""

from __future__ import annotations

from typing import Literal

import numpy as np

from .angles import Angles, Array, lit, tangent_squared

__all__ = ["FIGURE_2_SURFACES", "Convention", "chua", "chua_printed"]

Convention = Literal["as-printed-radiance", "brdf", "reciprocal"]

#: Four surfaces as in Figure 2 of Guo et al. 2017: the two extremes and two mixtures. The text gives no numbers, only
#: that they differ in K_S/K_D; the values here are chosen to peak at one at θ = 0.
FIGURE_2_SURFACES: dict[str, dict[str, float]] = {
    "pure specular": {"k_s": 1.0, "k_d": 0.0, "slope": 0.3, "diffusivity": 1.0},
    "mixed, mostly specular": {"k_s": 0.7, "k_d": 0.3, "slope": 0.3, "diffusivity": 1.0},
    "mixed, mostly diffuse": {"k_s": 0.3, "k_d": 0.7, "slope": 0.3, "diffusivity": 1.0},
    "pure diffuse": {"k_s": 0.0, "k_d": 1.0, "slope": 0.3, "diffusivity": 1.0},
}


def chua_printed(
    cos_theta: Array, *, k_s: float | Array, k_d: float | Array, slope: float | Array, diffusivity: float | Array
) -> Array:
    """Eq. 4 as printed, of cosθ > 0 (any shape); zero for cosθ <= 0. Units: those of K_S and K_D [1/sr]."""
    c = np.maximum(cos_theta, 1e-150)
    log_c = np.log(c)
    # In logs: exp(−tan²θ/s²) underflows where cos⁻⁶θ overflows.
    specular = np.exp(-tangent_squared(c) / np.square(slope) - 6.0 * log_c)
    return np.where(np.asarray(cos_theta) > 0.0, k_s * specular + k_d * np.exp(diffusivity * log_c), 0.0)


def chua(
    angles: Angles,
    *,
    k_s: float | Array,
    k_d: float | Array,
    slope: float | Array,
    diffusivity: float | Array,
    convention: Convention,
) -> Array:
    """Response f·cosθi [1/sr] of Eq. 4.

    `convention`:
        "as-printed-radiance": the printed value is the response itself, as Eq. 6 uses it; no further cosθ.
        "brdf": the printed value is f; the response is f·cosθi.
        "reciprocal": f = K_S/(cos⁴θh cosθi cosθo)·exp(−tan²θh/s²) + K_D(cosθi cosθo)^{m/2}, times cosθi; equal to
            "brdf" for a coaxial rig, reciprocal and defined for any pair of directions.

    The first two are laws of one angle; apart from the coaxial direction they are evaluated at the angle of incidence,
    whatever the eye's direction, and are then not reciprocal. Energy: `albedo.albedo_limit` gives the largest
    hemispherical albedo. Raises ValueError for another convention.
    Source: Guo et al. 2017, Eq. 4 (from Chua et al., Sensors 17(9):2031, 2017); reciprocal form: this project.
    """
    above = lit(angles)
    ci = np.where(above, angles.cos_i, 1.0)
    if convention == "reciprocal":
        co = np.where(above, angles.cos_o, 1.0)
        ch = np.where(above, angles.cos_h, 1.0)
        log_pair = np.log(ci) + np.log(co)
        # f is unbounded at mirror grazing (no shadowing): the response there is capped at the largest double.
        exponent = -tangent_squared(ch) / np.square(slope) - 4.0 * np.log(np.maximum(ch, 1e-150)) - np.log(co)
        specular = np.exp(np.minimum(exponent, 700.0))
        diffuse = np.exp(0.5 * np.asarray(diffusivity) * log_pair) * ci
        return np.where(above, k_s * specular + k_d * diffuse, 0.0)
    value = chua_printed(ci, k_s=k_s, k_d=k_d, slope=slope, diffusivity=diffusivity)
    if convention == "brdf":
        value = value * ci
    elif convention != "as-printed-radiance":
        raise ValueError(f"unknown convention {convention!r}; allowed: as-printed-radiance, brdf, reciprocal")
    return np.where(above, value, 0.0)
