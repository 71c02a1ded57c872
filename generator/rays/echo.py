"""From first hits to echoes: photoelectrons and arrival time of the one-bounce return of every ray."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ...optics.constants import C_M_PER_S
from ...optics.reflection.angles import Angles, angles, monostatic
from ...scenes.medium_index import group_index
from ...scenes.scene import Scene, TargetObject
from .lamp import Lamp
from .trace import Hits, Tracer
from .view import View

__all__ = ["Echoes", "Halo", "echoes", "reflected", "textured_response"]

Float = NDArray[np.float64]
#: Intensity [1/sr] that is added to the lamp's, along directions (3, n) away from it, at ranges (n).
Halo = Callable[[Float, Float], Float]


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


def reflected(scene: Scene, hits: Hits, a: Angles, wanted: NDArray[np.bool_]) -> Float:
    """Response f·cosθi [1/sr] of what each ray hits, at the angles; 0 where not `wanted` (n)."""
    out = np.zeros_like(hits.distance)
    for number, item in enumerate(scene.target):
        own = wanted & (hits.target == number)
        if own.any():
            part = Angles(a.cos_i[own], a.cos_o[own], a.cos_h[own], a.cos_d[own], a.cos_r[own])
            out[own] = textured_response(item, part, hits.shade[own])
    return out


def echoes(
    scene: Scene, view: View[Lamp], tracer: Tracer, direction: Float, hits: Hits, halo: Halo | None = None
) -> Echoes:
    """Echoes of rays along unit `direction` (3, n) with the first hits `hits`; zero amplitude where nothing is hit.

    amplitude = N_p · E_p · I(θ) e^{−c r₁}/r₁² · f·cosθi · A_px π/(4F²) · V · T · QE · λ/(hc) · e^{−c r₂},
    tau = n_g (r₁ + r₂)/c, with r₁ from the lamp to the surface and r₂ from there to the camera.

    `halo`(beam directions (3, n), r₁) is added to I(θ): what the medium scatters forward on the way out.
    """
    hit = hits.target >= 0
    r2 = np.where(hit, hits.distance, 1.0)
    point = direction * r2
    from_lamp = point if view.coaxial else point - np.asarray(view.lamp.position_m)[:, None]
    r1 = r2 if view.coaxial else np.sqrt(np.einsum("in,in->n", from_lamp, from_lamp))
    beam = direction if view.coaxial else from_lamp / r1
    intensity = view.lamp.intensity(beam)
    if halo is not None:
        intensity = intensity + halo(beam, r1)
    lit = hit & (intensity > 0)
    if not view.coaxial and lit.any():
        lit[lit] = tracer.visible(point[:, lit], view.lamp.position_m)
    cosine = -np.einsum("in,in->n", hits.normal, direction)
    a = monostatic(cosine) if view.coaxial else angles(hits.normal.T, -beam.T, -direction.T)
    amplitude = view.electrons(
        intensity_per_sr=intensity,
        lamp_range_m=r1,
        camera_range_m=r2,
        attenuation_per_m=scene.medium.attenuation_per_m,
        response_per_sr=reflected(scene, hits, a, lit),
        cos_field=view.falloff(direction[2]),
    )
    per_metre = group_index(scene.medium, view.wavelength_m) / C_M_PER_S
    row, col = _path_gradient(view, direction, hits.normal, r2, beam)
    return Echoes(
        amplitude=np.where(lit, amplitude, 0.0),
        tau=np.where(hit, (r1 + r2) * per_metre, np.nan),
        tau_per_row=np.where(hit, row * per_metre, 0.0),
        tau_per_col=np.where(hit, col * per_metre, 0.0),
        cos_view=np.where(hit, a.cos_o, 0.0),
    )


def _path_gradient(view: View[Lamp], direction: Float, normal: Float, r2: Float, beam: Float) -> tuple[Float, Float]:
    """d(r₁ + r₂) per pixel along (row, col) on the tangent plane [m].

    On the plane n·p = const, r₂ = (n·p)/(n·d): ∂r₂ = −r₂ (n·∂d)/(n·d), ∂p = d ∂r₂ + r₂ ∂d, ∂r₁ = beam·∂p, with
    ∂d = (e − d d·e) s for a step s along the axis e of the film.
    """
    camera = view.camera
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
