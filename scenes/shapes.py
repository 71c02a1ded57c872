"""Shapes of targets. Camera frame: x right, y down, z forward, origin at the entrance pupil; metres and degrees."""

from __future__ import annotations

from typing import Annotated, Any, Literal

from pydantic import Field, SerializerFunctionWrapHandler, model_serializer, model_validator

from .base import Positive, Spec, Vec3
from .procedural.spec import Pipes, Rocks, Terraces, Vegetation, Wreck

__all__ = ["Box", "HeightGrid", "MeshFile", "PowerLawRelief", "Rectangle", "Shape", "Sphere"]

#: Heights of a relief, its waves beyond the patch included: 400 MB while it is drawn.
_MOST_HEIGHTS = 1.6e7


class Rectangle(Spec):
    """A flat rectangle that faces the camera when untilted.

    Its normal is (0, 0, -1) turned first about x by `tilt_x_deg`, then about y by `tilt_y_deg` (right-handed).
    """

    kind: Literal["rectangle"] = "rectangle"
    center_m: Vec3
    width_m: Positive
    height_m: Positive
    tilt_x_deg: Annotated[float, Field(gt=-90, lt=90)]
    tilt_y_deg: Annotated[float, Field(gt=-90, lt=90)]


class Sphere(Spec):
    """A sphere, exact (not a mesh)."""

    kind: Literal["sphere"] = "sphere"
    center_m: Vec3
    radius_m: Positive


class Box(Spec):
    """A cuboid: `size_m` along x, y, z, turned about its centre by Euler angles (x, then y, then z)."""

    kind: Literal["box"] = "box"
    center_m: Vec3
    size_m: tuple[Positive, Positive, Positive]
    rotation_deg: Vec3


class HeightGrid(Spec):
    """A relief from a grid of heights (.npz with one 2-D array, or .npy), scaled into the scene.

    The grid spans `width_m` across x (its aspect ratio gives the height); its lowest point lies at `center_m`'s z and
    its highest `relief_m` nearer to the camera, before the tilt. Row 0 is at the top (smallest y).
    """

    kind: Literal["height-grid"] = "height-grid"
    file: str
    center_m: Vec3
    width_m: Positive
    relief_m: Positive
    tilt_x_deg: Annotated[float, Field(gt=-90, lt=90)]
    tilt_y_deg: Annotated[float, Field(gt=-90, lt=90)]


class PowerLawRelief(Spec):
    """A rough plane drawn from a power law, `width_m` along x and `height_m` along y before the tilt, which is a rectangle's.

    Heights toward the camera are Gaussian, of mean 0 and `rms_m`; along every straight profile their spectrum falls with spatial
    frequency as f^−slope between 1/`outer_m` and 1/`inner_m`, and they have no other waves. `pitch_m`: spacing of the mesh, at most
    half of `inner_m`. `seed` decides the phases: equal seeds give equal surfaces.
    """

    kind: Literal["power-law"] = "power-law"
    center_m: Vec3
    width_m: Positive
    height_m: Positive
    tilt_x_deg: Annotated[float, Field(gt=-90, lt=90)]
    tilt_y_deg: Annotated[float, Field(gt=-90, lt=90)]
    slope: Annotated[float, Field(gt=1, lt=5)]
    rms_m: Positive
    outer_m: Positive
    inner_m: Positive
    pitch_m: Positive
    seed: Annotated[int, Field(ge=0, le=2**63 - 1)]

    @model_validator(mode="after")
    def _scales_are_in_order(self) -> PowerLawRelief:
        waves = 2.0 * self.outer_m / self.pitch_m
        sides = (max(self.width_m / self.pitch_m, waves), max(self.height_m / self.pitch_m, waves))
        if not 2.0 * self.pitch_m <= self.inner_m < self.outer_m:
            found = f"{self.pitch_m}, {self.inner_m}, {self.outer_m}"
            raise ValueError(f"the scales should be 2 pitch_m <= inner_m < outer_m, not {found}")
        if sides[0] * sides[1] > _MOST_HEIGHTS:
            count = f"{sides[0] * sides[1]:.3g}"
            raise ValueError(f"the relief has {count} heights, of at most {_MOST_HEIGHTS:.3g}: raise pitch_m")
        return self


class MeshFile(Spec):
    """A mesh file (.obj, .ply, .stl, .off, .gltf, .glb, .3mf, each also .gz), scaled so that its largest extent is `size_m`, or
    as large as it is where `unit` names the unit of its coordinates. Faces without area do not count.

    `origin`: what lies at `center_m`, and what it is turned about: the middle of its bounds, or, with `unit`, the file's own
    origin, so that parts of one drawing keep their places.
    """

    kind: Literal["mesh"] = "mesh"
    file: str
    size_m: Positive | None = None
    unit: Literal["m", "cm", "mm", "um", "in", "ft"] | None = None
    origin: Literal["bounds", "file"] = "bounds"
    center_m: Vec3
    rotation_deg: Vec3

    @model_validator(mode="after")
    def _has_one_size(self) -> MeshFile:
        if (self.size_m is None) == (self.unit is None):
            raise ValueError("size_m (its largest extent) or unit (of its coordinates), and not both")
        if self.origin == "file" and self.unit is None:
            raise ValueError('origin = "file" needs unit, not size_m')
        return self

    @model_serializer(mode="wrap")
    def _without_absent_options(self, handler: SerializerFunctionWrapHandler) -> dict[str, Any]:
        data: dict[str, Any] = handler(self)
        absent = {"size_m": None, "unit": None, "origin": "bounds"}
        return {key: value for key, value in data.items() if key not in absent or value != absent[key]}


Shape = Annotated[
    Rectangle | Sphere | Box | HeightGrid | PowerLawRelief | MeshFile | Rocks | Pipes | Terraces | Vegetation | Wreck,
    Field(discriminator="kind"),
]
