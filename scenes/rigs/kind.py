"""A kind of rig: what the rest of the house needs to know of one modality's instrument, as one record."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Generic, Protocol, TypeVar

from ..base import Spec, Vec3
from ..errors import InputError
from ..medium import Medium

__all__ = ["RigKind", "RigScene", "RigSpec", "other_kind"]


class RigSpec(Spec, ABC):
    """Base of the specs of all rigs. Each declares `kind`, which is its modality, and `t0_s`, its zero of time."""

    if TYPE_CHECKING:  # fields of each spec, in the order of its own file, which is that of its data
        kind: str
        t0_s: float

    @property
    @abstractmethod
    def wavelength_m(self) -> float:
        """Vacuum wavelength of the rig's light, m."""


class RigScene(Protocol):
    """The parts of a scene that a kind of rig may read."""

    @property
    def name(self) -> str:
        """Name of the scene."""
        ...

    @property
    def medium(self) -> Medium:
        """The medium between rig and target."""
        ...

    @property
    def rig(self) -> RigSpec:
        """The true rig."""
        ...

    @property
    def declared(self) -> Mapping[str, Any]:
        """{path: value}, applied over rig and medium to make the declared rig."""
        ...


RigT = TypeVar("RigT", bound=RigSpec)


@dataclass(frozen=True)
class RigKind(Generic[RigT]):
    """One kind of rig.

    Main arguments:
        name: the modality. spec: the class of the rig's data.
        declare: scene -> plain data of the instrument as declared (attribute `rig` of a capture).
        check: scene -> None; raises InputError for a rig whose values are allowed one by one and impossible together.
        sizes: rig -> samples per element, rows and columns of elements of a capture.
        places: rig -> where the camera ("camera") and each lamp that stands apart from it ("laser") are, m.
    """

    name: str
    spec: type[RigT]
    declare: Callable[[RigScene], dict[str, Any]]
    check: Callable[[RigScene], None]
    sizes: Callable[[RigT], tuple[int, int, int]]
    places: Callable[[RigT], dict[str, Vec3]]


def other_kind(scene: RigScene, wanted: str) -> InputError:
    """The error of a function that works on scenes of one kind and was given a scene of another."""
    return InputError(
        f"This works on {wanted} scenes only.", where=f"{scene.name}: rig.kind", value=scene.rig.kind, allowed=wanted
    )
