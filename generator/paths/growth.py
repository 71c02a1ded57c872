"""The derivative of a traced path by a share ε by which all targets grow about the camera, x → (1 + ε) x, by drjit.

No edge moves in the image then. The path's vertices grow along, and with them

    w(ε) = w (1 + ε)ⁿ e^{−cεL}/(1 + ε)² · I f/r² of the lamp at ℓ/(1 + ε),     L(ε) = (1 + ε) L:

n events of scattering on a way L, which is drawn as it is, so that no path ends or begins (score function). In water that scatters,
the lamp's place grows along; that errs by half of (ℓ/r)² of the derivative where it is not at the camera.
"""

from __future__ import annotations

from typing import Any

from ..rays.backend import mitsuba

__all__ = ["as_grown", "growth", "lamp_as_grown"]


def growth() -> Any:
    """ε = 0, by which drjit differentiates what follows."""
    import drjit as dr

    share = mitsuba().Float(0.0)
    dr.enable_grad(share)
    return share


def lamp_as_grown(position: Any, share: Any, scatters: bool) -> Any:
    """Where the lamp is, seen from grown targets; `share` None: not grown. `scatters`: whether the water does."""
    return position if share is None or scatters else position * (1.0 - share)


def as_grown(share: Any, by: Any, light: Any, length: Any, scatters: Any, attenuation: Any) -> tuple[Any, Any]:
    """(light, length) of a path of so many scattering events to first order in `by`, by which targets are larger. `light` and
    `length`: as drawn, with what depends on `share`; None: not grown."""
    import drjit as dr

    if share is None:
        return light, length
    depth = attenuation * dr.detach(length)
    light = light * dr.exp(share * (mitsuba().Float(scatters) - 2.0 - depth))
    length = length * (1.0 + share)
    dr.forward(share)
    return dr.detach(light) + by * dr.grad(light), dr.detach(length) + by * dr.grad(length)
