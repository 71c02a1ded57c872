"""The beam's footprint: deterministic rays of a coaxial ranger, each with its share of the echo and its time.

A detector of diameter D in the focus f of a lens sees a cone of half angle D/2f; the laser lights its own. Rays fill the
narrower of the two evenly in solid angle (a sunflower lattice: equal weights, no random number), so that ray j of solid
angle ΔΩ contributes

    a_j = E · I(θ_j) · f cosθᵢ · e^{−2 c r_j}/r_j² · A_aperture · ΔΩ · T · QE · λ/(hc),      τ_j = 2 n_g r_j/c.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..optics import ladar
from ..optics.brdf_angles import Angles, angles
from ..optics.constants import C_M_PER_S
from ..scenes.declare import group_index
from ..scenes.rig import Illumination
from ..scenes.rig_waveform import Receiver
from ..scenes.scene import Scene
from .echo import beam_intensity, response
from .trace import Tracer

__all__ = ["Footprint", "footprint", "rays_for", "shot_angles", "sunflower_cone"]

Float = NDArray[np.float64]

#: A Gaussian beam is followed to 2.6 of its 1/e² half angles: 1.3e-6 of its energy lies beyond.
_GAUSSIAN_REACH = 2.6
_GOLDEN_ANGLE = float(np.pi * (3.0 - np.sqrt(5.0)))


@dataclass(frozen=True)
class Footprint:
    """Rays of all shots: `amplitude` photoelectrons (per joule emitted) and `tau` s, (shot, ray); what the axis meets:
    `axis_range` m (NaN: nothing), (shot)."""

    amplitude: Float
    tau: Float
    axis_range: Float


def rays_for(rtol: float) -> int:
    """Rays of a footprint for a relative error `rtol` of the echo: the lattice errs by about 1/n on smooth footprints."""
    return int(np.clip(np.ceil(2.0 / rtol), 256, 1 << 16))


def shot_angles(shots: int, scan_half_angle_rad: float) -> Float:
    """Angles of the shots in the x-z plane, rad: even from −a to +a; 0 for a staring rig or a single shot."""
    if scan_half_angle_rad == 0.0 or shots == 1:
        return np.zeros(shots)
    return np.linspace(-scan_half_angle_rad, scan_half_angle_rad, shots)


def sunflower_cone(half_angle_rad: float, rays: int) -> tuple[Float, float]:
    """(unit directions (3, n) that fill a cone about z evenly, solid angle of each in sr)."""
    share = (np.arange(rays) + 0.5) / rays
    # 1 − cosθ in the form that keeps its digits at small angles.
    sag = 2.0 * np.sin(0.5 * half_angle_rad) ** 2 * share
    sine = np.sqrt(sag * (2.0 - sag))
    azimuth = _GOLDEN_ANGLE * np.arange(rays)
    direction = np.stack([sine * np.cos(azimuth), sine * np.sin(azimuth), 1.0 - sag])
    return direction, 4.0 * np.pi * float(np.sin(0.5 * half_angle_rad)) ** 2 / rays


def footprint(
    scene: Scene,
    tracer: Tracer,
    *,
    wavelength_m: float,
    illumination: Illumination,
    receiver: Receiver,
    detector_diameter_m: float,
    quantum_efficiency: float,
    angle_rad: Float,
    rays: int,
) -> Footprint:
    """Trace the rays of shots at `angle_rad` (shot)."""
    field = float(np.arctan2(0.5 * detector_diameter_m, receiver.focal_length_m))
    local, solid_angle = _cone(illumination, field, rays)
    intensity = beam_intensity(illumination, local)
    intensity = np.where(np.arctan2(np.hypot(local[0], local[1]), local[2]) <= field * (1 + 1e-12), intensity, 0.0)
    axes = _turned(np.array([[0.0], [0.0], [1.0]]), angle_rad)[:, :, 0]
    axis_hits = tracer.trace((0.0, 0.0, 0.0), axes)
    direction = _turned(local, angle_rad).reshape(3, -1)
    hits = tracer.trace((0.0, 0.0, 0.0), direction)
    hit = hits.target >= 0
    distance = np.where(hit, hits.distance, 1.0)
    reflected = np.zeros_like(distance)
    a = angles(hits.normal.T, -direction.T, -direction.T)
    for number, item in enumerate(scene.target):
        mine = hit & (hits.target == number)
        if mine.any():
            part = Angles(a.cos_i[mine], a.cos_o[mine], a.cos_h[mine], a.cos_d[mine], a.cos_r[mine])
            reflected[mine] = response(item.material)(part)
    attenuation = scene.medium.attenuation_per_m
    fluence = ladar.surface_fluence(1.0, np.tile(intensity, len(angle_rad)), distance, attenuation)
    radiance = ladar.pixel_radiance(fluence, reflected, distance, attenuation)
    aperture = 0.25 * np.pi * receiver.aperture_diameter_m**2
    amplitude = ladar.photoelectrons(
        radiance * aperture * solid_angle,
        wavelength_m=wavelength_m,
        transmission=receiver.transmission,
        quantum_efficiency=quantum_efficiency,
    )
    per_metre = 2.0 * group_index(scene.medium, wavelength_m) / C_M_PER_S
    shape = (len(angle_rad), rays)
    return Footprint(
        np.where(hit, amplitude, 0.0).reshape(shape),
        (distance * per_metre).reshape(shape),
        np.where(axis_hits.target >= 0, axis_hits.distance, np.nan),
    )


def _cone(illumination: Illumination, field_rad: float, rays: int) -> tuple[Float, float]:
    """Directions about z that fill the field or, where it is narrower, the beam about its own axis; each solid angle."""
    reach = illumination.half_angle_rad * (_GAUSSIAN_REACH if illumination.profile == "gaussian" else 1.0)
    if reach >= field_rad:
        return sunflower_cone(field_rad, rays)
    local, solid_angle = sunflower_cone(reach, rays)
    ax, ay = illumination.offset_rad
    if ax or ay:
        cx, sx, cy, sy = np.cos(ax), np.sin(ax), np.cos(ay), np.sin(ay)
        about_x = np.array([[1.0, 0.0, 0.0], [0.0, cy, sy], [0.0, -sy, cy]])
        about_y = np.array([[cx, 0.0, sx], [0.0, 1.0, 0.0], [-sx, 0.0, cx]])
        local = about_y @ about_x @ local
    return local, solid_angle


def _turned(local: Float, angle_rad: Float) -> Float:
    """Directions (3, shot, n): `local` (3, n) turned by each angle in the x-z plane."""
    c, s = np.cos(angle_rad)[:, None], np.sin(angle_rad)[:, None]
    x, y, z = (part[None, :] for part in local)
    return np.stack([c * x + s * z, np.broadcast_to(y, (len(angle_rad), local.shape[1])), c * z - s * x])
