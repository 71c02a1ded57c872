"""The `scatter` rung of the one-detector rangers: forward scattering on both ways, and the water's backscatter.

The echo. Out: the beam I becomes I + I ⊗ h. Back: light that leaves the surface toward the lens from the direction θ is
spread by h about θ, so the detector takes the share 1_F(θ) + (1_F ⊗ h)(θ) of it, F its field of view. Rays outside of beam
and field then carry light too: a ray j counts with [I + I ⊗ h][1_F + 1_F ⊗ h] e^{−2cr}/r² ΔΩ_j.

The ramp. With light turned back once, at r, and scattered forward any number of times on both ways,

    dN/dr = K b ∫_F [β̃(π) I(θ) + β̄(π, 2br) (I ⊗ h₂)(θ)] H(r_target(θ) − r) dΩ · e^{−2cr}/r²,     τ = 2 n_g r/c,

h₂ the halo of both ways, β̄ the mean turn of light that arrives askew (`water.ramp`); h = 0 is single scattering. It is
summed over cells of range, short ones near the lens, where most of its light comes from.

Left out, as by the gated rung: delay of scattered light, two turns by large angles, scattered light's angle on the surface.
Beam and field are taken as overlapping fully beyond one aperture diameter, where the ramp begins.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ...optics.constants import C_M_PER_S
from ...optics.illumination import beam_rotation
from ...optics.water.beam import BeamHalo, tabulate_beam_halo
from ...optics.water.halo import softened_phase
from ...optics.water.phase_forms import PhaseFunction, phase_density
from ...scenes.medium_index import group_index
from ...scenes.scene import Scene
from ..rays.trace import Tracer
from ..water.phase import phase_of
from .footprint import Footprint, Ranger, ranger_footprint, sunflower_cone, turned

__all__ = ["Ramp", "RangerHalo", "backscatter_ramp", "covering_lattice", "forward_gain", "ranger_light"]

Float = NDArray[np.float64]

#: Halos are followed to this angle from the axes: beyond, small angles are none.
_WIDEST_RAD = 1.35
#: A Gaussian beam's lattice reaches to this many of its half angles.
_REACH = 2.6
_TABLE_ANGLES = 256
#: Rays of a shot along which the ramp is summed, and shots at once (bounds memory).
_RAMP_RAYS = 192
_SHOTS = 64
#: The light of the beam within the field is taken from so many times as many rays.
_FINE = 64
#: Cells of the ramp: at most this share of their range long, at most this many.
_CELL_SHARE = 0.08
_MOST_CELLS = 4096
#: Scattering lengths after which halos no longer change.
_MOST_LENGTHS = 60.0


def ranger_light(
    scene: Scene, ranger: Ranger, rays: int, tracer: Tracer | None, rung: str, *, step_m: float, furthest_m: float
) -> tuple[Footprint, Ramp | None]:
    """(the footprint, the water's ramp) of a scene at a rung.

    Main arguments:
        ranger: beam and lens. rays: of a shot's footprint (the scatter rung takes four times as many).
        rung: "direct" or "scatter"; they are the same to the bit where nothing scatters, and there is no ramp.
        step_m, furthest_m: as for `backscatter_ramp`.

    Raises:
        InputError: the medium scatters and has no phase function.
    """
    tracer = tracer or Tracer(scene)
    phase = phase_of(scene) if rung == "scatter" else None
    if phase is None:
        return ranger_footprint(scene, ranger, rays, tracer), None
    beam = ranger_footprint(scene, ranger, rays, tracer, RangerHalo(scene, ranger, phase))
    return beam, backscatter_ramp(scene, ranger, phase, tracer, step_m=step_m, furthest_m=furthest_m)


def forward_gain(scene: Scene, ranger: Ranger, phase: PhaseFunction, range_m: float, rays: int = 4096) -> float:
    """Echo with light scattered forward over the echo without, of a wide Lambert sphere around the lens at `range_m`.

    ∫(I + I ⊗ h)(1_F + 1_F ⊗ h) dΩ / ∫ I 1_F dΩ: e^{br(1 − B)} where one of beam and field is far wider than h and the other
    narrower, e^{2br(1 − B)} where both are wide; infinite where beam and field do not overlap.
    """
    local, solid_angle = covering_lattice(ranger, rays)
    intensity = ranger.lamp.intensity(local)
    seen = ranger.seen(local)
    beam, field = RangerHalo(scene, ranger, phase).added(local, np.full((1, local.shape[1]), range_m))
    straight = float(np.sum(intensity * seen * solid_angle))
    whole = float(np.sum((intensity + beam[0]) * (seen + field[0]) * solid_angle))
    return whole / straight if straight > 0.0 else float("inf")


def covering_lattice(ranger: Ranger, rays: int, *, field_only: bool = False) -> tuple[Float, Float]:
    """(unit directions (3, n) about the lens's axis, solid angle that each stands for).

    Two lattices about the lens's and about the beam's axis, each half even in the cone of field or beam and half even in
    the logarithm of the angle beyond it. Together they count once: a direction stands for 1/Σ n_k p_k(ω), p_k the density of
    the k-th lattice there (the balance heuristic of Veach 1997, here for even points).
    """
    spec = ranger.lamp.illumination
    reach = min(spec.half_angle_rad * (_REACH if spec.profile == "gaussian" else 1.0), _WIDEST_RAD)
    parts, cones = [], []
    for turn, width in ((np.eye(3), min(ranger.field_rad, _WIDEST_RAD)), (beam_rotation(spec.offset_rad), reach)):
        inner, _ = sunflower_cone(width, rays // 4)
        parts += [turn @ inner, turn @ _rings(width, rays // 4)]
        cones.append((turn[:, 2], width))
    local = np.concatenate(parts, axis=1)
    if field_only:
        local = local[:, ranger.seen(local)]
    density = np.zeros(local.shape[1])
    for axis, width in cones:
        theta = np.arctan2(np.linalg.norm(np.cross(axis, local, axisa=0, axisb=0, axisc=0), axis=0), axis @ local)
        inside = theta <= width * (1 + 1e-12)
        cone = 4.0 * np.pi * np.sin(0.5 * width) ** 2
        ring = 2.0 * np.pi * np.sin(theta) * theta * np.log(1.02 * _WIDEST_RAD / width)
        outside = ~inside & (theta <= 1.02 * _WIDEST_RAD)
        density += (rays // 4) * (inside / cone + outside / np.where(outside, ring, 1.0))
    return local, 1.0 / density


def _rings(inner_rad: float, rays: int) -> Float:
    """Directions about z from the angle `inner_rad` outward, even in the logarithm of the angle."""
    theta = inner_rad * (1.02 * _WIDEST_RAD / inner_rad) ** ((np.arange(rays) + 0.5) / rays)
    azimuth = np.pi * (3.0 - np.sqrt(5.0)) * np.arange(rays)
    return np.stack([np.sin(theta) * np.cos(azimuth), np.sin(theta) * np.sin(azimuth), np.cos(theta)])


class RangerHalo:
    """Halos of beam (1/sr) and field of view (share): a `footprint.Halo`. Tabulated over the ranges of its first rays."""

    def __init__(self, scene: Scene, ranger: Ranger, phase: PhaseFunction) -> None:
        self._ranger, self._phase = ranger, phase
        self._scattering = scene.medium.scattering_per_m
        self._tables: tuple[BeamHalo, BeamHalo] | None = None

    def lattice(self, ranger: Ranger, rays: int) -> tuple[Float, Float]:
        """`covering_lattice`."""
        return covering_lattice(ranger, 4 * rays)

    def added(self, local: Float, range_m: Float) -> tuple[Float, Float]:
        """(I ⊗ h, 1_F ⊗ h) along directions (3, n) at ranges (shot, n)."""
        # Further away nothing comes back: e^{−2cr} wins over any halo, but must not meet an infinite one.
        reach = np.minimum(range_m, _MOST_LENGTHS / self._scattering)
        lamp = self._ranger.lamp
        if self._tables is None:
            between = (float(reach.min()), float(reach.max()))
            medium = (self._phase, self._scattering, between, 1)
            self._tables = (
                tabulate_beam_halo(lamp.profile, lamp.edge_rad, *medium, angles=_TABLE_ANGLES),
                tabulate_beam_halo(np.ones_like, self._ranger.field_rad, *medium, angles=_TABLE_ANGLES),
            )
        off_field = np.arctan2(np.hypot(local[0], local[1]), local[2])
        beam, field = self._tables
        return beam.at(lamp.angle(local)[None, :], reach), field.at(off_field[None, :], reach)


@dataclass(frozen=True)
class Ramp:
    """Backscatter in cells of range: `amplitude` photoelectrons per joule (shot, cell); mean time `tau` s (cell) and its
    standard deviation `spread` s (cell)."""

    amplitude: Float
    tau: Float
    spread: Float


def backscatter_ramp(
    scene: Scene,
    ranger: Ranger,
    phase: PhaseFunction,
    tracer: Tracer,
    *,
    step_m: float,
    furthest_m: float,
    forward: bool = True,
) -> Ramp:
    """The water's own light, up to the target or `furthest_m`.

    Main arguments:
        step_m: longest cell of range.
    Other arguments:
        forward: count light scattered forward too; without, exactly one scattering.
    """
    medium, lamp = scene.medium, ranger.lamp
    local, solid_angle = covering_lattice(ranger, 4 * _RAMP_RAYS, field_only=True)
    limit = np.empty((len(ranger.angle_rad), local.shape[1]))
    for begin in range(0, len(limit), _SHOTS):
        part = slice(begin, begin + _SHOTS)
        hits = tracer.trace((0.0, 0.0, 0.0), turned(local, ranger.angle_rad[part]).reshape(3, -1))
        limit[part] = np.where(hits.target >= 0, hits.distance, np.inf).reshape(-1, local.shape[1])
    nearest = ranger.receiver.aperture_diameter_m
    dark = _MOST_LENGTHS / (2.0 * max(medium.attenuation_per_m, 1e-3))
    edge = _cells(nearest, min(furthest_m, float(limit.max()), dark), step_m)
    low, high = edge[:-1], edge[1:]
    k = 2.0 * medium.attenuation_per_m
    weight, mean, spread = _cell_moments(low, high, k)
    turned_back = float(phase_density(phase, np.pi)) * _whole_beam(ranger, local, solid_angle)
    light = np.repeat((turned_back * lamp.intensity(local))[:, None], len(low), axis=1)
    if forward and edge[-1] > edge[0]:
        halo = tabulate_beam_halo(
            lamp.profile, lamp.edge_rad, phase, medium.scattering_per_m, (nearest, float(edge[-1])), 2,
            angles=_TABLE_ANGLES,
        )  # fmt: skip
        at = np.geomspace(nearest, float(edge[-1]), 24)
        askew = softened_phase(phase, 2.0 * medium.scattering_per_m * at, np.array([np.pi]))[:, 0]
        light += halo.at(lamp.angle(local)[:, None], mean[None, :]) * np.interp(mean, at, askew)
    light *= solid_angle[:, None]
    scale = float(ranger.electrons(np.array(medium.scattering_per_m)))
    amplitude = np.empty((len(limit), len(low)))
    for begin in range(0, len(limit), _SHOTS):
        part = slice(begin, begin + _SHOTS)
        amplitude[part] = scale * weight * np.einsum("src,rc->sc", _lit_share(limit[part], edge, k), light)
    per_metre = 2.0 * group_index(medium, ranger.wavelength_m) / C_M_PER_S
    return Ramp(amplitude, mean * per_metre, spread * per_metre)


def _whole_beam(ranger: Ranger, local: Float, solid_angle: Float) -> float:
    """∫_F I dΩ over its sum on this lattice: a few hundred rays meet a narrow beam or field by chance to some 10⁻³."""
    fine, part = covering_lattice(ranger, _FINE * 4 * _RAMP_RAYS, field_only=True)
    coarse = float(np.sum(ranger.lamp.intensity(local) * solid_angle))
    return float(np.sum(ranger.lamp.intensity(fine) * part)) / coarse if coarse > 0.0 else 1.0


def _lit_share(limit: Float, edge: Float, k: float) -> Float:
    """Share (shot, ray, cell) of ∫ e^{−kr}/r² dr of a cell that lies before the end of a ray (shot, ray).

    The integral is [E₂(kr)/r]; within a cell its logarithm is linear in ln r to 10⁻⁴ (cells are at most 8 % of r long), so
    that the share follows from e^{−kr}/r² at the cell's ends by a power of r.
    """
    low, high = edge[:-1], edge[1:]
    end = np.clip(limit[..., None], low, high)
    # e^{−kr}/r² = r^(−q) within the cell, with q from both ends; ∫ r^(−q) dr = r^(1−q)/(1−q).
    power = 1.0 - 2.0 - k * (high - low) / np.log(high / low)
    return np.asarray(np.expm1(power * np.log(end / low)) / np.expm1(power * np.log(high / low)))


def _cells(nearest: float, furthest: float, step_m: float) -> Float:
    """Edges of cells that grow with range up to `step_m`."""
    furthest = max(furthest, nearest)
    turn = max(min(step_m / _CELL_SHARE, furthest), nearest)
    near = int(np.ceil(np.log(turn / nearest) / _CELL_SHARE))
    far = min(int(np.ceil((furthest - turn) / step_m)), _MOST_CELLS)
    first = np.geomspace(nearest, turn, near + 1) if near else np.array([nearest])
    return np.concatenate([first, np.linspace(turn, furthest, far + 1)[1:]])


def _cell_moments(low: Float, high: Float, k: float) -> tuple[Float, Float, Float]:
    """(∫ e^{−kr}/r² dr, mean of r under it, its standard deviation) of every cell."""
    node, share = np.polynomial.legendre.leggauss(6)
    r = low[:, None] + 0.5 * (high - low)[:, None] * (node + 1.0)
    value = 0.5 * (high - low)[:, None] * share * np.exp(-k * r) / r**2
    total = value.sum(axis=1)
    mean = (value * r).sum(axis=1) / total
    return total, mean, np.sqrt(np.maximum((value * (r - mean[:, None]) ** 2).sum(axis=1) / total, 0.0))
