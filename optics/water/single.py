"""Light scattered once between lamp and camera: the response of a medium to a short pulse, against path length.

A point lamp of radiant intensity I(θ) (per unit energy, 1/sr) lies at s, a pinhole camera at the origin looks along the
unit vector d. At range r₂ along d the light has travelled r₁ = |r₂ d − s| and is deflected by ψ. The radiance per unit
energy is

    dL/dr₂ = b β̃(ψ) I(θ) e^{−c(r₁ + r₂)}/r₁²    [1/(m³ sr)],     path = r₁ + r₂,

for a coaxial rig (s = 0, ψ = π, r₁ = r₂ = r) dL/dr = I b β̃(π) e^{−2cr}/r². Pulses travel at c/n_g: time = n_g path/c.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from ..correlation.parts import Array
from .phase_forms import PhaseFunction, phase_density

__all__ = [
    "RayGeometry", "coaxial_far_field", "coaxial_response", "radiance_between", "ray_geometry", "single_scatter_response",
]  # fmt: skip


@dataclass(frozen=True)
class RayGeometry:
    """Points of a camera ray by path length: `camera_range_m` r₂, `lamp_range_m` r₁, `turn_rad` ψ, `range_per_path`
    dr₂/d(path), and `beam` (…, 3), the unit direction from the lamp."""

    camera_range_m: Array
    lamp_range_m: Array
    turn_rad: Array
    range_per_path: Array
    beam: Array


def ray_geometry(path_m: ArrayLike, direction: ArrayLike, lamp_m: ArrayLike) -> RayGeometry:
    """The point of a ray at which the path lamp-point-camera is `path_m` long.

    Main arguments:
        path_m: paths, above |s|, of any shape.
        direction, lamp_m: unit direction d of the ray and position s of the lamp, (3,).

    r₂ = (P² − s²)/(2(P − s·d)). Raises ValueError for a path not longer than the baseline.
    """
    path = np.asarray(path_m, dtype=np.float64)
    d, s = np.asarray(direction, dtype=np.float64), np.asarray(lamp_m, dtype=np.float64)
    base2, along = float(s @ s), float(s @ d)
    if not np.all(path**2 > base2):
        raise ValueError("path_m must be longer than the baseline between lamp and camera.")
    gap = path - along
    r2 = 0.5 * (path**2 - base2) / gap
    r1 = path - r2
    beam = (r2[..., None] * d - s) / r1[..., None]
    # ψ lies between the beam and −d: atan2 of cross and dot keeps full accuracy near π
    cross = np.linalg.norm(np.cross(beam, d), axis=-1)
    turn = np.arctan2(cross, -(beam @ d))
    slope = (path * gap - 0.5 * (path**2 - base2)) / gap**2
    return RayGeometry(r2, r1, turn, slope, beam)


def single_scatter_response(
    path_m: ArrayLike,
    direction: ArrayLike,
    lamp_m: ArrayLike,
    *,
    intensity: Callable[[Array], Array],
    phase: PhaseFunction,
    absorption_per_m: float,
    scattering_per_m: float,
) -> Array:
    """dL/d(path) of one ray per unit of emitted energy, 1/(m³ sr): radiance per metre of the path lamp-point-camera.

    Main arguments:
        path_m, direction, lamp_m: as for `ray_geometry`.
        intensity: I of unit directions (…, 3) from the lamp, 1/sr, ∫ I dΩ = 1.
        phase, absorption_per_m, scattering_per_m: the medium.
    """
    g = ray_geometry(path_m, direction, lamp_m)
    c = absorption_per_m + scattering_per_m
    lit = intensity(g.beam) / g.lamp_range_m**2
    turned = scattering_per_m * phase_density(phase, g.turn_rad)
    return np.asarray(turned * lit * np.exp(-c * np.asarray(path_m)) * g.range_per_path)


def coaxial_response(
    range_m: ArrayLike, *, intensity_per_sr: ArrayLike, phase: PhaseFunction, absorption_per_m: float,
    scattering_per_m: float,
) -> Array:  # fmt: skip
    """dL/dr = I b β̃(π) e^{−2cr}/r² of a coaxial rig, per unit energy, 1/(m³ sr)."""
    r = np.asarray(range_m, dtype=np.float64)
    c = absorption_per_m + scattering_per_m
    back = scattering_per_m * float(phase_density(phase, np.pi))
    return np.asarray(np.asarray(intensity_per_sr) * back * np.exp(-2.0 * c * r) / r**2)


def coaxial_far_field(
    near_m: ArrayLike, far_m: ArrayLike, *, intensity_per_sr: ArrayLike, phase: PhaseFunction, absorption_per_m: float,
    scattering_per_m: float,
) -> Array:  # fmt: skip
    """∫ of `coaxial_response` from near to far, in closed form by exponential integrals, 1/(m² sr):

    ∫ e^{−kr}/r² dr = [E₂(k r)/r] from far to near, k = 2c. Thin slab at r: (far − near) e^{−2cr}/r²; far → ∞ allowed.
    """
    from scipy.special import expn

    near, far = np.asarray(near_m, dtype=np.float64), np.asarray(far_m, dtype=np.float64)
    k = 2.0 * (absorption_per_m + scattering_per_m)
    back = scattering_per_m * float(phase_density(phase, np.pi))
    with np.errstate(invalid="ignore"):
        end = np.where(np.isinf(far), 0.0, expn(2, k * np.minimum(far, 1e300)) / far)
    return np.asarray(np.asarray(intensity_per_sr) * back * (expn(2, k * near) / near - end))


def radiance_between(
    low_m: float,
    high_m: float,
    direction: ArrayLike,
    lamp_m: ArrayLike,
    *,
    intensity: Callable[[Array], Array],
    phase: PhaseFunction,
    absorption_per_m: float,
    scattering_per_m: float,
    nodes: int = 64,
) -> float:
    """∫ of `single_scatter_response` over paths low … high by Gauss-Legendre, per unit energy, 1/(m² sr)."""
    node, weight = np.polynomial.legendre.leggauss(nodes)
    half = 0.5 * (high_m - low_m)
    path = low_m + half * (node + 1.0)
    value = single_scatter_response(
        path, direction, lamp_m, intensity=intensity, phase=phase, absorption_per_m=absorption_per_m,
        scattering_per_m=scattering_per_m,
    )  # fmt: skip
    return float(half * np.sum(weight * value))
