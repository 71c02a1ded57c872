"""A forward model: what `generate` needs to know of one modality, as one record; and the expectation that it passes on."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any, Generic, TypeVar

import numpy as np
from numpy.typing import NDArray

from ..scenes.scene import Scene
from .choice import Choice
from .effect import Effect
from .request import Request

__all__ = ["Expected", "Model"]

LightT = TypeVar("LightT")


@dataclass(frozen=True, eq=False)
class Expected(Generic[LightT]):
    """What is expected before the detector draws.

    Main arguments:
        electrons: expected photoelectrons of every sample, as the model's own `read` takes them.
        coords, truth: coordinates and truth of the capture by name; no coordinate holds the declared time zero yet.
        rays: number of rays that were traced.
        light: the light that the model's `effects` are judged by.
    Other arguments:
        warnings: sentences for the user. traced: what the capture keeps of the sampling, by name.
    """

    electrons: NDArray[np.float32]
    coords: dict[str, Any]
    truth: dict[str, Any]
    rays: int
    light: LightT
    warnings: tuple[str, ...] = ()
    traced: dict[str, Any] = field(default_factory=dict)


def _anything(scene: Scene, rung: str) -> None:
    """Refuse nothing."""


@dataclass(frozen=True)
class Model(Generic[LightT]):
    """The forward model of one modality.

    Main arguments:
        name: the modality. rungs: the rungs that are built, from the cheapest.
        expect: (scene, request) -> expectation.
        read: (scene, expectation, request) -> the capture's data, drawn by the detector: an array, or several by name.
        effects: (scene, expectation, rung) -> every catalogued effect.
        choose: (scene, request) -> the cheapest rung whose predicted error passes. Raises InputError where none does.
    Other arguments:
        check: (scene, rung) -> None; raises InputError for a rig that the rung ("auto": any rung) does not model.
        apart: rungs that can keep the components of light apart. instances: whether it tells which piece of the target is seen.
        clock: the coordinate that the declared time zero is added to. wet: rungs that need the medium's phase function.
    """

    name: str
    rungs: tuple[str, ...]
    expect: Callable[[Scene, Request], Expected[LightT]]
    read: Callable[[Scene, Expected[LightT], Request], NDArray[Any] | Mapping[str, NDArray[Any]]]
    effects: Callable[[Scene, Expected[LightT], str], list[Effect]]
    choose: Callable[[Scene, Request], Choice]
    check: Callable[[Scene, str], None] = _anything
    apart: tuple[str, ...] = ()
    instances: bool = False
    clock: str = ""
    wet: tuple[str, ...] = ()
