"""First hits by Mitsuba: build its scene from ours, shoot pinhole rays, return plain arrays. The one place that talks rays.

We make the rays ourselves from pixel coordinates, so Mitsuba's film (which mirrors x and y) is not involved.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...scenes.meshes import mesh_uv
from ...scenes.possible import check_possible, check_solid
from ...scenes.procedural.build import procedural_mesh
from ...scenes.procedural.spec import Procedural
from ...scenes.rigs.parts import Camera
from ...scenes.scene import Scene
from ...scenes.shapes import MeshFile, Rectangle, Sphere
from ...scenes.textures import bilinear, load_texture, surface_uv
from ...scenes.whole import object_mesh, place_of
from .backend import mitsuba, ray_scene

__all__ = ["Hits", "Tracer", "pixel_directions"]

Float = NDArray[np.float64]

#: Rays in one wavefront: bounds memory (about 100 bytes a ray) without costing speed.
_RAYS_PER_LAUNCH = 1 << 22
#: Angle, rad, by which a ray is turned to either side to see whether it slipped through a vertex: 30 roundings of float32.
_ASIDE_RAD = 2e-6
#: A surface is in front of another if it is nearer by this share of the range; float32 hits err by a tenth of it.
_IN_FRONT = 1e-5


@dataclass(frozen=True)
class Hits:
    """First hits of n rays. `distance` m along the unit ray (inf where nothing is hit), `normal` (3, n) unit and turned
    toward the camera, `target` index of the object in the scene, −1 where nothing is hit, `shade` relative diffuse albedo
    of the object's texture there (1 without one), `piece` number of the piece of the object that is hit (0 where it is one)."""

    distance: Float
    normal: Float
    target: NDArray[np.int32]
    shade: Float
    piece: NDArray[np.int32]


def pixel_directions(camera: Camera, row: Any, col: Any) -> Float:
    """Unit directions (3, n) of the rays through pixel coordinates (integers are pixel centres): x right, y down, z forward.

    d ∝ ((col − c₀) p/f, (row − r₀) p/f, 1), p the pixel pitch, f the focal length, (r₀, c₀) the array's centre.
    """
    scale = camera.pixel_pitch_m / camera.focal_length_m
    x = (np.asarray(col, dtype=np.float64) - (camera.cols - 1) / 2) * scale
    y = (np.asarray(row, dtype=np.float64) - (camera.rows - 1) / 2) * scale
    inverse = 1.0 / np.sqrt(x * x + y * y + 1.0)
    return np.stack([x * inverse, y * inverse, inverse])


