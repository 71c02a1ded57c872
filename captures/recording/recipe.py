"""A recipe: what a recording of one modality is made of. One record per modality, in a file of its name."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from ...scenes.base import Spec
from ...scenes.records import record_of

if TYPE_CHECKING:
    from ...scenes.scene import Scene

__all__ = ["RECIPES", "Built", "Recipe", "Slot", "Taken", "mean_of", "recipe_of"]

#: modality -> "module:object"; the others cannot be recorded yet.
RECIPES: dict[str, str] = {
    "gated": "beambench.captures.recording.gated:RECIPE",
    "waveform": "beambench.captures.recording.waveform:RECIPE",
    "laser_line": "beambench.captures.recording.laser_line:RECIPE",
    "wavefront": "beambench.captures.recording.wavefront:RECIPE",
}


@dataclass(frozen=True)
class Slot:
    """One shot to be taken.

    Main arguments:
        part: "dark", "reference" or "scan". group: slots of one group become one element (slice, frame, shot) of the capture.
        settings: {role: {setting: value}} of the devices.
    """

    part: str
    group: int
    settings: Mapping[str, Mapping[str, Any]] = field(default_factory=dict)


@dataclass(frozen=True, eq=False)
class Taken:
    """What was recorded: `data` (slot, …), `valid` (slot), and the journal's line of each slot (None where there is none)."""

    slots: Sequence[Slot]
    data: NDArray[Any]
    valid: NDArray[np.bool_]
    lines: Sequence[Mapping[str, Any] | None]
    fixed: Mapping[str, Mapping[str, Any]]

    def of_group(self) -> list[NDArray[np.intp]]:
        """Slots of each group, in order."""
        group = np.array([slot.group for slot in self.slots])
        return [np.flatnonzero(group == number) for number in range(int(group.max()) + 1)]

    def told(self, slot: int, role: str, name: str) -> Any:
        """A setting of a slot as read back; where the slot is missing, as it was asked for."""
        line = self.lines[slot]
        asked = self.slots[slot].settings[role][name]
        return asked if line is None else line["told"].get(role, {}).get(name, asked)

    def times_s(self) -> NDArray[np.float64]:
        """Time of each slot after the first one on the host's clock, s; NaN where it is missing."""
        host = [np.nan if line is None else float(line["host_ns"] - self._first_ns()) for line in self.lines]
        return np.array(host) * 1e-9

    def _first_ns(self) -> int:
        return min(int(line["host_ns"]) for line in self.lines if line is not None)


@dataclass(frozen=True)
class Built:
    """Data and coordinates of a capture by name, and whether its counts are means of several exposures."""

    data: Mapping[str, Any]
    coords: Mapping[str, Any]
    averaged: bool = False


@dataclass(frozen=True)
class Recipe:
    """How one modality is recorded.

    Main arguments:
        name: the modality. spec: what a plan's table `scan` holds. roles: the devices that a plan needs, the one that gives
            the data first.
        slots: (scan, scene) -> the shots, in the order in which they are taken.
        fixed: (scan, scene) -> {role: settings} that hold for the whole recording.
        shape: (scan, scene) -> shape of one reading. dtype: its numbers.
        build: (scan, scene, taken, declared rig) -> data and coordinates.
    """

    name: str
    spec: type[Spec]
    roles: tuple[str, ...]
    slots: Callable[[Any, Scene], list[Slot]]
    fixed: Callable[[Any, Scene], dict[str, dict[str, Any]]]
    shape: Callable[[Any, Scene], tuple[int, ...]]
    build: Callable[[Any, Scene, Taken, Mapping[str, Any]], Built]
    dtype: str = "uint16"


def recipe_of(modality: object) -> Recipe:
    """The recipe of a modality. Raises InputError where there is none."""
    recipe: Recipe = record_of(RECIPES, modality, "Captures of this modality cannot be recorded yet.", "rig.kind")
    return recipe


def mean_of(taken: Taken, chosen: Sequence[NDArray[np.intp]]) -> NDArray[Any]:
    """Each group's reading: itself where every group has one slot, else the mean of its valid slots as float32; 0 of none."""
    if all(len(group) == 1 for group in chosen):
        return taken.data[np.concatenate(chosen)]
    means = np.zeros((len(chosen), *taken.data.shape[1:]), np.float32)
    for number, group in enumerate(chosen):
        sound = group[taken.valid[group]]
        if sound.size:
            means[number] = taken.data[sound].mean(axis=0, dtype=np.float64)
    return means
