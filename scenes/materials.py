"""Materials: one record per reflection law. A record holds the law's parameters and all that NumPy code needs of the law.

A law is a class below, listed in `Material`. Its response to light is a function of `optics.reflection`; Mitsuba's form of the
law is the entry of the same `kind` in `generator.bsdf.laws`. θ is the angle from the surface's normal.
"""

from __future__ import annotations

import math
from abc import abstractmethod
from typing import Annotated, ClassVar, Literal, Self

from pydantic import Field, model_validator

from ..optics.reflection.albedo import albedo_limit, hemispherical_albedo
from ..optics.reflection.angles import Angles, Array
from ..optics.reflection.chua import chua
from ..optics.reflection.cook_torrance import Masking, cook_torrance
from ..optics.reflection.lambert import lambert
from ..optics.reflection.phong import phong
from .base import Fraction, NonNegative, Positive, Spec

__all__ = ["Chua", "CookTorrance", "Lambert", "Material", "Phong", "Reflection"]

#: Largest incidence at which energy is checked, 80°: nearer to grazing some laws return more than they get by
#: construction, and hardly any light goes there.
_STEEPEST_RAD = 1.396
#: Exponent of the lobe that a matt surface is given: half its light lies within 12 degrees of the mirror direction.
_LOBE = 30.0


class Reflection(Spec):
    """A reflection law with its parameters. A law of its own gives `response` and `look`; the rest has a default."""

    #: The parameter that scales the diffuse part, which a texture multiplies.
    diffuse: ClassVar[str] = "diffuse_albedo"

    @abstractmethod
    def response(self, angles: Angles) -> Array:
        """f·cosθi [1/sr] at the angles, of their shape; zero where light or eye is below the surface."""

    @abstractmethod
    def look(self) -> tuple[float, float]:
        """(diffuse grey, roughness), each 0 … 1, by which a rasterised preview stands for the law."""

    def without_diffuse(self) -> Self:
        """The same material without its diffuse part."""
        return self.model_copy(update={self.diffuse: 0.0})

    def albedo_at_normal(self) -> float:
        """Hemispherical albedo at normal incidence; by quadrature unless the law has a closed form."""
        return float(hemispherical_albedo(self.response, 0.0))

    def largest_albedo(self) -> tuple[float, float]:
        """(largest hemispherical albedo at incidences up to 80°, that incidence [rad]); by quadrature unless the law has a
        closed form. Paths of light are refused on a material that returns more than it gets."""
        return albedo_limit(self.response, largest_theta_rad=_STEEPEST_RAD, samples=9)

    def with_lobe(self, share: float) -> Material | None:
        """The material with the `share` of its albedo (0 … 1) in a mirror-like lobe and the albedo unchanged; None where the
        law has no such form."""
        return None


class Lambert(Reflection):
    """Ideal diffuse surface: f = albedo/π."""

    diffuse: ClassVar[str] = "albedo"

    kind: Literal["lambert"] = "lambert"
    albedo: Fraction

    def response(self, angles: Angles) -> Array:
        """As `lambert`."""
        return lambert(angles, albedo=self.albedo)

    def look(self) -> tuple[float, float]:
        """Its albedo, fully rough."""
        return self.albedo, 1.0

    def albedo_at_normal(self) -> float:
        """`albedo`."""
        return self.albedo

    def largest_albedo(self) -> tuple[float, float]:
        """`albedo`, at every incidence."""
        return self.albedo, 0.0

    def with_lobe(self, share: float) -> Material:
        """A Phong surface of the same albedo."""
        return Phong(diffuse_albedo=self.albedo * (1.0 - share), specular_albedo=self.albedo * share, exponent=_LOBE)


class Phong(Reflection):
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

    def response(self, angles: Angles) -> Array:
        """As `phong`."""
        return phong(
            angles, diffuse_albedo=self.diffuse_albedo, specular_albedo=self.specular_albedo, exponent=self.exponent
        )

    def look(self) -> tuple[float, float]:
        """The sum of both albedos; the roughness of a facet lobe as wide as cosⁿα."""
        return min(self.diffuse_albedo + self.specular_albedo, 1.0), (2.0 / (self.exponent + 2.0)) ** 0.25

    def largest_albedo(self) -> tuple[float, float]:
        """kd + ks, at normal incidence: elsewhere a part of the lobe is below the surface."""
        return self.diffuse_albedo + self.specular_albedo, 0.0

    def with_lobe(self, share: float) -> Material:
        """The albedo shared anew between base and lobe; the exponent stays."""
        albedo = self.diffuse_albedo + self.specular_albedo
        return Phong(
            diffuse_albedo=albedo * (1.0 - share), specular_albedo=albedo * share, exponent=self.exponent
        )  # fmt: skip


class CookTorrance(Reflection):
    """Cook-Torrance microfacets over a Lambert base: f = kd/π + F D G/(4 cosθi cosθo), F by Schlick from `f0`.

    `masking` names Smith's G: "height-correlated" (1/(1 + Λi + Λo), that of files which do not name it), or
    "height-direction-correlated", which is exact for a coaxial rig.
    """

    kind: Literal["cook-torrance"] = "cook-torrance"
    diffuse_albedo: Fraction
    f0: Fraction
    roughness: Annotated[float, Field(gt=0.005, le=1)]
    distribution: Literal["beckmann", "ggx"]
    masking: Masking = "height-correlated"

    def response(self, angles: Angles) -> Array:
        """As `cook_torrance`."""
        return cook_torrance(
            angles,
            diffuse_albedo=self.diffuse_albedo,
            f0=self.f0,
            roughness=self.roughness,
            distribution=self.distribution,
            masking=self.masking,
        )

    def look(self) -> tuple[float, float]:
        """kd + f0; the rasteriser's roughness is the square root of α."""
        return min(self.diffuse_albedo + self.f0, 1.0), self.roughness**0.5


class Chua(Reflection):
    """Guo et al. 2017, Eq. 4: K_S/cos⁶θ · exp(−tan²θ/s²) + K_D cosᵐθ, in a named convention.

    `convention`: "as-printed-radiance" takes the value as radiance per irradiance at normal incidence (no further cosθ,
    as Eq. 6 does); "brdf" multiplies by cosθi; "reciprocal" is the reciprocal extension (θ → θ_h) times cosθi.
    """

    diffuse: ClassVar[str] = "k_d"

    kind: Literal["chua"] = "chua"
    k_s: NonNegative
    k_d: NonNegative
    slope: Positive
    diffusivity: NonNegative
    convention: Literal["as-printed-radiance", "brdf", "reciprocal"]

    def response(self, angles: Angles) -> Array:
        """As `chua`."""
        return chua(
            angles,
            k_s=self.k_s,
            k_d=self.k_d,
            slope=self.slope,
            diffusivity=self.diffusivity,
            convention=self.convention,
        )

    def look(self) -> tuple[float, float]:
        """K_D as an albedo plus K_S; a lobe of slope s has facets of that roughness."""
        return min(math.pi * self.k_d + self.k_s, 1.0), min(self.slope, 1.0) ** 0.5


#: The table of reflection laws.
Material = Annotated[Lambert | Phong | CookTorrance | Chua, Field(discriminator="kind")]