class Tracer:
    """Mitsuba's view of a scene's target.

    Main arguments:
        scene: the scene; its meshes are loaded here.

    Raises:
        InputError: an unreadable mesh or texture, or an impossible scene, such as a camera inside a solid.
    """

    def __init__(self, scene: Scene) -> None:
        mi = mitsuba()
        self._mi: Any = mi
        check_possible(scene)
        self._objects = scene.target
        self._textures = {
            number: load_texture(item.texture, f"{place_of(scene, item)}.texture")
            for number, item in enumerate(scene.target)
            if item.texture is not None
        }
        parts: dict[str, Any] = {}
        self._meshes: dict[int, tuple[Any, Any]] = {}
        self._pieces: dict[int, NDArray[np.int32]] = {}
        #: Pieces of each object.
        self.pieces = [1] * len(scene.target)
        # Only where several triangles meet in one vertex can a ray slip through.
        self._vertices = any(not isinstance(item.shape, Sphere | Rectangle) for item in scene.target)
        for number, item in enumerate(scene.target):
            if isinstance(item.shape, Sphere):
                parts[f"o{number}"] = {
                    "type": "sphere",
                    "center": list(item.shape.center_m),
                    "radius": item.shape.radius_m,
                }
            else:
                vertices, faces = object_mesh(scene, item)
                if isinstance(item.shape, MeshFile):
                    self._meshes[number] = (vertices, faces)
                if isinstance(item.shape, Procedural):
                    made = procedural_mesh(item.shape)
                    self._pieces[number], self.pieces[number] = made.instance, made.instances
                uv = None
                if number in self._textures and isinstance(item.shape, MeshFile):
                    uv = mesh_uv(item.shape, f"{place_of(scene, item)}.shape.file")
                parts[f"o{number}"] = _mesh(mi, f"o{number}", vertices, faces, uv)
        self._scene = ray_scene(parts)
        # Shapes come back in Mitsuba's own order: translate its pointers to our indices by the shapes' names.
        import drjit as dr

        index_of: dict[int, int] = {}
        for shape in self._scene.shapes():
            pointer: Any = dr.reinterpret_array(mi.UInt32, mi.ShapePtr(shape))
            index_of[int(pointer.numpy()[0])] = int(shape.id()[1:])
        table = np.full(max(index_of) + 1, -1, dtype=np.int32)
        for pointer_id, number in index_of.items():
            table[pointer_id] = number
        self._table = table

    def check(self, scene: Scene) -> None:
        """Refuse an impossible scene of the same target, such as one whose rig is elsewhere. Raises InputError."""
        check_possible(scene)
        for number, (vertices, faces) in self._meshes.items():
            check_solid(scene, scene.target[number], vertices, faces)

    def trace(self, origin: tuple[float, float, float] | Float, direction: Float) -> Hits:
        """First hits of rays along unit `direction` (3, n), from one origin or from an origin each (3, n).

        No ray slips through a seam of a closed surface: what rays 2 µrad to both sides hit in front, it hits.
        """
        count = direction.shape[1]
        if not count:
            return Hits(np.zeros(0), np.zeros((3, 0)), np.zeros(0, np.int32), np.zeros(0), np.zeros(0, np.int32))
        start = np.asarray(origin, dtype=np.float64).reshape(3, -1)
        parts = [
            self._launch(_part(start, i), direction[:, i : i + _RAYS_PER_LAUNCH])
            for i in range(0, count, _RAYS_PER_LAUNCH)
        ]
        if len(parts) == 1:
            return parts[0]
        return Hits(
            np.concatenate([p.distance for p in parts]),
            np.concatenate([p.normal for p in parts], axis=1),
            np.concatenate([p.target for p in parts]),
            np.concatenate([p.shade for p in parts]),
            np.concatenate([p.piece for p in parts]),
        )

    def _launch(self, origin: Float, direction: Float, *, aside: bool = False) -> Hits:
        import drjit as dr

        mi = self._mi
        d = np.ascontiguousarray(direction, dtype=np.float32)
        ray = mi.Ray3f(_point(mi, origin), mi.Vector3f(mi.Float(d[0]), mi.Float(d[1]), mi.Float(d[2])))
        preliminary = self._scene.ray_intersect_preliminary(ray, coherent=True)
        flags = mi.RayFlags.Minimal | mi.RayFlags.UV if self._textures else mi.RayFlags.Minimal
        surface = preliminary.compute_surface_interaction(ray, flags)
        t, n = surface.t, surface.n
        shape: Any = dr.reinterpret_array(mi.UInt32, surface.shape)
        dr.eval(t, n, shape)
        distance = np.asarray(t.numpy(), dtype=np.float64)
        normal = np.asarray(n.numpy(), dtype=np.float64)
        target = self._table[shape.numpy()]
        away = np.einsum("in,in->n", normal, direction) > 0  # open surfaces are two-sided: turn toward the camera
        normal[:, away] *= -1.0
        target = np.where(np.isfinite(distance), target, np.int32(-1))
        uv = np.asarray(surface.uv.numpy(), dtype=np.float64) if self._textures else np.zeros((2, 0))
        piece = self._piece(target, preliminary)
        hits = Hits(distance, normal, target, self._shade(origin, direction, distance, target, uv), piece)
        if self._vertices and not aside:
            self._close_vertices(origin, direction, hits)
        return hits

    def _close_vertices(self, origin: Float, direction: Float, hits: Hits) -> None:
        """Give rays that slipped through a vertex, in place, the hit of the ray beside them."""
        reach = hits.distance * (1.0 - _IN_FRONT)
        slipped = self._hidden_aside(origin, direction, reach)
        if not slipped.any():
            return
        own = origin if origin.shape[1] == 1 else origin[:, slipped]
        beside = self._launch(own, _aside(direction[:, slipped], 1.0), aside=True)
        hits.distance[slipped], hits.target[slipped] = beside.distance, beside.target
        hits.normal[:, slipped], hits.shade[slipped] = beside.normal, beside.shade
        hits.piece[slipped] = beside.piece

    def _hidden_aside(self, start: Float, direction: Float, reach: Float) -> NDArray[np.bool_]:
        """Whether rays turned by 2 µrad to either side both meet something within `reach` m of `start` (3, n or 1)."""
        mi = self._mi
        origin = mi.Point3f(*(mi.Float(c.astype(np.float32)) for c in start))
        hidden = np.ones(direction.shape[1], dtype=bool)
        for side in (1.0, -1.0):
            d = mi.Vector3f(*(mi.Float(c.astype(np.float32)) for c in _aside(direction, side)))
            far = np.minimum(reach, np.finfo(np.float32).max).astype(np.float32)
            ray = mi.Ray3f(origin, d, mi.Float(far), 0.0, mi.Color0f())
            hidden &= np.asarray(self._scene.ray_test(ray, mi.Bool(hidden)).numpy())
        return hidden

    def instances(self, hits: Hits) -> NDArray[np.int32]:
        """Number of the instance of each hit: pieces of all objects, counted through in their order; −1 for nothing."""
        first = np.concatenate([np.cumsum([0, *self.pieces[:-1]]), [0]]).astype(np.int32)
        return np.where(hits.target >= 0, first[hits.target] + hits.piece, np.int32(-1))

    def _piece(self, target: NDArray[np.int32], preliminary: Any) -> NDArray[np.int32]:
        """Pieces of the objects that are hit, by the triangles."""
        piece = np.zeros(target.size, np.int32)
        if self._pieces:
            face = preliminary.prim_index.numpy()
            for number, table in self._pieces.items():
                own = target == number
                piece[own] = table[face[own]]
        return piece

    def _shade(self, origin: Float, direction: Float, distance: Float, target: NDArray[np.int32], uv: Float) -> Float:
        """Values of the textures where rays hit; `uv` (2, n) of meshes, by Mitsuba."""
        shade = np.ones(distance.size)
        for number, image in self._textures.items():
            own = target == number
            if not own.any():
                continue
            shape = self._objects[number].shape
            if isinstance(shape, MeshFile):
                u, v = uv[:, own]
            else:
                start = origin if origin.shape[1] == 1 else origin[:, own]
                point = start + direction[:, own] * distance[own]
                u, v = surface_uv(shape, point)
            shade[own] = bilinear(image, u, v, around=isinstance(shape, Sphere))
        return shade

    def visible(self, point: Float, toward: tuple[float, float, float]) -> NDArray[np.bool_]:
        """Whether the segment from each `point` (3, n) to one position is free (shadow rays)."""
        mi = self._mi
        to = np.asarray(toward, dtype=np.float64)[:, None] - point
        length = np.linalg.norm(to, axis=0)
        # Start a little off the surface: float32 hits lie within a few 1e-7 of the distance from it.
        offset = 2e-5 * np.maximum(length, 1e-3)
        unit = to / length
        start = (point + unit * offset).astype(np.float32)
        ray = mi.Ray3f(
            mi.Point3f(*(mi.Float(c) for c in start)),
            mi.Vector3f(*(mi.Float(c) for c in unit.astype(np.float32))),
            mi.Float((length - 2 * offset).astype(np.float32)),
            0.0,
            mi.Color0f(),
        )
        free = np.asarray(~self._scene.ray_test(ray).numpy())
        if self._vertices and free.any():
            far = (length - 2 * offset)[free]
            free[free] = ~self._hidden_aside(start[:, free], unit[:, free], far)
        return free


