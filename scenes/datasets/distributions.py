"""Distributions of one parameter: each turns a uniform number u of (0, 1) into a value (inverse transform sampling).

Source: L. Devroye, Non-Uniform Random Variate Generation, Springer 1986, chapter II.2.
"""

from __future__ import annotations

import math
from typing import Annotated, Any, ClassVar, Literal

from pydantic import Discriminator, Field, Tag, model_validator

from ..base import Positive, Spec

__all__ = ["Choice", "Distribution", "Expressed", "Grid", "Parameter"]

_KINDS = ("uniform", "log_uniform", "normal", "integers", "choice", "grid", "expression")


class Parameter(Spec):
    """Base of all kinds of parameters.

    Other arguments:
        paths: the values of a scene that get it; none: it serves expressions only.
        scenes: names of the entries of `scenes` that it holds for; none: all of them.
    """

    example: ClassVar[str] = "docs/data-sets.md   (a complete example)"
    continuous: ClassVar[bool] = False

    paths: tuple[Annotated[str, Field(min_length=1, max_length=200)], ...] = ()
    scenes: tuple[str, ...] = ()

    def value(self, u: float) -> Any:
        """The value at the quantile u of (0, 1)."""
        raise TypeError(f"a {type(self).__name__} is not drawn by a quantile")


class _Between(Parameter):
    low: float
    high: float

    @model_validator(mode="after")
    def _ordered(self) -> _Between:
        if not self.low < self.high:
            raise ValueError(f"low {self.low:g} should be below high {self.high:g}")
        return self


class Uniform(_Between):
    """x = low + u (high − low)."""

    continuous: ClassVar[bool] = True
    kind: Literal["uniform"]

    def value(self, u: float) -> float:
        """Within low … high."""
        return min(max(self.low + u * (self.high - self.low), self.low), self.high)


class LogUniform(_Between):
    """x = low (high/low)^u: each decade is as likely as any other."""

    continuous: ClassVar[bool] = True
    kind: Literal["log_uniform"]
    low: Positive

    def value(self, u: float) -> float:
        """Within low … high."""
        found = math.exp(math.log(self.low) + u * (math.log(self.high) - math.log(self.low)))
        return min(max(found, self.low), self.high)


class Normal(Parameter):
    """x = mean + sigma Φ⁻¹(v), v = Φ(a) + u (Φ(b) − Φ(a)): normal, cut off at low and high (a, b in units of sigma)."""

    continuous: ClassVar[bool] = True
    kind: Literal["normal"]
    mean: float
    sigma: Positive
    low: float | None = None
    high: float | None = None

    @model_validator(mode="after")
    def _likely(self) -> Normal:
        low, high = self._limits()
        if not high - low > 1e-6:
            raise ValueError("low … high should hold at least 1e-6 of the distribution")
        return self

    def _limits(self) -> tuple[float, float]:
        from scipy.special import ndtr

        low = 0.0 if self.low is None else float(ndtr((self.low - self.mean) / self.sigma))
        high = 1.0 if self.high is None else float(ndtr((self.high - self.mean) / self.sigma))
        return low, high

    def value(self, u: float) -> float:
        """Within low … high, where they are given."""
        from scipy.special import ndtri

        low, high = self._limits()
        found = self.mean + self.sigma * float(ndtri(low + u * (high - low)))
        found = found if self.low is None else max(found, self.low)
        return found if self.high is None else min(found, self.high)


class Integers(Parameter):
    """A whole number of low … high, each equally likely."""

    kind: Literal["integers"]
    low: int
    high: int

    @model_validator(mode="after")
    def _ordered(self) -> Integers:
        if not self.low <= self.high:
            raise ValueError(f"low {self.low} should not be above high {self.high}")
        return self

    def value(self, u: float) -> int:
        """Low … high, both included."""
        return min(self.low + int(u * (self.high - self.low + 1)), self.high)


class Choice(Parameter):
    """One of `values` (numbers, text, lists, tables), by `weights`, or each equally likely."""

    kind: Literal["choice"]
    values: Annotated[tuple[Any, ...], Field(min_length=1)]
    weights: tuple[Positive, ...] = ()

    @model_validator(mode="after")
    def _weighed(self) -> Choice:
        if self.weights and len(self.weights) != len(self.values):
            raise ValueError(f"{len(self.values)} values need as many weights, not {len(self.weights)}")
        return self

    def value(self, u: float) -> Any:
        """One of the values."""
        weights = self.weights or (1.0,) * len(self.values)
        left = u * math.fsum(weights)
        for value, weight in zip(self.values, weights, strict=True):
            left -= weight
            if left < 0.0:
                return value
        return self.values[-1]


class Grid(Parameter):
    """All `values` in turn; several grids give all their combinations in turn, the first grid of the file the slowest."""

    kind: Literal["grid"]
    values: Annotated[tuple[Any, ...], Field(min_length=1)]


class Expressed(Parameter):
    """A number as an expression of other parameters, rounded to a whole one if `whole`."""

    kind: Literal["expression"]
    text: str
    whole: bool = False


def _kind(value: Any) -> str:
    return str(value.get("kind") if isinstance(value, dict) else getattr(value, "kind", None))


Distribution = Annotated[
    Annotated[Uniform, Tag("uniform")]
    | Annotated[LogUniform, Tag("log_uniform")]
    | Annotated[Normal, Tag("normal")]
    | Annotated[Integers, Tag("integers")]
    | Annotated[Choice, Tag("choice")]
    | Annotated[Grid, Tag("grid")]
    | Annotated[Expressed, Tag("expression")],
    Discriminator(
        _kind,
        custom_error_type="parameter_kind",
        custom_error_message=f"kind should be one of {', '.join(_KINDS)}",
    ),
]
