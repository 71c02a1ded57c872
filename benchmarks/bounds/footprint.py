"""How far the footprint of a ranger spreads its echo in time: whether the bound of a point's echo is that of the shot.

The bounds of rangers take the echo of a point at the true range. A wide beam on a tilted or stepped target returns a mixture
of echoes, which is broader than the response, and its bound is larger. With σ_f the standard deviation of the arrival times
and σ_R that of the response, the information about a Gaussian echo falls by 1/(1 + σ_f²/σ_R²): at the share allowed here,
σ_f = σ_R/10, the bound is .5 % too small.

The rays are cast here in NumPy (Möller and Trumbore, J. Graphics Tools 2:21, 1997), not by the generator.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from ...optics.constants import C_M_PER_S
from ...optics.illumination import beam_axis, beam_intensity, off_axis_angle
from ...scenes.medium_index import group_index
from ...scenes.meshes import shape_mesh
from ...scenes.rigs.parts import Illumination
from ...scenes.scene import Scene
from ...scenes.shapes import Sphere

__all__ = ["LARGEST_SHARE", "first_hits", "footprint_std_s", "is_wide"]

Float = npt.NDArray[np.float64]

#: σ_f over the width of the response from which a bound is called "quasi".
LARGEST_SHARE = 0.1
_RAYS = 64
#: Shots at most, evenly chosen, and pairs of rays and triangles at most: beyond, no statement is made.
_SHOTS, _PAIRS, _AT_ONCE = 32, 2e8, 2e6


def footprint_std_s(
    scene: Scene, illumination: Illumination, wavelength_m: float, field_rad: float, angle_rad: Float
) -> Float:
    """Standard deviation of the arrival times 2 n_g r/c over the beam within the field of view, s, of each shot.

    Main arguments:
        illumination: the beam. field_rad: half angle of the detector's field about the lens's axis.
        angle_rad: of the shots in the x-z plane (shot). At most 32 of them are cast, evenly chosen.
    Rays count by the beam's intensity; what reflects more or less is neglected. NaN where a shot meets nothing; inf where the
    target has too many triangles to be cast here. Raises InputError for an unreadable mesh.
    """
    chosen = np.unique(np.asarray(angle_rad, np.float64))
    chosen = chosen[np.unique(np.linspace(0, chosen.size - 1, min(chosen.size, _SHOTS)).round().astype(int))]
    local, weight = _rays(illumination, field_rad)
    cos, sin = np.cos(chosen)[:, None], np.sin(chosen)[:, None]
    direction = np.stack(
        [cos * local[0] + sin * local[2], np.broadcast_to(local[1], (chosen.size, _RAYS)), cos * local[2] - sin * local[0]],
        axis=-1,
    )  # fmt: skip
    distance = first_hits(scene, direction.reshape(-1, 3)).reshape(chosen.size, _RAYS)
    if np.isnan(distance).any():
        return np.full(chosen.size, np.inf)
    met = np.where(np.isfinite(distance), weight, 0.0)
    far = np.where(np.isfinite(distance), distance, 0.0)
    with np.errstate(invalid="ignore"):
        mean = (met * far).sum(axis=1) / met.sum(axis=1)
        spread = np.sqrt((met * (far - mean[:, None]) ** 2).sum(axis=1) / met.sum(axis=1))
    return np.asarray(2.0 * group_index(scene.medium, wavelength_m) / C_M_PER_S * spread)


def is_wide(spread_s: Float, response_s: float) -> bool:
    """Whether any shot's footprint spreads its echo by more than LARGEST_SHARE of the response's standard deviation."""
    return bool(np.nanmax(np.append(spread_s, 0.0)) > LARGEST_SHARE * response_s)


def _rays(illumination: Illumination, field_rad: float) -> tuple[Float, Float]:
    """(directions (3, ray) about z, weights): a lattice even in solid angle over the beam or, if narrower, the field."""
    reach = illumination.half_angle_rad * (2.0 if illumination.profile == "gaussian" else 1.0)
    axis = beam_axis(illumination.offset_rad)
    about = axis if reach < field_rad else np.array([0.0, 0.0, 1.0])
    limit = min(reach, field_rad)
    share, turn = (np.arange(_RAYS) + 0.5) / _RAYS, np.pi * (3.0 - np.sqrt(5.0)) * np.arange(_RAYS)
    theta = 2.0 * np.arcsin(np.sin(0.5 * limit) * np.sqrt(share))
    side = np.cross(about, [0.0, 1.0, 0.0])
    side /= np.linalg.norm(side)
    up = np.cross(side, about)
    local = (
        np.cos(theta)[:, None] * about
        + (np.sin(theta) * np.cos(turn))[:, None] * side
        + (np.sin(theta) * np.sin(turn))[:, None] * up
    )
    weight = beam_intensity(
        illumination.profile, off_axis_angle(local, axis), illumination.half_angle_rad,
        getattr(illumination, "radial_value", None),
    )  # fmt: skip
    return local.T, np.where(off_axis_angle(local, np.array([0.0, 0.0, 1.0])) <= field_rad * (1.0 + 1e-9), weight, 0.0)


def first_hits(scene: Scene, direction: Float) -> Float:
    """Distance (n) to the first surface along unit rays (n, 3) from the origin, m: inf for none, NaN where it was not cast."""
    best = np.full(len(direction), np.inf)
    for item in scene.target:
        if isinstance(item.shape, Sphere):
            best = np.minimum(best, _sphere(np.asarray(item.shape.center_m), item.shape.radius_m, direction))
            continue
        vertices, faces = shape_mesh(item.shape, item.name)
        if len(direction) * len(faces) > _PAIRS:
            return np.full(len(direction), np.nan)
        corners = np.asarray(vertices, np.float64)[np.asarray(faces)]
        step = max(1, int(_AT_ONCE // len(faces)))
        for first in range(0, len(direction), step):
            part = slice(first, first + step)
            best[part] = np.minimum(best[part], _triangles(corners, direction[part]))
    return best


def _sphere(center: Float, radius: float, direction: Float) -> Float:
    along = direction @ center
    square = along**2 - (center @ center - radius**2)
    root = np.sqrt(np.maximum(square, 0.0))
    near = np.where(along - root > 0.0, along - root, along + root)
    return np.where((square >= 0.0) & (near > 0.0), near, np.inf)


def _triangles(corners: Float, direction: Float) -> Float:
    """Nearest hit of rays (n, 3) on triangles (m, 3, 3); edges belong to both of their triangles."""
    a, e1, e2 = corners[:, 0], corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    across = np.cross(direction[:, None], e2[None])
    scale = np.einsum("nmk,mk->nm", across, e1)
    turned = np.cross(-a, e1)
    with np.errstate(divide="ignore", invalid="ignore"):
        u = np.einsum("nmk,mk->nm", across, -a) / scale
        v = (direction @ turned.T) / scale
        t = np.einsum("mk,mk->m", turned, e2) / scale
    inside = (u >= -1e-9) & (v >= -1e-9) & (u + v <= 1.0 + 1e-9) & (t > 0.0)
    return np.asarray(np.where(inside, t, np.inf).min(axis=1))
