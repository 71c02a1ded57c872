"""The layout of a modality: the variables of its captures, and the quantities that are estimated from them."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from functools import cached_property
from typing import TYPE_CHECKING, Any

from ..quantities import Quantity, Stage
from .schema import Variable

if TYPE_CHECKING:
    import xarray as xr

__all__ = ["Layout"]


def _nothing(capture: xr.Dataset, rig: dict[str, Any], where: str) -> None:
    """Check nothing beyond the rules for every modality."""


@dataclass(frozen=True)
class Layout:
    """The record of a modality in `captures`.

    Main arguments:
        name: the modality. variables: the variables of a capture.
        data: name of the measured variable.
        element: dimensions of the elements that tables count. noun: the word for one element, e.g. "pixel".
        stages: stages of its estimators; the first one reads captures.
    Other arguments:
        finite: coordinates that must be finite.
        padded: {dimension: size} of those whose size follows from what a capture shows: captures of a data set get this one.
        check: function of (capture, declared rig, place for messages); raises InputError for values that contradict each
            other.
    """

    name: str
    variables: tuple[Variable, ...]
    data: str
    element: tuple[str, ...]
    noun: str
    stages: tuple[Stage, ...]
    finite: tuple[str, ...] = ()
    padded: Mapping[str, int] = field(default_factory=dict)
    check: Callable[[xr.Dataset, dict[str, Any], str], None] = _nothing

    @cached_property
    def by_name(self) -> dict[str, Variable]:
        """The variables by their names."""
        return {variable.name: variable for variable in self.variables}

    @property
    def quantities(self) -> tuple[Quantity, ...]:
        """All estimated quantities, stage by stage."""
        return tuple(quantity for stage in self.stages for quantity in stage.gives)
