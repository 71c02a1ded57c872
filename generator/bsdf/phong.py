"""Normalised Phong for Mitsuba: the law of `optics.reflection.phong`."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from ...scenes.materials import Phong
from ..rays.backend import mitsuba, opaque
from .lobes import cosine_direction

__all__ = ["PhongLaw", "phong_law"]


def phong_law(material: Phong) -> PhongLaw:
    """The law of a material."""
    return PhongLaw.of(material.diffuse_albedo, material.specular_albedo, material.exponent)


@dataclass(frozen=True)
class PhongLaw:
    """f = kd/π + ks (n+2)/(2π) cosⁿα (Lafortune and Willems 1994); samples base and lobe by their albedos."""

    diffuse: Any
    specular: Any
    exponent: Any
    base_share: Any

    @staticmethod
    def of(diffuse_albedo: float, specular_albedo: float, exponent: float) -> PhongLaw:
        """The law from plain numbers."""
        total = diffuse_albedo + specular_albedo
        share = diffuse_albedo / total if total > 0 else 1.0
        return PhongLaw(opaque(diffuse_albedo), opaque(specular_albedo), opaque(exponent), opaque(share))

    def _lobe(self, wi: Any, wo: Any) -> Any:
        """cosⁿα."""
        import drjit as dr

        cosine = wi.z * wo.z - wi.x * wo.x - wi.y * wo.y
        # 1e-30 and not 0: 0⁰ must be 1 for the flat lobe of exponent 0, and log(0) must not meet 0.
        lobe = dr.exp(self.exponent * dr.log(dr.clip(cosine, 1e-30, 1.0)))
        return dr.select(cosine > 0.0, lobe, 0.0)

    def response(self, wi: Any, wo: Any, shade: Any = 1.0) -> Any:
        """f·cosθo [1/sr], the diffuse part times `shade`."""
        import drjit as dr

        lobe = self.specular * (self.exponent + 2.0) * (0.5 / dr.pi) * self._lobe(wi, wo)
        return (self.diffuse * shade / dr.pi + lobe) * wo.z

    def sample(self, wi: Any, choice: Any, point: Any) -> Any:
        """Cosine hemisphere, or density (n+1)/(2π) cosⁿα about the mirror direction."""
        import drjit as dr

        mi = mitsuba()
        cosine = dr.exp(dr.log(dr.maximum(point.x, 1e-12)) / (self.exponent + 1.0))
        sine = dr.safe_sqrt(1.0 - dr.square(cosine))
        sin_phi, cos_phi = dr.sincos(2.0 * dr.pi * point.y)
        frame = mi.Frame3f(mi.Vector3f(-wi.x, -wi.y, wi.z))
        lobe = frame.to_world(mi.Vector3f(sine * cos_phi, sine * sin_phi, cosine))
        return dr.select(choice < self.base_share, cosine_direction(point), lobe)

    def density(self, wi: Any, wo: Any) -> Any:
        """Mixture of both densities [1/sr]."""
        import drjit as dr

        lobe = (self.exponent + 1.0) * (0.5 / dr.pi) * self._lobe(wi, wo)
        return self.base_share * wo.z / dr.pi + (1.0 - self.base_share) * lobe
