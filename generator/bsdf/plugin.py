"""Our reflection laws as Mitsuba BSDF plugins: one plugin around any law, and the law of each material.

Mitsuba's `wi` points along the traced path (to the camera) and `wo` is what it samples (to the light): the reverse of
`optics`. So a plugin's eval(wi, wo) = f·cosθo is the response of `optics` with light from wo seen from wi.
"""

from __future__ import annotations

from functools import lru_cache
from typing import Any, Protocol

from ...scenes.materials import Chua, CookTorrance, Lambert, Material, Phong
from ..rays.backend import mitsuba
from .chua import ChuaLaw
from .cook_torrance import CookTorranceLaw
from .phong import PhongLaw
from .texture import Shade

__all__ = ["Law", "law_of", "mitsuba_bsdf"]


class Law(Protocol):
    """An isotropic reflection law in the local frame (normal along z), for wi.z > 0 and wo.z > 0."""

    def response(self, wi: Any, wo: Any, shade: Any = 1.0) -> Any:
        """f(wi, wo)·cosθo [1/sr], its diffuse part times `shade`."""

    def sample(self, wi: Any, choice: Any, point: Any) -> Any:
        """A direction wo from one and two uniform numbers; it may lie below the surface, and then carries nothing."""

    def density(self, wi: Any, wo: Any) -> Any:
        """Probability density of `sample` [1/sr]."""


def law_of(material: Material) -> Law:
    """The law of a material. Lambert is Phong's law without a lobe."""
    if isinstance(material, Lambert):
        return PhongLaw.of(material.albedo, 0.0, 0.0)
    if isinstance(material, Phong):
        return PhongLaw.of(material.diffuse_albedo, material.specular_albedo, material.exponent)
    if isinstance(material, CookTorrance):
        return CookTorranceLaw.of(material.diffuse_albedo, material.f0, material.roughness, material.distribution)
    assert isinstance(material, Chua)
    return ChuaLaw.of(material.k_s, material.k_d, material.slope, material.diffusivity, material.convention)


def mitsuba_bsdf(material: Material, shade: Shade | None = None) -> Any:
    """A two-sided Mitsuba BSDF of the material, its diffuse part times the texture `shade`.

    Directions are sampled as without the texture, which is right for any of its values.
    """
    mi = mitsuba()
    one_sided = _plugin()(mi.Properties(), law_of(material), shade)
    return mi.load_dict({"type": "twosided", "inner": one_sided})


@lru_cache(maxsize=1)
def _plugin() -> Any:
    """The plugin's class; made late, because its base exists only once Mitsuba's variant is set."""
    mi = mitsuba()
    import drjit as dr

    class LawBSDF(mi.BSDF):  # type: ignore[name-defined,misc]
        """A Mitsuba BSDF around a law."""

        def __init__(self, props: Any, law: Law, shade: Shade | None) -> None:
            super().__init__(props)
            self._law, self._shade = law, shade
            flags = mi.BSDFFlags.GlossyReflection | mi.BSDFFlags.FrontSide
            self.m_components = [flags]
            self.m_flags = flags

        def _response(self, si: Any, wo: Any, active: Any) -> Any:
            if self._shade is None:
                return self._law.response(si.wi, wo)
            return self._law.response(si.wi, wo, self._shade.at(si.uv, active))

        def _above(self, si: Any, wo: Any, active: Any) -> Any:
            return active & (si.wi.z > 0.0) & (wo.z > 0.0)

        def sample(self, ctx: Any, si: Any, sample1: Any, sample2: Any, active: Any = True) -> Any:
            wo = self._law.sample(si.wi, sample1, sample2)
            active = self._above(si, wo, active)
            pdf = self._law.density(si.wi, wo)
            active &= pdf > 0.0
            result = mi.BSDFSample3f()
            result.wo = wo
            result.pdf = dr.select(active, pdf, 0.0)
            result.eta = 1.0
            result.sampled_type = mi.UInt32(int(self.m_flags))
            result.sampled_component = 0
            weight = dr.select(active, self._response(si, wo, active) / pdf, 0.0)
            return result, mi.Spectrum(weight)

        def eval(self, ctx: Any, si: Any, wo: Any, active: Any = True) -> Any:
            active = self._above(si, wo, active)
            return mi.Spectrum(dr.select(active, self._response(si, wo, active), 0.0))

        def pdf(self, ctx: Any, si: Any, wo: Any, active: Any = True) -> Any:
            return dr.select(self._above(si, wo, active), self._law.density(si.wi, wo), 0.0)

        def eval_pdf(self, ctx: Any, si: Any, wo: Any, active: Any = True) -> Any:
            return self.eval(ctx, si, wo, active), self.pdf(ctx, si, wo, active)

        def to_string(self) -> str:
            return f"LawBSDF[{type(self._law).__name__}]"

    return LawBSDF
