"""Guo et al. 2017, Eq. 4, for Mitsuba: the law of `optics.reflection.chua` in its three conventions.

"reciprocal" is the physical one. The other two are laws of the angle of incidence alone, whatever the eye's direction,
as in `optics`: they nest with the direct rung, and are not reciprocal.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from ...scenes.materials import Chua
from ..rays.backend import opaque
from .lobes import cosine_direction, facet_density, facet_direction, reflect

__all__ = ["ChuaLaw", "chua_law"]


def chua_law(material: Chua) -> ChuaLaw:
    """The law of a material."""
    return ChuaLaw.of(material.k_s, material.k_d, material.slope, material.diffusivity, material.convention)


@dataclass(frozen=True)
class ChuaLaw:
    """K_S/cos⁶θ · exp(−tan²θ/s²) + K_D cosᵐθ; its lobe is sampled as Beckmann facets of roughness s."""

    k_s: Any
    k_d: Any
    slope: Any
    diffusivity: Any
    base_share: Any
    convention: str

    @staticmethod
    def of(k_s: float, k_d: float, slope: float, diffusivity: float, convention: str) -> ChuaLaw:
        """The law from plain numbers."""
        # Light returned by lobe and base near normal incidence: both integrals over the hemisphere.
        lobe, base = k_s * slope**2 * (4.0 if convention == "reciprocal" else 1.0), k_d * 2.0 / (diffusivity / 2 + 2.0)
        share = base / (lobe + base) if lobe + base > 0 else 1.0
        return ChuaLaw(opaque(k_s), opaque(k_d), opaque(slope), opaque(diffusivity), opaque(share), convention)

    def response(self, wi: Any, wo: Any, shade: Any = 1.0) -> Any:
        """f·cosθo [1/sr], the diffuse part times `shade`; light comes from wo."""
        import drjit as dr

        if self.convention == "reciprocal":
            half = wi + wo
            tan2 = (dr.square(half.x) + dr.square(half.y)) / dr.square(half.z)
            # 1/cos²θh = 1 + tan²θh
            lobe = dr.exp(-tan2 / dr.square(self.slope) + 2.0 * dr.log(1.0 + tan2)) / wi.z
            base = dr.exp(0.5 * self.diffusivity * dr.log(wi.z * wo.z)) * wo.z
            return self.k_s * lobe + self.k_d * shade * base
        tan2 = (dr.square(wo.x) + dr.square(wo.y)) / dr.square(wo.z)
        lobe = dr.exp(-tan2 / dr.square(self.slope) + 3.0 * dr.log(1.0 + tan2))
        value = self.k_s * lobe + self.k_d * shade * dr.exp(self.diffusivity * dr.log(wo.z))
        return value * wo.z if self.convention == "brdf" else value

    def sample(self, wi: Any, choice: Any, point: Any) -> Any:
        """Cosine hemisphere, or the lobe: facets that mirror wi, or for the laws of one angle the angle itself."""
        import drjit as dr

        lobe = facet_direction(point, self.slope, False)
        if self.convention == "reciprocal":
            lobe = reflect(wi, lobe)
        return dr.select(choice < self.base_share, cosine_direction(point), lobe)

    def density(self, wi: Any, wo: Any) -> Any:
        """Mixture of both densities [1/sr]."""
        import drjit as dr

        if self.convention == "reciprocal":
            half = wi + wo
            tan2 = (dr.square(half.x) + dr.square(half.y)) / dr.square(half.z)
            cosine = dr.rsqrt(1.0 + tan2)
            jacobian = 0.5 / dr.maximum(dr.norm(half), 1e-20)  # 1/(4 wi·h), |wi + wo| = 2 wi·h
        else:
            tan2 = (dr.square(wo.x) + dr.square(wo.y)) / dr.square(wo.z)
            cosine = wo.z
            jacobian = 1.0
        lobe = facet_density(cosine, tan2, self.slope, False) * cosine * jacobian
        return self.base_share * wo.z / dr.pi + (1.0 - self.base_share) * lobe
