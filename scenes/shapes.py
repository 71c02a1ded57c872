"""Shapes of targets. Camera frame: x right, y down, z forward, origin at the entrance pupil; metres and degrees."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field

from .base import Positive, Spec, Vec3

__all__ = ["Box", "HeightGrid", "MeshFile", "Rectangle", "Shape", "Sphere"]


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


class MeshFile(Spec):
    """A mesh file (.obj, .ply, .stl, .off, .gltf, .glb, .3mf, each also .gz), centred on its bounds and scaled so that its
    largest extent is `size_m`. Faces without area do not count."""

    kind: Literal["mesh"] = "mesh"
    file: str
    size_m: Positive
    center_m: Vec3
    rotation_deg: Vec3


Shape = Annotated[Rectangle | Sphere | Box | HeightGrid | MeshFile, Field(discriminator="kind")]
