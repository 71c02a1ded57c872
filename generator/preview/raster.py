"""The second renderer: pyrender's rasteriser, which shares no code with Mitsuba. It draws previews and judges first hits in
air (depth, visibility). It cannot refract, and needs the extra `preview` and EGL.
"""

from __future__ import annotations

import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...scenes.errors import InputError
from ...scenes.materials import Material
from ...scenes.meshes import shape_mesh
from ...scenes.scene import Scene
from ...scenes.shapes import Sphere

__all__ = ["RasterView", "Raster", "rasterise"]

Float = NDArray[np.float64]

#: Rings of the mesh that stands for a sphere: its facets lie inside by up to radius·(1 − cos(π/2n)), 2e-5 of the radius.
_SPHERE_RINGS = 256
#: OpenGL's axes: x right, y up, z backward; ours: x right, y down, z forward.
_AXES = np.diag([1.0, -1.0, -1.0, 1.0])


@dataclass(frozen=True)
class RasterView:
    """A pinhole view from the origin along z: focal length in pixels; integers are pixel centres, the axis is the middle."""

    rows: int
    cols: int
    focal_px: float


@dataclass(frozen=True)
class Raster:
    """`depth` (row, col) m along z, NaN where nothing is seen; `target` (row, col) index of the object, −1 for none;
    `lit`, `room` (row, col) linear grey value of the point light and of light from above left, up to a factor."""

    depth: Float
    target: NDArray[np.int32]
    lit: Float
    room: Float


def _pyrender() -> Any:
    # pyrender 0.1.45 was written for NumPy 1 and needs this name.
    vars(np).setdefault("infty", np.inf)
    linux = sys.platform.startswith("linux")
    if linux:
        os.environ.setdefault("PYOPENGL_PLATFORM", "egl")
    try:
        if linux:
            import pyglet

            pyglet.options["headless"] = True  # pyrender's window, never opened here, would load X11
        import pyrender
    except ModuleNotFoundError as error:
        raise InputError(
            "Drawing a preview needs pyrender, which is not installed.",
            where="scenes preview",
            value=str(error),
            allowed="the extra 'preview'",
            next_step="pip install 'beambench[preview]'",
        ) from error
    except Exception as error:  # OpenGL raises what its platform raises
        raise _no_opengl(error) from error
    return pyrender


def _no_opengl(error: Exception) -> InputError:
    return InputError(
        "No off-screen OpenGL context can be made here.",
        where="scenes preview",
        value=f"{type(error).__name__}: {error}",
        allowed="EGL, e.g. Mesa's",
        next_step="Debian, Ubuntu: apt-get install libegl1 libgl1 libgl1-mesa-dri",
    )


@contextmanager
def _renderer(view: RasterView) -> Iterator[Any]:
    """An off-screen renderer that samples at pixel centres: multisampling would sample depth at (.376, .874) px."""
    pyrender = _pyrender()
    try:
        import pyrender.renderer as module

        renderer = pyrender.OffscreenRenderer(view.cols, view.rows)
    except Exception as error:  # no device, no context
        raise _no_opengl(error) from error
    original = module.glRenderbufferStorageMultisample
    module.glRenderbufferStorageMultisample = lambda target, samples, *rest: original(target, 0, *rest)
    try:
        yield renderer
    finally:
        module.glRenderbufferStorageMultisample = original
        renderer.delete()


def rasterise(scene: Scene, view: RasterView, light_m: tuple[float, float, float] = (0.0, 0.0, 0.0)) -> Raster:
    """Rasterise the target.

    Main arguments:
        scene: its target.
        view: the camera; `light_m`: position of a white point light (`lit`), which casts no shadow.

    Raises:
        InputError: pyrender or EGL is missing, or an unreadable mesh.
    """
    pyrender = _pyrender()
    meshes = [_mesh(item.shape, f"{scene.name}: target.{item.name}") for item in scene.target]
    ahead = np.concatenate([v[:, 2] for v, _ in meshes])
    ahead = ahead[ahead > 0]
    shape = (view.rows, view.cols)
    if not ahead.size:
        return Raster(np.full(shape, np.nan), np.full(shape, -1, np.int32), np.zeros(shape), np.zeros(shape))
    near, far = 0.5 * float(ahead.min()), 2.0 * float(ahead.max())
    near = max(near, 1e-4 * far)
    world = pyrender.Scene(bg_color=[0.0, 0.0, 0.0, 0.0], ambient_light=[0.0, 0.0, 0.0])
    camera = pyrender.IntrinsicsCamera(
        view.focal_px, view.focal_px, 0.5 * view.cols, 0.5 * view.rows, znear=near, zfar=far
    )
    world.add(camera, pose=np.eye(4))
    nodes = {}
    for number, ((vertices, faces), item) in enumerate(zip(meshes, scene.target, strict=True)):
        mesh = pyrender.Mesh([_primitive(pyrender, vertices, faces, item.material)])
        node = world.add(mesh, pose=np.eye(4))
        nodes[node] = [(number + 1) & 255, (number + 1) >> 8 & 255, 0]
    flags = pyrender.RenderFlags
    with _renderer(view) as renderer:
        seen, depth = renderer.render(world, flags=flags.SEG | flags.SKIP_CULL_FACES, seg_node_map=nodes)
        lamp, pose = _lamp(pyrender, light_m, meshes)
        node = world.add(lamp, pose=pose)
        lit, _ = renderer.render(world, flags=flags.SKIP_CULL_FACES)
        world.remove_node(node)
        sun = pyrender.DirectionalLight(color=np.ones(3), intensity=3.0)
        world.add(sun, pose=_aimed(np.array([0.35, 0.5, 1.0])))
        room, _ = renderer.render(world, flags=flags.SKIP_CULL_FACES)
    number = seen[..., 0].astype(np.int32) + 256 * seen[..., 1].astype(np.int32) - 1
    target = np.where(depth > 0, number, -1).astype(np.int32)
    return Raster(np.where(depth > 0, depth.astype(np.float64), np.nan), target, _linear(lit), _linear(room))


