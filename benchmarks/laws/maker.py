"""What the laws run on: the clean capture of a modality, what is made of it, and how answers are read."""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from functools import cached_property
from typing import TYPE_CHECKING, Any, Protocol

import numpy as np
import numpy.typing as npt

from ...captures.hide import hide_truth
from ...captures.layouts import layout_of
from ...captures.quantities import Stage
from ...scenes.errors import InputError

if TYPE_CHECKING:
    import xarray as xr

__all__ = ["Answer", "Change", "Laws", "Make", "Maker", "Run"]

Array = npt.NDArray[Any]

#: An estimator as a function of one capture.
Run = Callable[["xr.Dataset"], "xr.Dataset"]
#: Data (sample, element) -> data of the same shape; of another type where the layout allows it.
Change = Callable[[Array], Array]


class Make(Protocol):
    """Makes a clean capture."""

    def __call__(self, seed: int = 1, light: float = 1.0, background: float = 1.0) -> xr.Dataset:
        """That of this seed, with so many times the light and the background."""
        ...


#: Seed of the clean capture.
_SEED = 1


@dataclass(frozen=True)
class Laws:
    """What a modality contributes to the laws.

    Main arguments:
        captures: makers of a clean, bright capture of 40 elements or more, with its truth, and of the same with less light or
            more background; the first one that an estimator can read is used.
        shift: what is moved and what follows, e.g. "later delays, farther ranges".
        later: capture -> (the capture moved in time or place, by how much the answer must change [unit of the first
            quantity of the stage]).
        step: capture -> change of the answer that belongs to one sample of the data [same unit].
        steps: word of a stage whose answer is no place in the data (it reads the results of another, or says something of the
            instrument) -> capture -> change of its answer that belongs to one sample of the data. No law of shifts or of order is
            tried on such a stage.
        own: word of a stage -> makers of its clean captures, where those of `captures` do not hold what it reads.
        converter: declared rig -> the part of it, inside the same object, that holds `gain_dn_per_e`, `offset_dn` and
            `adc_bits`; None where the detector has no converter.
    """

    captures: tuple[Make, ...]
    shift: str
    later: Callable[[xr.Dataset], tuple[xr.Dataset, float]]
    step: Callable[[xr.Dataset], float]
    converter: Callable[[dict[str, Any]], dict[str, Any] | None]
    steps: Mapping[str, Callable[[xr.Dataset], float]] = field(default_factory=dict)
    own: Mapping[str, tuple[Make, ...]] = field(default_factory=dict)


@dataclass(frozen=True)
class Answer:
    """One quantity of an estimate: `value`, `sigma`, `valid`, each (element, value of the element)."""

    value: Array
    sigma: Array
    valid: Array


