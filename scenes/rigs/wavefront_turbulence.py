"""The turbulence that a wavefront rig looks through: layers, given one by one or by the flow of water."""

from __future__ import annotations

from typing import Annotated, Any, Literal

import numpy as np
from pydantic import Field, model_validator

from ..base import Spec
from ..quantities import Distance

__all__ = ["FLOW_R0_M", "Aberration", "Flow", "Layer", "Layers", "Still", "Turbulence", "layers_of"]

_R0 = Annotated[float, Field(ge=1e-6, le=1e6)]
_Speed = Annotated[float, Field(ge=-1e3, le=1e3)]

#: Flow [L/min] -> Fried parameter [m] at 532 nm of one pass of the layer at the water inlet. A table and no law: at a fixed
#: dissipation of temperature, more flow makes *less* optical turbulence, and the document gives no value. Trends of a
#: wavefront with the flow follow from this table by construction.
FLOW_R0_M: dict[float, float] = {0.0: 1e3, 10.0: 8.0e-3, 20.0: 5.0e-3, 30.0: 3.5e-3, 40.0: 2.5e-3}
#: Range [m] -> share of the strength r0^(−5/3) at the inlet, which is at 4 m.
_SHARE: dict[float, float] = {1.0: 0.05, 2.0: 0.12, 3.0: 0.3, 4.0: 1.0}


class Layer(Spec):
    """A thin layer across the beam at `range_m`: Fried parameter of one pass at the rig's wavelength, and the outer scale
    (absent: Kolmogorov). `velocity_m_per_s`: of frozen flow along (x, y)."""

    range_m: Distance
    r0_m: _R0
    outer_scale_m: Annotated[float, Field(ge=1e-6, le=1e6)] | None = None
    velocity_m_per_s: tuple[_Speed, _Speed] | None = None


class Still(Spec):
    """No turbulence."""

    kind: Literal["none"] = "none"


class Layers(Spec):
    """Layers one by one. Frames are independent draws, or one flow where a layer has a velocity."""

    kind: Literal["layers"] = "layers"
    layers: Annotated[tuple[Layer, ...], Field(min_length=1, max_length=16)]


class Flow(Spec):
    """The tank of Guo et al. 2017: water that flows in at 4 m, `flow_l_per_min` of 0 to 40 (`FLOW_R0_M`).

    Layers at 1, 2, 3 and 4 m, weaker away from the inlet; r0^(−5/3) is interpolated linearly over the flow.
    """

    kind: Literal["flow"] = "flow"
    flow_l_per_min: Annotated[float, Field(ge=0, le=40)]


Turbulence = Annotated[Still | Layers | Flow, Field(discriminator="kind")]


class Aberration(Spec):
    """A wavefront that is the same in every frame and absent from the reference: Zernike coefficients `rad` (rms) of the Noll
    indices `noll`, over the pupil."""

    noll: tuple[Annotated[int, Field(ge=2, le=300)], ...]
    rad: tuple[Annotated[float, Field(ge=-1e4, le=1e4)], ...]

    @model_validator(mode="after")
    def _one_coefficient_each(self) -> Aberration:
        if len(self.noll) != len(self.rad) or len(set(self.noll)) != len(self.noll):
            raise ValueError("noll and rad should have equal lengths, and each index should be given once")
        return self


def layers_of(turbulence: Still | Layers | Flow) -> tuple[Layer, ...]:
    """The layers of any turbulence, nearest first."""
    if isinstance(turbulence, Still):
        return ()
    if isinstance(turbulence, Layers):
        return tuple(sorted(turbulence.layers, key=lambda layer: layer.range_m))
    flows = sorted(FLOW_R0_M)
    strength: Any = np.interp(turbulence.flow_l_per_min, flows, [FLOW_R0_M[flow] ** (-5.0 / 3.0) for flow in flows])
    return tuple(
        Layer(range_m=at, r0_m=float((strength * share) ** (-3.0 / 5.0))) for at, share in sorted(_SHARE.items())
    )
