"""A picture of a scene as a person beside the camera would see it: room light, and the laser in its own colour.

Shapes and shading come from the rasteriser; the beam's profile, its shadows and the water's e^{−c(r₁+r₂)} are laid over its
white light by the depth of every pixel. Colours are those of the spectra (colour-science). It is a picture, not data:
nothing of the detector, of refraction or of scattered light is in it, and a ranger's narrow beam is drawn wider.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ...optics import colorimetry
from ...optics.illumination import beam_axis
from ...scenes.meshes import shape_mesh
from ...scenes.rigs import rig_kind
from ...scenes.rigs.kind import RigView
from ...scenes.scene import Scene
from ...scenes.shapes import Sphere
from ..ranger.footprint import shot_angles
from ..rays.lamp import RoundBeam
from ..rays.trace import Tracer
from .raster import Raster, RasterView, rasterise

__all__ = ["Preview", "preview", "preview_view"]

Float = NDArray[np.float64]

#: Room light beside the laser's brightest spot, and how the picture is exposed.
_ROOM_SHARE = 0.15
_BRIGHTEST = 0.95
#: A ranger's beam is drawn at least this wide (half angle, pixels), and at most so many of its shots.
_SPOT_PX = 4.0
_MOST_SPOTS = 64
#: Pixels are drawn this many times finer along both axes, and averaged as light.
_FINER = 2
_LONGER_SIDE = 640
_WIDEST_RAD = 0.9
_BACKGROUND = 0.012


@dataclass(frozen=True)
class Preview:
    """`picture` (row, col, 3) 8-bit sRGB; `seen`: share of pixels that show the target; `laser_rgb`: the laser's colour as
    drawn, linear sRGB, and whether the eye sees that wavelength (`visible`; if not, it is drawn in grey)."""

    picture: NDArray[np.uint8]
    seen: float
    laser_rgb: tuple[float, float, float]
    visible: bool


def preview_view(scene: Scene, longer_side: int = _LONGER_SIDE) -> RasterView:
    """The view: a camera's own field, at most `longer_side` pixels long; without a camera, one that holds scan and target."""
    rig = _rig_view(scene)
    if rig.camera is not None:
        camera = rig.camera
        scale = longer_side / max(camera.rows, camera.cols)
        rows, cols = (max(round(n * scale), 1) for n in (camera.rows, camera.cols))
        return RasterView(rows, cols, camera.focal_length_m / camera.pixel_pitch_m * scale)
    half = min(max(1.3 * rig.scan_half_angle_rad, 1.1 * _extent_rad(scene), 0.02), _WIDEST_RAD)
    rows = max(round(0.75 * longer_side), 1)
    return RasterView(rows, longer_side, 0.5 * longer_side / float(np.tan(half)))


def _rig_view(scene: Scene) -> RigView:
    return rig_kind(scene.modality).view(scene.rig)


def _extent_rad(scene: Scene) -> float:
    """Largest angle from the axis at which the target's middle 90 % of vertices lie."""
    widest = 0.0
    for item in scene.target:
        if isinstance(item.shape, Sphere):
            x, y, z = item.shape.center_m
            widest = max(widest, float(np.arctan2(np.hypot(x, y) + item.shape.radius_m, max(z, 1e-6))))
            continue
        vertices, _ = shape_mesh(item.shape, f"{scene.name}: target.{item.name}")
        angle = np.arctan2(np.abs(vertices[:, 0]), np.maximum(vertices[:, 2], 1e-6))
        widest = max(widest, float(np.percentile(angle, 90)))
    return widest


def preview(scene: Scene, longer_side: int = _LONGER_SIDE) -> Preview:
    """Draw the scene.

    Main arguments:
        scene: any modality.
        longer_side: pixels of the picture's longer side.

    Raises:
        InputError: pyrender (extra `preview`) or EGL is missing, or an unreadable mesh.
    """
    view = preview_view(scene, longer_side)
    fine = RasterView(view.rows * _FINER, view.cols * _FINER, view.focal_px * _FINER)
    light = rig_kind(scene.modality).places(scene.rig).get("laser", (0.0, 0.0, 0.0))
    raster = rasterise(scene, fine, light)
    seen = raster.target >= 0
    laser, visible = _laser_colour(scene)
    shade = _shade(scene, fine, seen)
    beam = raster.lit * shade * _beam(scene, fine, raster, np.asarray(light))
    if float(beam.max()) > 0:
        beam /= float(np.percentile(beam[beam > 0.1 * beam.max()], 99))
    room = raster.room * shade / max(float(raster.room.max()), 1e-9)
    linear = np.minimum(beam, 2.0)[..., None] * laser + _ROOM_SHARE * room[..., None] * _room_colour(scene)
    bright = _ROOM_SHARE + (1.0 if float(beam.max()) > 0 else 0.0)
    linear = np.where(seen[..., None], linear * (_BRIGHTEST / bright), _BACKGROUND)
    linear = np.minimum(linear, 1.0).reshape(view.rows, _FINER, view.cols, _FINER, 3).mean(axis=(1, 3))
    return Preview(colorimetry.encode_srgb(linear), float(seen.mean()), tuple(laser.tolist()), visible)