class Maker:
    """Captures for the laws of one stage, and its answers by element.

    Main arguments:
        laws: of the modality. stage: of the estimator, which reads captures or is the last of a chain that does.
    Other arguments:
        unfit: capture -> reason why the estimator cannot read it, "" if it can.
        joint: whether the estimator says that its answers depend on other elements than their own.

    Raises InputError where the estimator can read none of the captures.
    """

    def __init__(
        self, laws: Laws, stage: Stage, unfit: Callable[[xr.Dataset], str] = lambda capture: "", *, joint: bool = False
    ) -> None:
        self.laws, self.stage, self.layout, self.joint = laws, stage, layout_of(stage.modality), joint
        reasons = []
        for make in laws.own.get(stage.word, laws.captures):
            capture = make(_SEED)
            if not (reason := unfit(capture)):
                self._true, self._clean, self._make = capture, hide_truth(capture), make
                return
            reasons.append(reason)
        raise InputError(
            "The laws have no capture that this estimator can read.",
            where=f"stage {stage.word}",
            value="; ".join(reasons),
        )

    @cached_property
    def rig(self) -> dict[str, Any]:
        """The declared rig of the clean capture; never changed."""
        rig: dict[str, Any] = json.loads(self._clean.attrs["rig"])
        return rig

    @property
    def step(self) -> float:
        """Change of the answer that belongs to one sample of the data."""
        return self.laws.steps.get(self.stage.word, self.laws.step)(self._clean)

    @property
    def top(self) -> int:
        """The largest count that the converter gives, DN; without a converter the largest number of the data's type."""
        part = self.laws.converter(self.rig)
        largest = int(np.iinfo(self._clean[self.layout.data].dtype).max)
        return largest if part is None else min(2 ** int(part["adc_bits"]) - 1, largest)

    @property
    def float_type(self) -> str:
        """The type of data that can hold NaN, "" where the layout allows none."""
        return next((name for name in self.layout.by_name[self.layout.data].dtypes if name.startswith("float")), "")

    def clean(self) -> xr.Dataset:
        """A copy of the clean capture, without truth; its arrays can be written."""
        return self._clean.copy(deep=True)

    def with_truth(self) -> xr.Dataset:
        """The clean capture with its truth; never changed."""
        return self._true

    def stressed(self, seed: int, *, light: float = 1.0, background: float = 1.0) -> xr.Dataset:
        """The clean capture with its truth, other noise, and multiples of its light and background."""
        return self._make(seed, light, background)

    def redrawn(self, number: int) -> xr.Dataset:
        """The clean capture, without truth, with other noise; `number` from 1 on tells which."""
        return hide_truth(self._make(_SEED + number))

    def later(self) -> tuple[xr.Dataset, float]:
        """(the clean capture, moved; by how much the answer must change)."""
        return self.laws.later(self.clean())

    def changed(self, change: Change) -> xr.Dataset:
        """The clean capture with other data: `change` gets them as (sample, element)."""
        name = self.layout.data
        held = self._clean[name]
        samples = [dim for dim in held.dims if dim not in self.layout.element]
        ordered = held.transpose(*samples, *self.layout.element)
        values = np.array(ordered.values).reshape(-1, self.elements)
        new = ordered.copy(data=np.asarray(change(values)).reshape(ordered.shape)).transpose(*held.dims)
        capture = self.clean().assign({name: new})
        if name == "counts" and new.dtype.kind == "f":
            capture.attrs["averaged"] = True  # the contract of counts that are no integers
        return capture

    def doubled(self) -> xr.Dataset | None:
        """The same light in an instrument of twice the gain and offset and one more bit; None without a converter."""
        rig = json.loads(self._clean.attrs["rig"])
        part = self.laws.converter(rig)
        if part is None:
            return None
        part["gain_dn_per_e"] *= 2
        part["offset_dn"] *= 2
        part["adc_bits"] += 1
        twice = self.changed(lambda data: data * data.dtype.type(2)).assign_attrs(rig=json.dumps(rig))
        # Other images of the same converter, such as a reference, are in counts too.
        for name, variable in self.layout.by_name.items():
            if name != self.layout.data and name in twice and variable.role == "data" and "DN" in variable.units:
                twice[name] = twice[name].copy(data=twice[name].values * twice[name].dtype.type(2))
        return twice

    @property
    def elements(self) -> int:
        """Number of elements of the clean capture."""
        return int(np.prod([self._clean.sizes[dim] for dim in self.layout.element]))

    def answers(self, result: xr.Dataset) -> list[Answer]:
        """The quantities of an estimate, the one that is scored first in front."""
        return [self._answer(result, at) for at in range(len(self.stage.gives))]

    def first(self, result: xr.Dataset) -> Answer:
        """The quantity that is scored first."""
        return self._answer(result, 0)

    def _answer(self, result: xr.Dataset, at: int) -> Answer:
        quantity = self.stage.gives[at]
        names = self.stage.variables(quantity)
        whole = set(self.layout.element) <= set(quantity.dims)
        first = self.layout.element if whole else quantity.element_dims
        value, sigma, valid = (result[name].transpose(*first, ...).values for name in names.all)
        valid = valid.astype(bool).reshape(valid.shape + (1,) * (value.ndim - valid.ndim))
        # A quantity of the capture as a whole is one that its elements do not have.
        flat = (self.elements if whole else math.prod(value.shape[: len(first)]), -1)
        return Answer(value.reshape(flat), sigma.reshape(flat), np.broadcast_to(valid, value.shape).reshape(flat))
