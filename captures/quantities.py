"""Quantities that estimators return, with units and dimensions, and the stages to which estimators belong.

The argument of `@estimator` names a stage. Most modalities have one stage, from a capture to a range; a laser line or a
wavefront has a chain of stages, each of which reads the result of an earlier one. Each layout lists the stages of its
modality (`captures/layouts/<modality>.py`).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    import numpy.typing as npt

__all__ = [
    "CAPTURE", "COMPONENTS", "COORDINATES", "GREATEST", "LEAST", "Quantity", "Stage", "possible_sigma", "possible_value",
]  # fmt: skip

#: Input of the first stage of a modality.
CAPTURE = "capture"
#: Input of later stages: the capture's coordinates without its data, as the attitude of every frame.
COORDINATES = "coordinates"


#: Least standard error and greatest magnitude of an answer, in any unit: squares of their ratios are still numbers.
LEAST, GREATEST = 1e-30, 1e30


def possible_value(value: npt.NDArray[Any]) -> npt.NDArray[Any]:
    """Whether a value can be an answer: finite, of a magnitude up to GREATEST."""
    return abs(value) <= GREATEST  # type: ignore[no-any-return]


def possible_sigma(sigma: npt.NDArray[Any]) -> npt.NDArray[Any]:
    """Whether a number can be a standard error: from LEAST to GREATEST."""
    return (sigma >= LEAST) & (sigma <= GREATEST)  # type: ignore[no-any-return]


#: Lengths of the dimensions that count the components of an element: the two axes of an image, the three of space.
COMPONENTS = {"axis": 2, "xyz": 3}


@dataclass(frozen=True)
class Quantity:
    """A measured quantity.

    Main arguments:
        name, unit: name and unit in variables and tables, e.g. "range" and "m".
        dims: dimensions of an estimate of one capture. The estimator chooses the length of a dimension that its capture
            does not have.
        long_name: description in a few words.
    Other arguments:
        noun: the word for one element where it is not the layout's, e.g. "spot" for one of the many spots of a frame.
        shown: (factor, unit) for display, e.g. (1e3, "mm").
        positive: whether zero and negative values are impossible.
        components: the last dimensions, if they count the components of one element (x, y and z of a point): an element
            has one `valid`, and a value and a standard error per component.
    """

    name: str
    unit: str
    dims: tuple[str, ...]
    long_name: str
    shown: tuple[float, str] = (1.0, "")
    positive: bool = False
    components: tuple[str, ...] = ()
    noun: str = ""

    @property
    def element_dims(self) -> tuple[str, ...]:
        """Dimensions of `valid`: those of the quantity, without its components."""
        return self.dims[: len(self.dims) - len(self.components)]

    @property
    def is_image(self) -> bool:
        """Whether an estimate is an image: one value per row and column of a camera."""
        return self.dims == ("row", "col")

    @property
    def display(self) -> tuple[float, str]:
        """Factor and unit in which the quantity is displayed."""
        return (self.shown[0], self.shown[1] or self.unit)


@dataclass(frozen=True)
class Variables:
    """Names of the variables that hold one quantity in an estimate."""

    value: str
    sigma: str
    valid: str

    @property
    def all(self) -> tuple[str, str, str]:
        """Value, sigma and valid."""
        return (self.value, self.sigma, self.valid)


@dataclass(frozen=True)
class Stage:
    """A step from a capture, or from the estimates of another stage, to quantities.

    Main arguments:
        word: argument of `@estimator`, unique over all modalities.
        name: entry of the column `stage` in tables.
        modality: modality of the captures at the start of the chain.
        takes: inputs in order: "capture", the names of quantities of other stages, "rig", "coordinates". A stage may take both a
            quantity and the capture, e.g. for an image beside the frames.
        gives: quantities that the stage returns; the main one comes first.
    """

    word: str
    name: str
    modality: str
    takes: tuple[str, ...]
    gives: tuple[Quantity, ...]

    @property
    def reads_captures(self) -> bool:
        """Whether the stage reads captures, and not the results of another stage."""
        return CAPTURE in self.takes and set(self.takes) <= {CAPTURE, COORDINATES, "rig"}

    def variables(self, quantity: Quantity) -> Variables:
        """The variables of one quantity: `range`, `sigma`, `valid`. For every quantity after the first, the names of the last
        two end in its own: `sigma_phase`, `valid_phase`."""
        if quantity == self.gives[0]:
            return Variables(quantity.name, "sigma", "valid")
        return Variables(quantity.name, f"sigma_{quantity.name}", f"valid_{quantity.name}")

    def dims(self) -> dict[str, tuple[str, ...]]:
        """Dimensions of every variable of an estimate, by name."""
        found: dict[str, tuple[str, ...]] = {}
        for quantity in self.gives:
            names = self.variables(quantity)
            found |= {names.value: quantity.dims, names.sigma: quantity.dims, names.valid: quantity.element_dims}
        return found