def _part(origin: Float, begin: int) -> Float:
    """The origins (3, n or 1) of one launch."""
    return origin if origin.shape[1] == 1 else origin[:, begin : begin + _RAYS_PER_LAUNCH]


def _point(mi: Any, origin: Float) -> Any:
    """Origins (3, n or 1) for Mitsuba; a single one as a constant of the compiled code."""
    if origin.shape[1] == 1:
        return mi.Point3f(*origin[:, 0].tolist())
    return mi.Point3f(*(mi.Float(c) for c in np.ascontiguousarray(origin, dtype=np.float32)))


def _aside(direction: Float, side: float) -> Float:
    """Unit directions (3, n) turned by 2 µrad toward `side` (±1) of a plane that no axis lies in.

    The basis across a ray is that of Duff et al., Journal of Computer Graphics Techniques 6(1), 2017.
    """
    x, y, z = direction
    sign = np.copysign(1.0, z)
    a = -1.0 / (sign + z)
    b = x * y * a
    first = np.stack([1.0 + sign * x * x * a, sign * b, -sign * x])
    second = np.stack([b, sign + y * y * a, -y])
    across = np.cos(1.0) * first + np.sin(1.0) * second
    return np.asarray(direction + side * _ASIDE_RAD * across)


def _mesh(mi: Any, name: str, vertices: Float, faces: NDArray[np.int64], uv: Float | None) -> Any:
    props = mi.Properties()
    props["face_normals"] = True
    mesh = mi.Mesh(
        name, len(vertices), len(faces), has_vertex_normals=False, has_vertex_texcoords=uv is not None, props=props
    )
    params = mi.traverse(mesh)
    if uv is not None:
        params["vertex_texcoords"] = np.ascontiguousarray(uv, dtype=np.float32).ravel()
    params["vertex_positions"] = np.ascontiguousarray(vertices, dtype=np.float32).ravel()
    params["faces"] = np.ascontiguousarray(faces, dtype=np.uint32).ravel()
    params.update()
    mesh.set_id(name)
    return mesh
