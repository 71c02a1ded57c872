"""What a reflection law is to Mitsuba."""

from __future__ import annotations

from typing import Any, Protocol

__all__ = ["Law"]


class Law(Protocol):
    """An isotropic reflection law in the local frame (normal along z), for wi.z > 0 and wo.z > 0.

    `wi` points along the traced path, to the camera; `wo` is the direction that Mitsuba samples, to the light: the reverse
    of `optics`. All values are drjit arrays; constants come from `opaque`, so that other values do not recompile.
    """

    def response(self, wi: Any, wo: Any, shade: Any = 1.0) -> Any:
        """f(wi, wo)·cosθo [1/sr], its diffuse part times `shade`."""

    def sample(self, wi: Any, choice: Any, point: Any) -> Any:
        """A direction wo from one and two uniform numbers; it may lie below the surface, and then carries nothing."""

    def density(self, wi: Any, wo: Any) -> Any:
        """Probability density of `sample` [1/sr]."""
