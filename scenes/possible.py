"""Scenes that cannot be set up although each of their values is allowed."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel

from ..optics.rotation import rotation_matrix
from .declared import declared_rig
from .errors import InputError
from .medium import WaterIndex
from .procedural.spec import Procedural
from .rigs import rig_kind
from .scene import Scene, TargetObject
from .shapes import Box, HeightGrid, MeshFile, Rectangle, Sphere

__all__ = ["check_possible", "check_solid", "inside_closed"]

Float = NDArray[np.float64]

#: A lens or lamp this near to a surface lies in it.
_CONTACT_M = 1e-6


def check_possible(scene: Scene) -> None:
    """Refuse an impossible scene. Files of meshes are not read here: `check_solid` takes their triangles.

    Raises:
        InputError: camera or laser in or on an object; nothing ahead of the camera; a laser behind the target or, in
            water, behind the window; a gate longer than the time between pulses; pulse and gates whose samples would be too
            many or too few; an integration shorter than a period of
            the modulation; an offset beyond the last code of a detector; a declared path or value that is not allowed.
    """
    places = _places(scene)
    for item in scene.target:
        for who, at in places.items():
            if _within(item, at):
                raise _inside(scene, item, who)
    ahead = [float(_reach(item)) for item in scene.target]
    if ahead and max(ahead) <= 0:
        raise InputError(
            "The whole target lies behind the camera.",
            where=f"{scene.name}: target.{scene.target[int(np.argmax(ahead))].name}.shape.center_m",
            value=list(scene.target[int(np.argmax(ahead))].shape.center_m),
            allowed="something at z > 0: z points forward",
        )
    for who, at in places.items():
        if who != "camera" and ahead:
            _check_lamp(scene, who, at, max(ahead))
    _check_codes(scene.rig, f"{scene.name}: rig")
    rig_kind(scene.modality).check(scene)
    if scene.declared:
        declared_rig(scene)


def _check_codes(spec: BaseModel, where: str) -> None:
    """Refuse a detector whose offset is no code below the last one: it could record no light at all."""
    offset, bits = getattr(spec, "offset_dn", None), getattr(spec, "adc_bits", None)
    if offset is not None and bits is not None and not offset < 2**bits - 1:
        raise InputError(
            "The detector's offset lies beyond its last code, so that it records no light.", where=f"{where}.offset_dn",
            value=offset, allowed=f"below {2**bits - 1}, the last code of {bits} bits",
        )  # fmt: skip
    for name, value in spec:
        if isinstance(value, BaseModel):
            _check_codes(value, f"{where}.{name}")


def _places(scene: Scene) -> dict[str, Float]:
    """Where camera and lamps stand, m."""
    places = rig_kind(scene.modality).places(scene.rig)
    return {who: np.asarray(at, dtype=np.float64) for who, at in places.items()}


def check_solid(scene: Scene, item: TargetObject, vertices: Float, faces: NDArray[np.int64]) -> None:
    """Refuse a camera or laser inside a closed mesh, given its triangles. Raises InputError."""
    if not isinstance(item.shape, MeshFile):
        return
    places = _places(scene)
    for who, at in places.items():
        coincides = who != "camera" and np.array_equal(at, places["camera"])
        if not coincides and inside_closed(at, vertices, faces):
            raise _inside(scene, item, who)


def inside_closed(point: Float, vertices: Float, faces: NDArray[np.int64]) -> bool:
    """Whether a point lies inside a closed mesh: its triangles then fill 4π of solid angle around it, else 0.

    Solid angles by van Oosterom and Strackee (1983): tan(Ω/2) = a·(b × c)/(abc + (a·b)c + (b·c)a + (c·a)b). A mesh with
    holes has no inside.
    """
    low, high = vertices.min(axis=0), vertices.max(axis=0)
    if np.any(point < low) or np.any(point > high):
        return False
    a, b, c = (vertices[faces[:, i]] - point for i in range(3))
    la, lb, lc = (np.linalg.norm(v, axis=1) for v in (a, b, c))
    above = np.einsum("fi,fi->f", a, np.cross(b, c))
    dot = [np.einsum("fi,fi->f", p, q) for p, q in ((a, b), (b, c), (c, a))]
    total = 2.0 * float(np.sum(np.arctan2(above, la * lb * lc + dot[0] * lc + dot[1] * la + dot[2] * lb)))
    if abs(total) < 2.0 * np.pi:
        return False
    import trimesh

    return bool(trimesh.Trimesh(vertices, faces, process=True).is_watertight)


def _inside(scene: Scene, item: TargetObject, who: str) -> InputError:
    return InputError(
        f"The {who} is inside a target.",
        where=f"{scene.name}: target.{item.name}.shape",
        value=item.shape.model_dump(mode="json"),
        allowed=f"the {who} outside of every solid, and not on a surface",
        next_step="move the object away from the rig (z points forward)",
    )


def _within(item: TargetObject, at: Float) -> bool:
    shape = item.shape
    offset = at - np.asarray(shape.center_m)
    if isinstance(shape, Sphere):
        return float(np.linalg.norm(offset)) <= shape.radius_m + _CONTACT_M
    if isinstance(shape, Box | Procedural):  # within the box of a recipe, nobody knows what is free
        local = rotation_matrix(shape.rotation_deg).T @ offset
        return bool(np.all(np.abs(local) <= 0.5 * np.asarray(shape.size_m) + _CONTACT_M))
    if isinstance(shape, Rectangle):
        x, y, height = _turned(shape).T @ offset
        beside = abs(x) <= 0.5 * shape.width_m and abs(y) <= 0.5 * shape.height_m
        return bool(abs(height) <= _CONTACT_M and beside)
    return False


def _turned(shape: Rectangle | HeightGrid) -> Float:
    return rotation_matrix((shape.tilt_x_deg, shape.tilt_y_deg, 0.0))


def _reach(item: TargetObject) -> float:
    """Upper bound of z of the object: exact for flat and round shapes, that of the enclosing ball for files."""
    shape: Any = item.shape
    z = float(shape.center_m[2])
    if isinstance(shape, Sphere):
        return z + float(shape.radius_m)
    if isinstance(shape, Box | Procedural):
        return z + 0.5 * float(np.abs(rotation_matrix(shape.rotation_deg))[2] @ np.asarray(shape.size_m))
    if isinstance(shape, Rectangle):
        turn = np.abs(_turned(shape))[2]
        return z + 0.5 * float(turn[0] * shape.width_m + turn[1] * shape.height_m)
    if isinstance(shape, MeshFile) and shape.size_m is not None:
        return z + 0.5 * float(np.sqrt(3.0)) * float(shape.size_m)
    return float("inf")  # a grid's height follows from its file, that of a power law from its seed


def _check_lamp(scene: Scene, who: str, at: Float, furthest: float) -> None:
    where = f"{scene.name}: rig.{who}.position_m"
    wet = scene.medium.attenuation_per_m > 0 or isinstance(scene.medium.index, WaterIndex)
    if wet and at[2] < 0:
        raise InputError(
            f"The {who} lies behind the window: its light would cross the housing, not the water.",
            where=where,
            value=at.tolist(),
            allowed="z ≥ 0 in water; the window and the entrance pupil lie at z = 0",
        )
    planes = [item.shape for item in scene.target if isinstance(item.shape, Rectangle)]
    hidden = len(planes) == len(scene.target) and all(_opposite(shape, at) for shape in planes)
    if at[2] >= furthest or hidden:
        raise InputError(
            f"The {who} lies behind the target: no surface that the camera sees is lit.",
            where=where,
            value=at.tolist(),
            allowed=f"z below {furthest:g} m, on the camera's side of the target",
        )


def _opposite(shape: Rectangle, laser: Float) -> bool:
    """Whether camera and laser lie on opposite sides of a rectangle's plane."""
    normal = _turned(shape)[:, 2]
    centre = np.asarray(shape.center_m)
    return bool((normal @ centre) * (normal @ (centre - laser)) < 0)
