"""The delays of the slices of a gated camera: even steps, or a list of values."""

from __future__ import annotations

from typing import Annotated, Any, Literal

import numpy as np
import numpy.typing as npt
from pydantic import Discriminator, Field, Tag, model_validator

from ..base import Spec
from ..quantities import MomentTime, StepTime

__all__ = ["Delays", "ListedDelays", "SliceDelays"]

Float = npt.NDArray[np.float64]


class Delays(Spec):
    """Delays of the slices as set on the delay generator: start + step·k, each `repeats` times, then laser-off slices."""

    start_s: MomentTime
    step_s: StepTime
    count: Annotated[int, Field(ge=1, le=65536)]
    repeats: Annotated[int, Field(ge=1, le=65536)] = 1
    laser_off: Annotated[int, Field(ge=0, le=65536)] = 0

    @property
    def settings_s(self) -> Float:
        """The delays, without repeats and laser-off slices, s."""
        return np.asarray(self.start_s + self.step_s * np.arange(self.count), np.float64)

    @property
    def latest_s(self) -> float:
        """The latest delay, s."""
        return self.start_s + self.step_s * (self.count - 1)

    def after(self, zero_s: float) -> Float:
        """`settings_s` from the instant zero_s on, summed from left to right: start + zero rounds once."""
        return np.asarray(zero_s + self.start_s + self.step_s * np.arange(self.count), np.float64)


class ListedDelays(Spec):
    """Delays of the slices one by one, at any distance from each other: each of `values_s`, in this order, `repeats` times,
    then laser-off slices at the first of them."""

    kind: Literal["listed"]
    values_s: Annotated[tuple[MomentTime, ...], Field(min_length=2, max_length=65536)]
    repeats: Annotated[int, Field(ge=1, le=65536)] = 1
    laser_off: Annotated[int, Field(ge=0, le=65536)] = 0

    @model_validator(mode="after")
    def _values_differ(self) -> ListedDelays:
        if max(self.values_s) - min(self.values_s) < 1e-15:
            raise ValueError("values_s should hold two different delays or more")
        return self

    @property
    def settings_s(self) -> Float:
        """The delays, without repeats and laser-off slices, s."""
        return np.array(self.values_s, np.float64)

    @property
    def start_s(self) -> float:
        """The first delay, s."""
        return self.values_s[0]

    @property
    def latest_s(self) -> float:
        """The latest delay, s."""
        return max(self.values_s)

    @property
    def step_s(self) -> float:
        """The median distance of neighbouring delays, s."""
        return float(np.median(np.diff(np.unique(self.settings_s))))

    @property
    def count(self) -> int:
        """Number of delays."""
        return len(self.values_s)

    def after(self, zero_s: float) -> Float:
        """`settings_s` from the instant zero_s on."""
        return zero_s + self.settings_s


def _which(data: Any) -> str:
    return "listed" if isinstance(data, ListedDelays) or (isinstance(data, dict) and "kind" in data) else "even"


#: The stepped spec has no key `kind`, as before there was a list.
SliceDelays = Annotated[Annotated[Delays, Tag("even")] | Annotated[ListedDelays, Tag("listed")], Discriminator(_which)]
