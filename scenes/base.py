"""Base of all specs: frozen, no unknown keys, no NaN or infinity, no physical default."""

from __future__ import annotations

from typing import Annotated, ClassVar

from pydantic import BaseModel, ConfigDict, Field

__all__ = ["Fraction", "Index", "NonNegative", "Positive", "Spec", "Vec3"]


class Spec(BaseModel):
    """Base of every spec. Unknown keys are errors; values are immutable; numbers are finite."""

    #: Next step in an error message: where to see a complete spec.
    example: ClassVar[str] = "beambench scenes show flat-wall   (a complete example)"

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False, protected_namespaces=())


Positive = Annotated[float, Field(gt=0)]
NonNegative = Annotated[float, Field(ge=0)]
Fraction = Annotated[float, Field(ge=0, le=1)]
Index = Annotated[float, Field(ge=1, le=4)]
#: x, y, z in metres, camera frame: x right, y down, z forward.
Vec3 = tuple[float, float, float]