def _mesh(shape: Any, where: str) -> tuple[Float, NDArray[np.int64]]:
    """Triangles of a shape; a sphere as rings of quadrangles."""
    if not isinstance(shape, Sphere):
        return shape_mesh(shape, where)
    n = _SPHERE_RINGS
    polar, around = np.meshgrid(np.pi * np.arange(n + 1) / n, np.pi * np.arange(2 * n) / n, indexing="ij")
    unit = np.stack([np.sin(polar) * np.cos(around), np.sin(polar) * np.sin(around), np.cos(polar)], axis=-1)
    index = np.arange(unit[..., 0].size).reshape(n + 1, 2 * n)
    a, b = index[:-1], np.roll(index, -1, axis=1)[:-1]
    c, d = np.roll(index, -1, axis=1)[1:], index[1:]
    faces = np.concatenate([np.stack(t, axis=-1).reshape(-1, 3) for t in ((a, b, c), (a, c, d))])
    return unit.reshape(-1, 3) * shape.radius_m + np.asarray(shape.center_m), faces


def _primitive(pyrender: Any, vertices: Float, faces: NDArray[np.int64], material: Material) -> Any:
    """Facets with their own normals, all turned toward the camera: open surfaces are two-sided."""
    corner = vertices[faces]
    normal = np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0])
    length = np.linalg.norm(normal, axis=1)
    keep = length > 0
    corner, normal = corner[keep], normal[keep] / length[keep, None]
    away = np.einsum("fi,fi->f", normal, corner.mean(axis=1)) > 0
    normal[away] *= -1.0
    corner[away] = corner[away, ::-1]  # pyrender culls by winding in the pass that numbers the objects
    grey, rough = material.look()
    return pyrender.Primitive(
        positions=(corner.reshape(-1, 3) @ _AXES[:3, :3]).astype(np.float32),
        normals=np.repeat(normal @ _AXES[:3, :3], 3, axis=0).astype(np.float32),
        material=pyrender.MetallicRoughnessMaterial(
            baseColorFactor=[grey, grey, grey, 1.0], metallicFactor=0.0, roughnessFactor=rough, doubleSided=True
        ),
        mode=4,
    )


def _lamp(pyrender: Any, light_m: Any, meshes: list[Any]) -> tuple[Any, Float]:
    """The white light and its pose; its power gives the median vertex full light. It casts no shadow."""
    at = np.asarray(light_m, dtype=np.float64)
    middle = np.median(np.concatenate([v for v, _ in meshes]), axis=0)
    pose = np.eye(4)
    pose[:3, 3] = at @ _AXES[:3, :3]
    return pyrender.PointLight(color=np.ones(3), intensity=2.5 * float(np.sum((middle - at) ** 2))), pose


def _aimed(along: Float) -> Float:
    """Pose, in OpenGL's axes, of a light that shines along `along` (ours, not straight up or down)."""
    back = -(along @ _AXES[:3, :3]) / np.linalg.norm(along)
    side = np.cross([0.0, 1.0, 0.0], back)
    side /= np.linalg.norm(side)
    pose = np.eye(4)
    pose[:3, :3] = np.stack([side, np.cross(back, side), back], axis=1)
    return pose


def _linear(picture: NDArray[np.uint8]) -> Float:
    """pyrender encodes with a plain exponent of 2.2."""
    return (picture[..., 1].astype(np.float64) / 255.0) ** 2.2
