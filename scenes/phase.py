"""Specs of phase functions: the same names and fields as the shapes in `optics.phase_forms`."""

from __future__ import annotations

from itertools import pairwise
from math import pi
from typing import Annotated, Any, Literal

from pydantic import BeforeValidator, Field, model_validator

from .base import Positive, Spec

__all__ = ["FournierForand", "HenyeyGreenstein", "MolecularPhase", "PhaseFunction", "TabulatedPhase"]


class HenyeyGreenstein(Spec):
    """Henyey-Greenstein of mean cosine `g`: for natural water several times too dark backward."""

    kind: Literal["henyey-greenstein"] = "henyey-greenstein"
    g: Annotated[float, Field(gt=-1, lt=1)]


class FournierForand(Spec):
    """Fournier-Forand of particles with relative refractive `index` and Junge `slope`."""

    kind: Literal["fournier-forand"] = "fournier-forand"
    index: Annotated[float, Field(gt=1, lt=1.5)]
    slope: Annotated[float, Field(gt=3, lt=5)]


class MolecularPhase(Spec):
    """Scattering by a pure liquid or gas; `depolarisation` is .09 in water."""

    kind: Literal["molecular"] = "molecular"
    depolarisation: Annotated[float, Field(ge=0, lt=1)]


def _tuple(value: Any) -> Any:
    return tuple(value) if isinstance(value, list) else value


#: A list in the file: the medium's own validation has turned JSON into Python before this field sees it.
_Values = Annotated[tuple[Positive, ...], BeforeValidator(_tuple)]


class TabulatedPhase(Spec):
    """Values (any common unit: they are normalised) at ascending angles up to π, a power law between neighbours and,
    with the exponent `forward_slope` (> −2), below the first angle."""

    kind: Literal["tabulated"] = "tabulated"
    angle_rad: _Values
    value: _Values
    forward_slope: Annotated[float, Field(gt=-2, le=0)]

    @model_validator(mode="after")
    def _angles_ascend_to_pi(self) -> TabulatedPhase:
        angle = self.angle_rad
        if len(angle) != len(self.value) or len(angle) < 2:
            raise ValueError("angle_rad and value need the same length, at least 2")
        if any(b <= a for a, b in pairwise(angle)) or abs(angle[-1] - pi) > 1e-6:
            raise ValueError("angle_rad must ascend, and end at π")
        return self


PhaseFunction = Annotated[
    HenyeyGreenstein | FournierForand | MolecularPhase | TabulatedPhase, Field(discriminator="kind")
]
