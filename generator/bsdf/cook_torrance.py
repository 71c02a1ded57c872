"""Cook-Torrance for Mitsuba: the law of `optics.reflection.cook_torrance`.

Not Mitsuba's `roughconductor`: that takes Fresnel from a complex index and masking from a fitted polynomial, so the
rungs of the ladder would differ by their models and not by what they neglect.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from ...scenes.materials import CookTorrance
from ..rays.backend import opaque
from .lobes import cosine_direction, facet_density, facet_direction, reflect

__all__ = ["CookTorranceLaw", "cook_torrance_law"]


def cook_torrance_law(material: CookTorrance) -> CookTorranceLaw:
    """The law of a material."""
    return CookTorranceLaw.of(
        material.diffuse_albedo, material.f0, material.roughness, material.distribution, material.masking
    )


@dataclass(frozen=True)
class CookTorranceLaw:
    """f = kd/π + F D G/(4 cosθi cosθo): Schlick's F, Smith's G in a named form, Beckmann's or GGX's D."""

    diffuse: Any
    f0: Any
    alpha: Any
    base_share: Any
    ggx: bool
    by_direction: bool

    @staticmethod
    def of(diffuse_albedo: float, f0: float, roughness: float, distribution: str, masking: str) -> CookTorranceLaw:
        """The law from plain numbers."""
        facets = max(f0, 0.05)
        share = diffuse_albedo / (diffuse_albedo + facets)
        return CookTorranceLaw(
            opaque(diffuse_albedo), opaque(f0), opaque(roughness), opaque(share), distribution == "ggx",
            masking == "height-direction-correlated",
        )  # fmt: skip

    def _masking(self, c: Any) -> Any:
        """cosθ·Λ(θ), finite up to grazing."""
        import drjit as dr

        width = self.alpha * dr.safe_sqrt(1.0 - dr.square(c))
        if self.ggx:
            return 0.5 * dr.square(width) / (dr.sqrt(dr.square(c) + dr.square(width)) + c)
        a = c / dr.maximum(width, 1e-20)
        bell = dr.exp(-dr.square(dr.minimum(a, 9.0)))
        return dr.maximum(0.5 * (width * bell / dr.sqrt(dr.pi) - c * (1.0 - dr.erf(a))), 0.0)

    def _hidden(self, wi: Any, wo: Any) -> Any:
        """cosθi cosθo (1/G − 1), finite up to grazing."""
        import drjit as dr

        first, second = wo.z * self._masking(wi.z), wi.z * self._masking(wo.z)
        if not self.by_direction:
            return first + second
        # The azimuth between the two from their own x and y: accurate where they are equal.
        azimuth = dr.atan2(dr.abs(wi.x * wo.y - wi.y * wo.x), wi.x * wo.x + wi.y * wo.y)
        apart = 4.41 * azimuth
        return dr.maximum(first, second) + apart / (apart + 1.0) * dr.minimum(first, second)

    def _half(self, wi: Any, wo: Any) -> tuple[Any, Any, Any]:
        """cosθh, tan²θh (from the half vector's own x and y: accurate near the mirror direction) and wi·h."""
        import drjit as dr

        half = wi + wo
        flat = dr.square(half.x) + dr.square(half.y)
        length = dr.norm(half)
        return half.z / length, flat / dr.square(half.z), 0.5 * length

    def response(self, wi: Any, wo: Any, shade: Any = 1.0) -> Any:
        """f·cosθo [1/sr], the diffuse part times `shade`."""
        import drjit as dr

        cos_h, tan2, cos_d = self._half(wi, wo)
        ci, co = wi.z, wo.z
        fresnel = self.f0 + (1.0 - self.f0) * (1.0 - dr.minimum(cos_d, 1.0)) ** 5
        masked = ci * co + self._hidden(wi, wo)
        facets = 0.25 * fresnel * facet_density(cos_h, tan2, self.alpha, self.ggx) / dr.maximum(masked, 1e-20)
        return (self.diffuse * shade / dr.pi + facets) * co

    def sample(self, wi: Any, choice: Any, point: Any) -> Any:
        """Cosine hemisphere, or a facet with density D cosθh that mirrors wi."""
        import drjit as dr

        mirrored = reflect(wi, facet_direction(point, self.alpha, self.ggx))
        return dr.select(choice < self.base_share, cosine_direction(point), mirrored)

    def density(self, wi: Any, wo: Any) -> Any:
        """Mixture of both densities [1/sr]; a facet's turns into directions with 1/(4 wi·h)."""
        import drjit as dr

        cos_h, tan2, cos_d = self._half(wi, wo)
        facets = facet_density(cos_h, tan2, self.alpha, self.ggx) * cos_h / (4.0 * dr.maximum(cos_d, 1e-20))
        return self.base_share * wo.z / dr.pi + (1.0 - self.base_share) * facets
