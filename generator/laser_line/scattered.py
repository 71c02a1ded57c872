"""Light that the water scatters: the curtain of the sheet itself, and the halo of the line.

A camera's ray meets a thin sheet once, at X, so that light scattered once there needs no integral over depth:

    L = b β̃(ψ) · P p(φ)/r · e^{−c(r + s)}/sinθ,

r from the laser to X, s from X to the camera, ψ the angle turned through, θ between ray and sheet. It is seen where X lies before
what the ray hits, and where nothing stands between laser and X.

The halo is the line's own light, displaced by small angles on its way out and back: the image convolved with the two-way point
spread of `optics.water.halo` after b(r₁ + r₂) scattering lengths, as for surfaces that stand as far away as the line does.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from ...optics.sheet import meeting
from ...optics.water.phase_forms import PhaseFunction, phase_density
from ...scenes.medium_index import phase_index
from ...scenes.rigs.laser_line_geometry import line_camera
from ..water.image import image_halo
from .setting import Pose, Setting

__all__ = ["Scattered", "curtain", "halo", "widened"]

Float = NDArray[np.float64]

#: Parts along the row of a pixel in which the curtain begins or ends.
_PARTS = 8
#: Margin of the wider image as a share of the image's longer side; light from further out is left out.
_MARGIN = 0.25


@dataclass(frozen=True, eq=False)
class Scattered:
    """Photoelectrons (rows, cols) of the curtain and of the halo."""

    curtain: Float
    halo: Float


def widened(setting: Setting) -> tuple[Setting, int]:
    """The same setting with a margin of pixels all around, whose line throws light into the image; and that margin."""
    camera = setting.rig.camera
    margin = int(np.ceil(_MARGIN * max(camera.rows, camera.cols)))
    wide = camera.model_copy(update={"rows": camera.rows + 2 * margin, "cols": camera.cols + 2 * margin})
    rig = setting.rig.model_copy(update={"camera": wide})
    index = phase_index(setting.scene.medium, rig.wavelength_m)
    return replace(setting, rig=rig, camera=line_camera(rig, index)), margin


def curtain(setting: Setting, pose: Pose, phase: PhaseFunction, *, every: int = 1) -> Float:
    """Photoelectrons (rows, cols) of light of the sheet that was scattered once, before the target.

    The curtain is smooth but where it begins or ends: there the pixels are cut into parts. `every`: only each n-th row is computed.
    """
    rows, cols = np.arange(0, setting.rig.camera.rows, every), setting.rig.camera.cols
    row, col = (
        v.ravel() for v in np.meshgrid(rows.astype(np.float64), np.arange(cols, dtype=np.float64), indexing="ij")
    )
    light = _veil(setting, pose, phase, row, col).reshape(rows.size, cols)
    there = light > 0
    edge = np.zeros(there.shape, bool)
    change = there[:, 1:] != there[:, :-1]
    edge[:, 1:] |= change
    edge[:, :-1] |= change
    at_row, at_col = np.nonzero(edge)
    if at_row.size:
        part = (np.arange(_PARTS) + 0.5) / _PARTS - 0.5
        cut_row, cut_col = np.repeat(rows[at_row].astype(np.float64), _PARTS), (at_col[:, None] + part).ravel()
        light[at_row, at_col] = _veil(setting, pose, phase, cut_row, cut_col).reshape(-1, _PARTS).mean(axis=1)
    return light


def _veil(setting: Setting, pose: Pose, phase: PhaseFunction, row: Float, col: Float) -> Float:
    """Photoelectrons per pixel of the curtain at pixel coordinates (n)."""
    origin, direction = setting.camera.rays(row, col)
    sheet = setting.sheet
    point = meeting(origin, direction, sheet.normal, sheet.source)
    s = (direction * (point - origin)).sum(axis=0)
    sine = np.abs(np.tensordot(sheet.normal, direction, axes=1))
    r = sheet.range(point)
    with np.errstate(divide="ignore", invalid="ignore"):
        beam = (point - sheet.source[:, None]) / r
        density = sheet.fan_density(sheet.fan_angle(point))
        lit = np.isfinite(s) & (s > 0) & (r > 0) & (density > 0) & (sine > 0)
    lit[lit] &= _clear(setting, pose, row[lit], col[lit], point[:, lit], s[lit])
    light = np.zeros(lit.shape)
    turned = np.arccos(np.clip(-(beam[:, lit] * direction[:, lit]).sum(axis=0), -1.0, 1.0))
    response = setting.scene.medium.scattering_per_m * phase_density(phase, turned) / sine[lit]
    light[lit] = setting.electrons(row[lit], col[lit], density[lit] * r[lit], r[lit], s[lit], response)
    return light


def _clear(setting: Setting, pose: Pose, row: Float, col: Float, point: Float, s: Float) -> NDArray[np.bool_]:
    """Whether points of the sheet (3, n) lie before the target as the camera sees it, with the laser in sight."""
    if not row.size:
        return np.zeros(0, bool)
    seen = setting.see(row, col, pose, lit=False)
    origin, direction = setting.camera.rays(row, col)
    distance = np.where(seen.hit, (direction * (seen.point - origin)).sum(axis=0), np.inf)
    clear = s < distance
    if clear.any():
        place = pose.of_point(setting.sheet.source[:, None])[:, 0]
        to: tuple[float, float, float] = (float(place[0]), float(place[1]), float(place[2]))
        clear[clear] = setting.tracer.visible(pose.of_point(point[:, clear]), to)
    return np.asarray(clear)


def halo(setting: Setting, wide: Float, margin: int, path_m: float, phase: PhaseFunction) -> Float:
    """Photoelectrons (rows, cols) that are scattered forward out of the line's image `wide` (rows + 2 margin, …).

    Main arguments:
        setting: of the narrow image. path_m: r₁ + r₂ of the line.
    """
    camera = setting.rig.camera
    # Behind a port a pixel is narrower in the water, as that of a longer lens.
    seen = camera.model_copy(update={"focal_length_m": camera.focal_length_m * setting.camera.narrowing})
    kernels = image_halo(seen, margin, phase, setting.scene.medium.scattering_per_m, (path_m, path_m))
    image = wide.astype(np.float32)
    spread = kernels.spread(image, kernels.weights(np.full(image.shape, path_m)))
    m, (rows, cols) = margin, (camera.rows, camera.cols)
    return np.asarray(spread + float(kernels.own_share(np.array(path_m))) * wide[m : m + rows, m : m + cols])
