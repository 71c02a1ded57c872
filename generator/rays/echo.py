"""From first hits to echoes: photoelectrons and arrival time of the one-bounce return of every ray."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ...optics import illumination, ladar
from ...optics.constants import C_M_PER_S
from ...optics.reflection.angles import Angles, angles, monostatic
from ...scenes.medium_index import group_index
from ...scenes.rigs.gated import gated_rig
from ...scenes.rigs.parts import Illumination
from ...scenes.scene import Scene, TargetObject
from .trace import Hits, Tracer

__all__ = ["Echoes", "beam_angle", "beam_intensity", "echoes", "textured_response"]

Float = NDArray[np.float64]


@dataclass(frozen=True)
class Echoes:
    """One echo per ray: `amplitude` photoelectrons per slice at an open gate, `tau` s after the pulse centroid left,
    `path_gradient` of tau, s per pixel along (row, col), on the tangent plane; `cos_view` |n·d|."""

    amplitude: Float
    tau: Float
    tau_per_row: Float
    tau_per_col: Float
    cos_view: Float


def textured_response(item: TargetObject, a: Angles, shade: Float) -> Float:
    """The response f·cosθi [1/sr] of an object, its diffuse part times `shade`, the texture's value."""
    whole = item.material.response(a)
    if item.texture is None:
        return whole
    gloss = item.material.without_diffuse().response(a)
    return np.asarray(gloss + shade * (whole - gloss))


def echoes(
    scene: Scene,
    tracer: Tracer,
    direction: Float,
    hits: Hits,
    halo: Callable[[Float, Float], Float] | None = None,
) -> Echoes:
    """Echoes of rays along unit `direction` (3, n) that hit the target as `hits` tells; zero amplitude where nothing is hit.

    amplitude = N_p · E_p · I(θ) e^{−c r₁}/r₁² · f·cosθi · A_px π/(4F²) · V · T · QE · λ/(hc) · e^{−c r₂},
    tau = n_g (r₁ + r₂)/c, with r₁ from the laser to the surface and r₂ from there to the camera.

    `halo`(beam directions (3, n), r₁) is added to I(θ): what the medium scatters forward on the way out.
    """
    rig, medium = gated_rig(scene), scene.medium
    camera, laser = rig.camera, rig.laser
    hit = hits.target >= 0
    r2 = np.where(hit, hits.distance, 1.0)
    point = direction * r2
    source = np.asarray(laser.position_m)
    coaxial = not np.any(source)
    from_laser = point if coaxial else point - source[:, None]
    r1 = r2 if coaxial else np.sqrt(np.einsum("in,in->n", from_laser, from_laser))
    beam = direction if coaxial else from_laser / r1
    intensity = beam_intensity(laser.illumination, beam)
    if halo is not None:
        intensity = intensity + halo(beam, r1)
    lit = hit & (intensity > 0)
    if not coaxial and lit.any():
        lit[lit] = tracer.visible(point[:, lit], laser.position_m)
    cosine = -np.einsum("in,in->n", hits.normal, direction)
    a = monostatic(cosine) if coaxial else angles(hits.normal.T, -beam.T, -direction.T)
    reflected = np.zeros_like(r2)
    for number, item in enumerate(scene.target):
        mine = lit & (hits.target == number)
        if mine.any():
            part = Angles(a.cos_i[mine], a.cos_o[mine], a.cos_h[mine], a.cos_d[mine], a.cos_r[mine])
            reflected[mine] = textured_response(item, part, hits.shade[mine])
    amplitude = rig.pulses_per_slice * ladar.pixel_photoelectrons(
        pulse_energy_j=laser.pulse_energy_j,
        intensity_per_sr=intensity,
        lamp_range_m=r1,
        camera_range_m=r2,
        attenuation_per_m=medium.attenuation_per_m,
        response_per_sr=reflected,
        pixel_area_m2=camera.pixel_pitch_m**2,
        f_number=camera.f_number,
        cos_field=direction[2] if camera.vignetting == "cos4" else 1.0,
        transmission=camera.transmission,
        quantum_efficiency=camera.quantum_efficiency,
        wavelength_m=laser.wavelength_m,
    )
    per_metre = group_index(medium, laser.wavelength_m) / C_M_PER_S
    row, col = _path_gradient(scene, direction, hits.normal, r2, beam)
    return Echoes(
        amplitude=np.where(lit, amplitude, 0.0),
        tau=np.where(hit, (r1 + r2) * per_metre, np.nan),
        tau_per_row=np.where(hit, row * per_metre, 0.0),
        tau_per_col=np.where(hit, col * per_metre, 0.0),
        cos_view=np.where(hit, a.cos_o, 0.0),
    )


def beam_angle(spec: Illumination, beam: Float) -> Float:
    """Angle [rad] of unit directions (3, n) from the beam's axis."""
    if not any(spec.offset_rad):
        return np.asarray(np.arctan2(np.hypot(beam[0], beam[1]), beam[2]))
    axis = illumination.beam_axis(spec.offset_rad)
    # atan2 of cross and dot keeps full accuracy near the axis, where arccos loses half the digits.
    cross = np.cross(axis, beam, axisa=0, axisb=0, axisc=0)
    return np.asarray(np.arctan2(np.sqrt(np.einsum("in,in->n", cross, cross)), axis @ beam))


def beam_intensity(spec: Illumination, beam: Float) -> Float:
    """Radiant intensity of the beam along unit directions (3, n), per unit power [1/sr]."""
    return illumination.beam_intensity(spec.profile, beam_angle(spec, beam), spec.half_angle_rad, spec.radial_value)


def _path_gradient(scene: Scene, direction: Float, normal: Float, r2: Float, beam: Float) -> tuple[Float, Float]:
    """d(r₁ + r₂) per pixel along (row, col) on the tangent plane [m].

    On the plane n·p = const, r₂ = (n·p)/(n·d): ∂r₂ = −r₂ (n·∂d)/(n·d), ∂p = d ∂r₂ + r₂ ∂d, ∂r₁ = beam·∂p, with
    ∂d = (e − d d·e) s for a step s along the axis e of the film.
    """
    camera = gated_rig(scene).camera
    scale = camera.pixel_pitch_m / camera.focal_length_m * direction[2] * r2
    facing = np.einsum("in,in->n", normal, direction)
    facing = np.where(np.abs(facing) > 1e-6, facing, -1e-6)
    coaxial = beam is direction
    along = 1.0 if coaxial else np.einsum("in,in->n", beam, direction)
    result = []
    for axis in (1, 0):  # rows go along y, columns along x
        d_r2 = scale * (direction[axis] - normal[axis] / facing)
        across = 0.0 if coaxial else scale * (beam[axis] - along * direction[axis])
        result.append((1.0 + along) * d_r2 + across)
    return result[0], result[1]
