"""The turbulence that a wavefront rig looks through: layers, given one by one or by the flow of water."""

from __future__ import annotations

from typing import Annotated, Literal

import numpy as np
from pydantic import Field, model_validator

from ...optics.turbulence.flow import TABLE_RANGE_M, table_r0_m
from ..base import Spec
from ..quantities import Distance

__all__ = ["Aberration", "Flow", "Layer", "Layers", "Still", "Turbulence", "layers_of"]

_R0 = Annotated[float, Field(ge=1e-6, le=1e6)]
_Speed = Annotated[float, Field(ge=-1e3, le=1e3)]


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
    """The tank of Guo et al. 2017: water that flows in at 4 m, `flow_l_per_min` of 0 to 40.

    Layers at 1, 2, 3 and 4 m, so that r0 of one pass of all layers up to a range is that of `optics.turbulence.flow.table_r0_m`.
    The table is ours: the document gives none, and trends of a wavefront with the flow follow from it by construction.
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
    strength = table_r0_m(turbulence.flow_l_per_min, TABLE_RANGE_M) ** (-5.0 / 3.0)
    own = np.diff(strength, prepend=0.0)
    return tuple(
        Layer(range_m=float(at), r0_m=float(one ** (-3.0 / 5.0)))
        for at, one in zip(TABLE_RANGE_M, own, strict=True)
        if one > 0.0
    )
