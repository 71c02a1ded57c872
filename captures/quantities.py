"""What estimators give: quantities with their units and dimensions, and the stages that an estimator may take.

A stage is the word under `@estimator`. Most modalities have one, from a capture to a range; a line or a wavefront has a
chain of them, each of which reads what the one before gives. Each layout lists the stages of its modality
(`captures/layouts/<modality>.py`).
"""

from __future__ import annotations

from dataclasses import dataclass

__all__ = ["CAPTURE", "Quantity", "Stage"]

#: What the first stage of a modality reads.
CAPTURE = "capture"


@dataclass(frozen=True)
class Quantity:
    """A measured quantity.

    Main arguments:
        name, unit: as variables and tables name them, e.g. "range" and "m".
        dims: dimensions of an estimate of one capture. A dimension that the capture an estimator reads does not have is
            the estimator's to choose.
        long_name: what it is, for people.
    Other arguments:
        shown: (factor, unit) for people, e.g. (1e3, "mm").
        positive: whether values of zero and below are impossible.
        components: the last dimensions, where they are the components of one element (x, y and z of a point): an element
            has one `valid`, and as many values and standard errors as components.
    """

    name: str
    unit: str
    dims: tuple[str, ...]
    long_name: str
    shown: tuple[float, str] = (1.0, "")
    positive: bool = False
    components: tuple[str, ...] = ()

    @property
    def element_dims(self) -> tuple[str, ...]:
        """Dimensions of `valid`: those of the quantity without its components."""
        return self.dims[: len(self.dims) - len(self.components)]

    @property
    def is_image(self) -> bool:
        """Whether an estimate is one picture of the scene: a value per row and column of a camera."""
        return self.dims == ("row", "col")

    @property
    def display(self) -> tuple[float, str]:
        """Factor and unit in which people read the quantity."""
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
        word: under `@estimator`, unique over all modalities.
        name: in the column `stage` of tables.
        modality: of the captures that the chain starts from.
        takes: what is read, in order: "capture", the names of quantities of other stages, "rig".
        gives: the quantities, the one that is scored first in front.
    """

    word: str
    name: str
    modality: str
    takes: tuple[str, ...]
    gives: tuple[Quantity, ...]

    @property
    def reads_captures(self) -> bool:
        """Whether the stage reads captures, rather than what another stage gives."""
        return CAPTURE in self.takes

    def variables(self, quantity: Quantity) -> Variables:
        """The variables of one quantity: `range`, `sigma`, `valid`; of every quantity but the first, the last two end in
        its name: `sigma_phase`, `valid_phase`."""
        if quantity == self.gives[0]:
            return Variables(quantity.name, "sigma", "valid")
        return Variables(quantity.name, f"sigma_{quantity.name}", f"valid_{quantity.name}")

    def dims(self) -> dict[str, tuple[str, ...]]:
        """Dimensions of every variable of an estimate, by its name."""
        found: dict[str, tuple[str, ...]] = {}
        for quantity in self.gives:
            names = self.variables(quantity)
            found |= {names.value: quantity.dims, names.sigma: quantity.dims, names.valid: quantity.element_dims}
        return found