def _shade(scene: Scene, view: RasterView, seen: NDArray[np.bool_]) -> Float:
    """Values of the textures in every pixel, 1 where there is none."""
    shade = np.ones(seen.shape)
    if any(item.texture for item in scene.target):
        row, col = np.nonzero(seen)
        x, y = (col - 0.5 * (view.cols - 1)) / view.focal_px, (row - 0.5 * (view.rows - 1)) / view.focal_px
        direction = np.stack([x, y, np.ones(len(x))]) / np.sqrt(x * x + y * y + 1.0)
        shade[seen] = Tracer(scene).trace((0.0, 0.0, 0.0), direction).shade
    return shade


def _laser_colour(scene: Scene) -> tuple[Float, bool]:
    """Linear sRGB of the laser's wavelength, the nearest that a screen has; grey for what the eye cannot see."""
    try:
        return colorimetry.shown_colour(colorimetry.linear_srgb_of_line(scene.rig.wavelength_m)), True
    except ValueError:
        return np.full(3, 0.7), False


def _room_colour(scene: Scene) -> Float:
    """White, or the colour of the ambient light where its spectrum is given."""
    ambient = getattr(scene.rig, "ambient", None)
    if ambient is None:
        return np.ones(3)
    try:
        wave, power = ambient.at_the_target()
        return colorimetry.shown_colour(colorimetry.linear_srgb_of_spectrum(wave, power))
    except ValueError:
        return np.ones(3)


def _beam(scene: Scene, view: RasterView, raster: Raster, lamp: Float) -> Float:
    """I(θ)/I(0) · e^{−c(r₁ + r₂)} of every pixel, 0 in shadow; the rasteriser's light holds 1/r₁² already."""
    seen = raster.target >= 0
    value = np.zeros(seen.shape)
    if not seen.any():
        return value
    row, col = np.nonzero(seen)
    depth = raster.depth[seen]
    x, y = (col - 0.5 * (view.cols - 1)) / view.focal_px, (row - 0.5 * (view.rows - 1)) / view.focal_px
    point = np.stack([x * depth, y * depth, depth])
    away = point - lamp[:, None]
    r1 = np.linalg.norm(away, axis=0)
    light = _profile(scene, away / r1, view)
    light *= np.exp(-scene.medium.attenuation_per_m * (r1 + np.linalg.norm(point, axis=0)))
    if np.any(lamp):
        # A little toward the camera: the rasteriser's depth lies up to a few 1e-6 behind the surface.
        light *= Tracer(scene).visible(point * (1.0 - 1e-5), tuple(lamp.tolist()))
    value[seen] = light
    return value


def _profile(scene: Scene, direction: Float, view: RasterView) -> Float:
    """I(θ)/I(0) along unit directions (3, n); where shots scan, of the brightest of them."""
    rig = _rig_view(scene)
    spec = rig.beam
    if spec is None:
        return np.zeros(direction.shape[1])
    if rig.camera is not None:
        lamp = RoundBeam(spec)
        return np.asarray(lamp.intensity(direction) / max(float(lamp.intensity(lamp.axis[:, None])[0]), 1e-300))
    narrow = max(spec.half_angle_rad, _SPOT_PX / view.focal_px)
    axis = beam_axis(spec.offset_rad)
    best = np.zeros(direction.shape[1])
    for angle in shot_angles(min(rig.shots, _MOST_SPOTS), rig.scan_half_angle_rad):
        c, s = np.cos(angle), np.sin(angle)
        turned = np.array([c * axis[0] + s * axis[2], axis[1], c * axis[2] - s * axis[0]])
        off = np.arccos(np.clip(turned @ direction, -1.0, 1.0))
        best = np.maximum(best, np.exp(-2.0 * (off / narrow) ** 2))
    return best
