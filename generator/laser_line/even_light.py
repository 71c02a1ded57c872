"""Even light on the target: what an overcast sky, or lamps all around, show of its albedo and texture.

A surface under the same radiance from everywhere on its side has the radiance ρT of a white one, ρ its albedo and T its texture.
A pixel collects N ρT e^{−cr} V photoelectrons per second, with N those of a white surface without water and V the vignetting.
Surfaces do not shade each other; of a gloss, the albedo square to the surface is taken.

Texture is read at points of a grid within the pixel, spread by the lens along rows and columns, and averaged over the pixel: the
grid is as fine as the lens's spread, whose Gaussian then leaves no sampling error (e^{−2π²} of the light).
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter, maximum_filter, minimum_filter

from .setting import Pose, Setting

__all__ = ["even_light"]

Float = NDArray[np.float64]

#: Least and most points of a pixel along each axis.
_LEAST, _MOST = 4, 16
#: Relative step between neighbouring pixels above which their insides are read.
_STEP = 1e-3
#: Rows of the image that are held at once.
_STRIP = 64
#: Reach of the lens's spread, standard deviations.
_REACH = 5.0


def even_light(setting: Setting, pose: Pose) -> Float:
    """Photoelectrons (rows, cols) of one exposure; zeros for a rig without even light."""
    rig = setting.rig
    rows, cols, blur = rig.camera.rows, rig.camera.cols, rig.lens_sigma_px
    rate = rig.even_light_e_per_s
    if not rate:
        return np.zeros((rows, cols))
    parts = int(np.clip(np.ceil(1.0 / blur), _LEAST, _MOST)) if blur > 0 else _MOST // 2
    margin = int(np.ceil(_REACH * blur)) + 1
    row, col = np.arange(-margin, rows + margin), np.arange(-margin, cols + margin)
    plain = _light(setting, pose, *np.meshgrid(row.astype(np.float64), col.astype(np.float64), indexing="ij"))
    uneven = maximum_filter(plain, 3) - minimum_filter(plain, 3) > _STEP * max(float(plain.max()), 1e-300)
    image = np.empty((rows, cols))
    for first in range(0, rows, _STRIP):
        many = min(_STRIP, rows - first)
        own = slice(first, first + many + 2 * margin)
        fine = _within(setting, pose, plain[own], uneven[own], row[own], col, parts)
        spread = gaussian_filter(fine, blur * parts, truncate=_REACH) if blur > 0 else fine
        kept = spread[margin * parts : (margin + many) * parts, margin * parts : (margin + cols) * parts]
        image[first : first + many] = kept.reshape(many, parts, cols, parts).mean(axis=(1, 3))
    return np.asarray(rate * rig.detector.exposure_s * image)


def _within(
    setting: Setting, pose: Pose, plain: Float, uneven: NDArray[np.bool_], row: NDArray[np.intp], col: NDArray[np.intp],
    parts: int,
) -> Float:  # fmt: skip
    """Light at parts × parts points of every pixel; that of the middle where a pixel and those around it are even."""
    fine = np.repeat(np.repeat(plain, parts, axis=0), parts, axis=1)
    i, j = np.nonzero(uneven)
    if i.size:
        inside = (np.arange(parts) + 0.5) / parts - 0.5
        at_row = np.broadcast_to(row[i][:, None, None] + inside[:, None], (i.size, parts, parts))
        at_col = np.broadcast_to(col[j][:, None, None] + inside, (i.size, parts, parts))
        step = np.arange(parts)
        fine[i[:, None, None] * parts + step[:, None], j[:, None, None] * parts + step] = _light(
            setting, pose, at_row, at_col
        )
    return fine


def _light(setting: Setting, pose: Pose, row: Float, col: Float) -> Float:
    """ρT e^{−cr} V at pixel coordinates (…); 0 where nothing is hit."""
    scene, shape = setting.scene, row.shape
    row, col = row.ravel(), col.ravel()
    origin, direction = setting.camera.rays(row, col)
    leaves = np.isfinite(direction).all(axis=0) & np.isfinite(origin).all(axis=0)
    origin, direction = np.where(leaves, origin, 0.0), np.where(leaves, direction, [[0.0], [0.0], [-1.0]])
    hits = setting.tracer.trace(pose.of_point(origin), pose.turn @ direction)
    light = np.zeros(row.size)
    for number, item in enumerate(scene.target):
        own = leaves & (hits.target == number)
        whole = item.material.albedo_at_normal()
        gloss = item.material.without_diffuse().albedo_at_normal() if item.texture is not None else 0.0
        shade = hits.shade[own] if item.texture is not None else 1.0
        light[own] = (gloss + shade * (whole - gloss)) * np.exp(-scene.medium.attenuation_per_m * hits.distance[own])
    if setting.rig.camera.vignetting == "cos4":
        x, y = setting.camera.slopes(row, col)
        light *= np.where(leaves, 1.0 / (1.0 + x * x + y * y) ** 2, 0.0)
    return light.reshape(shape)
