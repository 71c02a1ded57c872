"""Reflection laws as Mitsuba BSDFs: one plugin around any law.

Mitsuba's `wi` points along the traced path (to the camera) and `wo` is what it samples (to the light): the reverse of
`optics`. So a plugin's eval(wi, wo) = f·cosθo is the response of `optics` with light from wo seen from wi.
"""

from __future__ import annotations

from functools import lru_cache
from typing import Any

from ...scenes.materials import Material
from ..rays.backend import mitsuba
from .law import Law
from .laws import law_of
from .texture import Shade

__all__ = ["mitsuba_bsdf"]


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
