"""Textured albedo on the device: `scenes.textures.bilinear` for drjit, and the coordinates that shapes are given for it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...scenes.meshes import mesh_uv
from ...scenes.scene import TargetObject
from ...scenes.shapes import MeshFile, Sphere
from ...scenes.textures import load_texture, surface_uv
from ..rays.backend import mitsuba

__all__ = ["Shade", "shade_of", "sphere_frame", "vertex_uv"]

Float = NDArray[np.float64]


@dataclass(frozen=True)
class Shade:
    """Relative diffuse albedo T(u, v) of a surface, bilinear between texel centres: u left to right, v top to bottom."""

    texel: Any
    rows: Any
    cols: Any
    around: bool

    def at(self, uv: Any, active: Any) -> Any:
        """T at texture coordinates; where not `active`, 0."""
        import drjit as dr

        mi = mitsuba()
        rows, cols = mi.Int32(self.rows), mi.Int32(self.cols)
        x, y = uv.x * mi.Float(cols) - 0.5, dr.clip(uv.y * mi.Float(rows) - 0.5, 0.0, mi.Float(rows) - 1.0)
        if not self.around:
            x = dr.clip(x, 0.0, mi.Float(cols) - 1.0)
        left, top = mi.Int32(dr.floor(x)), mi.Int32(y)
        fx, fy = x - mi.Float(left), y - mi.Float(top)
        below, right = dr.minimum(top + 1, rows - 1), left + 1
        if self.around:
            left, right = dr.select(left < 0, left + cols, left), dr.select(right >= cols, right - cols, right)
        else:
            right = dr.minimum(right, cols - 1)

        def texel(row: Any, col: Any) -> Any:
            return dr.gather(mi.Float, self.texel, mi.UInt32(row * cols + col), active)

        upper = dr.lerp(texel(top, left), texel(top, right), fx)
        return dr.lerp(upper, dr.lerp(texel(below, left), texel(below, right), fx), fy)


def shade_of(item: TargetObject, where: str) -> Shade | None:
    """The texture of an object; None without one. Raises InputError as `load_texture`."""
    if item.texture is None:
        return None
    import drjit as dr

    mi = mitsuba()
    image = load_texture(item.texture, f"{where}.texture")
    texel = mi.Float(np.ascontiguousarray(image, dtype=np.float32).ravel())
    rows, cols = (dr.opaque(mi.Int32, n) for n in image.shape)
    return Shade(texel, rows, cols, isinstance(item.shape, Sphere))


def vertex_uv(item: TargetObject, vertices: Float, where: str) -> Float:
    """(u, v) of every vertex (n, 3) of a textured object's mesh. On rectangles and reliefs they are linear in the place, so that
    interpolation over a triangle is exact."""
    if isinstance(item.shape, MeshFile):
        return mesh_uv(item.shape, where)
    return np.stack(surface_uv(item.shape, vertices.T), axis=1)


def sphere_frame(center: tuple[float, float, float], radius: float) -> Any:
    """Mitsuba's unit sphere turned so that its (u, v) are ours: its middle toward the camera, its top at −y.

    Its u is the longitude over 2π about its own z, from its x toward its y: these are our z, −x; its z is our −y.
    """
    turn = np.eye(4)
    turn[:3, :3] = radius * np.array([[0.0, -1.0, 0.0], [0.0, 0.0, -1.0], [1.0, 0.0, 0.0]])
    turn[:3, 3] = center
    return mitsuba().ScalarTransform4f(turn)
