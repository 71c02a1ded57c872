"""The record of a kind of rig: all that other floors need to know of one modality's instrument."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Generic, Protocol, TypeVar

from ..base import Spec, Vec3
from ..errors import InputError
from ..medium import Medium
from .parts import Camera, Illumination
from .roles import Role, check_roles

__all__ = ["RigKind", "RigScene", "RigSpec", "RigView", "rig_of"]


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


@dataclass(frozen=True)
class RigView:
    """What a rig looks at and lights, for pictures.

    Main arguments:
        camera: the camera, None for a single detector whose shots scan.
        beam: profile of the light, None for a rig that sends out none.
    Other arguments:
        shots, scan_half_angle_rad: shots look along even angles from −a to +a in the x-z plane.
    """

    camera: Camera | None
    beam: Illumination | None
    shots: int = 1
    scan_half_angle_rad: float = 0.0


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
        view: rig -> what it looks at and lights, for pictures.
        resize: side -> overrides {path: value} that leave side² elements, or about as many places where an element holds several,
            for quick searches.
        roles: role (a name of `roles.ROLES`) -> path of the scene, or a record.
    Other arguments:
        needs_target: whether a scene with this rig must hold an object.
        whole: paths of optional tables, which a scene may lack: a rig file gives each as a whole.
    """

    name: str
    spec: type[RigT]
    declare: Callable[[RigScene], dict[str, Any]]
    check: Callable[[RigScene], None]
    sizes: Callable[[RigT], tuple[int, int, int]]
    places: Callable[[RigT], dict[str, Vec3]]
    view: Callable[[RigT], RigView]
    resize: Callable[[int], dict[str, Any]]
    roles: Mapping[str, Role]
    needs_target: bool = True
    whole: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        check_roles(self.roles, self.name)


def rig_of(scene: RigScene, spec: type[RigT]) -> RigT:
    """The scene's rig, which must be one of this class. Raises InputError for a scene of another modality."""
    if not isinstance(scene.rig, spec):
        wanted = str(spec.model_fields["kind"].default)
        raise InputError(
            f"This works on {wanted} scenes only.",
            where=f"{scene.name}: rig.kind",
            value=scene.rig.kind,
            allowed=wanted,
        )
    return scene.rig
