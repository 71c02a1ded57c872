"""Surface materials: parameters of the reflection laws in `optics`. BRDF in 1/sr; θ is the angle from the normal."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field, model_validator

from .base import Fraction, NonNegative, Positive, Spec

__all__ = ["Chua", "CookTorrance", "Lambert", "Material", "Phong"]


class Lambert(Spec):
    """Ideal diffuse surface: f = albedo/π."""

    kind: Literal["lambert"] = "lambert"
    albedo: Fraction


class Phong(Spec):
    """Normalised Phong (Lafortune and Willems 1994): f = kd/π + ks (n+2)/(2π) cosⁿα, kd + ks ≤ 1."""

    kind: Literal["phong"] = "phong"
    diffuse_albedo: Fraction
    specular_albedo: Fraction
    exponent: NonNegative

    @model_validator(mode="after")
    def _returns_no_more_than_it_gets(self) -> Phong:
        if self.diffuse_albedo + self.specular_albedo > 1.0 + 1e-12:
            raise ValueError("diffuse_albedo + specular_albedo must be at most 1")
        return self


class CookTorrance(Spec):
    """Cook-Torrance microfacets over a Lambert base: f = kd/π + F D G/(4 cosθi cosθo), F by Schlick from `f0`."""

    kind: Literal["cook-torrance"] = "cook-torrance"
    diffuse_albedo: Fraction
    f0: Fraction
    roughness: Annotated[float, Field(gt=0.005, le=1)]
    distribution: Literal["beckmann", "ggx"]


class Chua(Spec):
    """Seed 000, Eq. 4: K_S/cos⁶θ · exp(−tan²θ/s²) + K_D cosᵐθ, in a named convention.

    `convention`: "as-printed-radiance" takes the value as radiance per irradiance at normal incidence (no further cosθ,
    as Eq. 6 does); "brdf" multiplies by cosθi; "reciprocal" is the reciprocal extension (θ → θ_h) times cosθi.
    """

    kind: Literal["chua"] = "chua"
    k_s: NonNegative
    k_d: NonNegative
    slope: Positive
    diffusivity: NonNegative
    convention: Literal["as-printed-radiance", "brdf", "reciprocal"]


Material = Annotated[Lambert | Phong | CookTorrance | Chua, Field(discriminator="kind")]
