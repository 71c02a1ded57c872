"""The beam's footprint: deterministic rays of a coaxial ranger, each with its share of the echo and its time.

A detector of diameter D in the focus f of a lens sees a cone of half angle D/2f; the laser lights its own. Rays fill the
narrower of the two evenly in solid angle (a sunflower lattice: equal weights, no random number), so that ray j of solid
angle ΔΩ contributes

    a_j = E · I(θ_j) · f cosθᵢ · e^{−2 c r_j}/r_j² · A_aperture · ΔΩ · T · QE · λ/(hc),      τ_j = 2 n_g r_j/c.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from ...optics import ladar
from ...optics.constants import C_M_PER_S
from ...optics.illumination import beam_rotation
from ...optics.reflection.angles import angles
from ...scenes.medium_index import group_index
from ...scenes.rigs.parts import Receiver
from ...scenes.scene import Scene
from ..rays.echo import reflected
from ..rays.lamp import RoundBeam
from ..rays.trace import Tracer

__all__ = ["Footprint", "Halo", "Ranger", "ranger_footprint", "rays_for", "shot_angles", "sunflower_cone", "turned"]

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


@dataclass(frozen=True)
class Ranger:
    """What the rangers have in common: one beam, one lens, one detector, and the `angle_rad` of their shots."""

    wavelength_m: float
    lamp: RoundBeam
    receiver: Receiver
    detector_diameter_m: float
    quantum_efficiency: float
    angle_rad: Float

    @property
    def field_rad(self) -> float:
        """Half angle of the detector's field of view."""
        return float(np.arctan2(0.5 * self.detector_diameter_m, self.receiver.focal_length_m))

    def seen(self, local: Float) -> NDArray[np.bool_]:
        """Whether directions (3, n) about the lens's axis lie in the field."""
        angle = np.arctan2(np.hypot(local[0], local[1]), local[2])
        return np.asarray(angle <= self.field_rad * (1 + 1e-12))

    def electrons(self, radiance_per_sr: Float) -> Float:
        """Photoelectrons of radiance times solid angle, J/m²."""
        aperture = 0.25 * np.pi * self.receiver.aperture_diameter_m**2
        return ladar.photoelectrons(
            radiance_per_sr * aperture, wavelength_m=self.wavelength_m, transmission=self.receiver.transmission,
            quantum_efficiency=self.quantum_efficiency,
        )  # fmt: skip


class Halo(Protocol):
    """What forward scattering adds to beam and field (`scatter.RangerHalo`)."""

    def lattice(self, ranger: Ranger, rays: int) -> tuple[Float, Float]:
        """(directions (3, n) about the lens's axis that cover beam, field and their halos, solid angle of each)."""

    def added(self, local: Float, range_m: Float) -> tuple[Float, Float]:
        """(intensity added to the beam, 1/sr; acceptance added to the field), at ranges that broadcast to (shot, n)."""


def ranger_footprint(
    scene: Scene, ranger: Ranger, rays: int, tracer: Tracer | None = None, halo: Halo | None = None
) -> Footprint:
    """Trace the rays of every shot.

    Main arguments:
        scene: target and medium; ranger: beam and lens; rays: of a shot.
    Other arguments:
        tracer: reuse one of the same target; halo: light scattered forward on both ways, with rays beyond the field.
    """
    tracer = tracer or Tracer(scene)
    if halo is None:
        local, even = _cone(ranger.lamp, ranger.field_rad, rays)
        solid_angle = np.full(local.shape[1], even)
    else:
        local, solid_angle = halo.lattice(ranger, rays)
    shape = (len(ranger.angle_rad), local.shape[1])
    axes = turned(np.array([[0.0], [0.0], [1.0]]), ranger.angle_rad)[:, :, 0]
    axis_hits = tracer.trace((0.0, 0.0, 0.0), axes)
    direction = turned(local, ranger.angle_rad).reshape(3, -1)
    hits = tracer.trace((0.0, 0.0, 0.0), direction)
    hit = hits.target >= 0
    distance = np.where(hit, hits.distance, 1.0)
    response = reflected(scene, hits, angles(hits.normal.T, -direction.T, -direction.T), hit)
    intensity = np.broadcast_to(ranger.lamp.intensity(local), shape)
    accepted = np.broadcast_to(ranger.seen(local).astype(np.float64), shape)
    if halo is not None:
        beam, field = halo.added(local, distance.reshape(shape))
        intensity, accepted = intensity + beam, accepted + field
    attenuation = scene.medium.attenuation_per_m
    fluence = ladar.surface_fluence(1.0, intensity.ravel(), distance, attenuation)
    radiance = ladar.pixel_radiance(fluence, response, distance, attenuation)
    amplitude = ranger.electrons((radiance.reshape(shape) * accepted) * solid_angle)
    per_metre = 2.0 * group_index(scene.medium, ranger.wavelength_m) / C_M_PER_S
    return Footprint(
        np.where(hit.reshape(shape), amplitude, 0.0),
        (distance * per_metre).reshape(shape),
        np.where(axis_hits.target >= 0, axis_hits.distance, np.nan),
    )


def _cone(lamp: RoundBeam, field_rad: float, rays: int) -> tuple[Float, float]:
    """Directions about z that fill the field or, where it is narrower, the beam about its own axis; each solid angle."""
    spec = lamp.illumination
    reach = spec.half_angle_rad * (_GAUSSIAN_REACH if spec.profile == "gaussian" else 1.0)
    if reach >= field_rad:
        return sunflower_cone(field_rad, rays)
    local, solid_angle = sunflower_cone(reach, rays)
    if any(spec.offset_rad):
        local = beam_rotation(spec.offset_rad) @ local
    return local, solid_angle


def turned(local: Float, angle_rad: Float) -> Float:
    """Directions (3, shot, n): `local` (3, n) turned by each angle in the x-z plane."""
    c, s = np.cos(angle_rad)[:, None], np.sin(angle_rad)[:, None]
    x, y, z = (part[None, :] for part in local)
    return np.stack([c * x + s * z, np.broadcast_to(y, (len(angle_rad), local.shape[1])), c * z - s * x])
