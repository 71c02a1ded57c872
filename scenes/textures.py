"""Textured albedo: the spec, its file, and its values on the surfaces of shapes."""

from __future__ import annotations

from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, field_validator

from ..optics.rotation import rotation_matrix
from .base import Spec
from .errors import InputError
from .meshes import load_grid, read_array, resolve_file
from .readers.png import png_damage
from .shapes import HeightGrid, PowerLawRelief, Rectangle, Sphere

__all__ = ["Texture", "bilinear", "load_texture", "surface_uv"]

Float = NDArray[np.float64]

_MAX_TEXELS = 1 << 26
_SUFFIXES = (".npz", ".npy", ".png")


class Texture(Spec):
    """Relative diffuse albedo T (0 … 1) over a surface: the material's diffuse part is multiplied by it.

    `file`: .npz with one 2-D array or .npy, or a grey .png; beside the scene file, or "library:NAME". `encoding`: of T in the
    file: "linear", or "srgb" (IEC 61966-2-1; PNG only). Row 0 is the top. It spans a rectangle or relief as seen by an
    untilted camera; goes once around a sphere, its middle toward the camera, top at −y; follows the uv of a mesh. Bilinear
    between texel centres; beyond the border it goes on as there, around a sphere it closes.
    """

    file: str = Field(min_length=1)
    encoding: Literal["linear", "srgb"]

    @field_validator("file")
    @classmethod
    def _known_suffix(cls, value: str) -> str:
        if not value.lower().endswith(_SUFFIXES):
            raise ValueError(f"a texture is one of {', '.join(_SUFFIXES)}")
        return value


def load_texture(texture: Texture, where: str) -> Float:
    """T of every texel (row, col).

    Raises:
        InputError: no such file, damaged, of another form, or values outside 0 … 1.
    """
    if texture.file.lower().endswith(".png"):
        value = _read_png(resolve_file(texture.file, where), where)
        if texture.encoding == "srgb":
            value = np.where(value <= 0.04045, value / 12.92, ((value + 0.055) / 1.055) ** 2.4)
    else:
        if texture.encoding == "srgb":
            raise InputError(
                "The encoding of an array should be linear.",
                where=f"{where}.encoding",
                value="srgb",
                allowed='"linear"',
            )
        value = read_array(texture.file, where)
    if value.size > _MAX_TEXELS:
        raise InputError("The texture is too large.", where=where, value=value.shape, allowed=f"{_MAX_TEXELS} texels")
    if not np.isfinite(value).all() or value.min() < 0.0 or value.max() > 1.0:
        raise InputError(
            "A texture should hold relative albedo.", where=where, value=texture.file, allowed="finite values, 0 … 1"
        )
    return value


def _read_png(path: Path, where: str) -> Float:
    import OpenImageIO as oiio

    if reason := png_damage(path.read_bytes()):
        raise InputError(
            "The picture cannot be read.", where=where, value=f"{path.name}: {reason}", allowed="a whole PNG file",
            next_step="copy or write the picture anew",
        )  # fmt: skip
    image = oiio.ImageBuf(str(path))
    spec = image.spec()
    if image.has_error or spec.width * spec.height == 0:
        raise InputError("The picture cannot be read.", where=where, value=f"{path.name}: {image.geterror()}")
    if spec.nchannels != 1:
        raise InputError(
            "A texture should have one channel, since the laser has one wavelength.", where=where,
            value=f"{path.name}: {spec.nchannels} channels", allowed="a grey PNG, 8 or 16 bit",
        )  # fmt: skip
    if spec.width * spec.height > _MAX_TEXELS:
        raise InputError("The texture is too large.", where=where, value=f"{spec.width} × {spec.height}")
    pixels: Any = image.get_pixels(oiio.FLOAT)
    if pixels is None:
        raise InputError("The picture cannot be read.", where=where, value=f"{path.name}: {image.geterror()}")
    return np.asarray(pixels, dtype=np.float64)[:, :, 0]


def bilinear(image: Float, u: Float, v: Float, *, around: bool = False) -> Float:
    """T at u (left to right) and v (top to bottom), each 0 … 1 over the image; `around`: u closes on itself."""
    rows, cols = image.shape
    x, y = np.asarray(u) * cols - 0.5, np.clip(np.asarray(v) * rows - 0.5, 0.0, rows - 1.0)
    if not around:
        x = np.clip(x, 0.0, cols - 1.0)
    left, top = np.floor(x).astype(np.int64), np.floor(y).astype(np.int64)
    fx, fy = x - left, y - top
    below = np.minimum(top + 1, rows - 1)
    if around:
        left, right = left % cols, (left + 1) % cols
    else:
        right = np.minimum(left + 1, cols - 1)
    upper = image[top, left] * (1 - fx) + image[top, right] * fx
    lower = image[below, left] * (1 - fx) + image[below, right] * fx
    return np.asarray(upper * (1 - fy) + lower * fy)


def surface_uv(shape: Any, point: Float) -> tuple[Float, Float]:
    """(u, v) of points (3, n) on a rectangle, relief or sphere. Raises TypeError for other shapes (meshes bring theirs)."""
    offset = point - np.asarray(shape.center_m)[:, None]
    if isinstance(shape, Sphere):
        u = 0.5 + np.arctan2(offset[0], -offset[2]) / (2.0 * np.pi)
        return u, np.arccos(np.clip(-offset[1] / np.linalg.norm(offset, axis=0), -1.0, 1.0)) / np.pi
    if not isinstance(shape, Rectangle | HeightGrid | PowerLawRelief):
        raise TypeError(f"no uv for {type(shape).__name__}")
    local = rotation_matrix((shape.tilt_x_deg, shape.tilt_y_deg, 0.0)).T @ offset
    height = shape.height_m if isinstance(shape, Rectangle | PowerLawRelief) else 0.0
    if isinstance(shape, HeightGrid):
        rows, cols = load_grid(shape.file, "target").shape
        height = shape.width_m * (rows - 1) / (cols - 1)
    return local[0] / shape.width_m + 0.5, local[1] / height + 0.5
