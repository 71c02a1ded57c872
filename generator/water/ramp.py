"""Backscatter of the medium itself: the light that is turned back before it reaches the target.

For slice k and a pixel's ray the ramp is

    B_k = K ∫ b [β̃(ψ) I + β̄(ψ, s) I ⊗ h]/r₁² · e^{−c(r₁ + r₂)} · R(n_g(r₁ + r₂)/c − t_k) dr₂   up to the target,

K the photoelectrons per radiance of the pixel, I ⊗ h what was scattered forward on both ways and β̄ its mean turn (one
turn by a large angle, any number by small ones; h = 0 leaves exactly single scattering). The quadrature's nodes
are even in arrival time, so that R is tabulated once for all pixels.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ...optics.constants import C_M_PER_S
from ...optics.correlation.response import Table, lookup
from ...optics.jit import kernel, prange
from ...optics.water.beam import BeamHalo, halo_value, tabulate_beam_halo
from ...optics.water.halo import softened_phase
from ...optics.water.phase_forms import PhaseFunction, phase_density
from ...scenes.medium_index import group_index
from ...scenes.scene import Scene
from ..rays.lamp import Lamp, RoundBeam
from ..rays.trace import pixel_directions
from ..rays.view import View

__all__ = ["backscatter_electrons", "nearest_path_m"]

Float = NDArray[np.float64]

#: Nodes of arrival time per rise of R (its peak over its steepest slope; 1.65 σ of a Gaussian): at the target's edge
#: the midpoint rule then errs by about (1/6)²/24 = .1 % of the peak.
_NODES_PER_RISE = 10.0
#: Long gates: this many nodes at most, and R is averaged over each node's cell.
_MOST_NODES = 2048
_IN_CELL = (np.arange(8) + 0.5) / 8 - 0.5
_ANGLE_NODES = 2048
_SMALLEST_TURN_RAD = 1e-5
_SOFT_NODES = 181
#: Pixels whose gates open within this share of a rise of R of each other share nodes; and how many groups at most.
_LEVEL = 0.1
_MOST_LEVELS = 48


def nearest_path_m(view: View[Lamp]) -> float:
    """Shortest path lamp-water-camera that counts, m: where lamp and aperture (f/F) are no longer points."""
    baseline = float(np.linalg.norm(view.lamp.position_m))
    return baseline + 2.0 * view.camera.focal_length_m / view.camera.f_number


@dataclass(frozen=True, eq=False)
class _Sight:
    """What the slices see. `tables`, `gate`: R of every gate, and the gate of each slice; `delay_s`, `scale`: optical delay and
    relative energy of each slice; `late`: extra delay of the gate, of each pixel or of all (1); `speed` of light in the
    medium, m/s; `window`: first and last arrival time that any slice sees at the gate's own opening; `furthest`: last
    arrival time of light from before the targets."""

    tables: Sequence[Table]
    gate: NDArray[np.int32]
    delay_s: Float
    scale: Float
    late: Float
    speed: float
    window: tuple[float, float]
    furthest: float


@dataclass(frozen=True, eq=False)
class _Water:
    """What the kernel needs to know of the beam in the water: `halo` of light scattered forward on both ways; ln β̃ of the turn,
    even in ln ψ, and `soft`, ln β̄ (path, turn) of light that arrives askew."""

    halo: BeamHalo
    log_phase: Float
    per_turn: float
    soft: Float


def backscatter_electrons(
    scene: Scene,
    view: View[RoundBeam],
    phase: PhaseFunction,
    tables: Sequence[Table],
    gate: NDArray[np.int32],
    delay_s: Float,
    scale: Float,
    target_range_m: Float,
    offset_s: Float | None,
    *,
    forward: bool = True,
) -> NDArray[np.float32]:
    """Photoelectrons (slice, row, col) of the medium's backscatter.

    Main arguments:
        tables, gate: R of every gate, and the gate of each slice.
        delay_s, scale: true optical delay and relative energy of each slice.
        target_range_m: (row, col) where the ray ends; NaN where it meets nothing.
        offset_s: per-pixel gate offset (row, col), or None.
    Other arguments:
        forward: also count light scattered forward on its ways (`scatter` rung); without, exactly one scattering.
    """
    medium, camera = scene.medium, view.camera
    rows, cols = camera.rows, camera.cols
    out = np.zeros((len(delay_s), rows * cols), dtype=np.float32)
    speed = C_M_PER_S / group_index(medium, view.wavelength_m)
    lit = np.flatnonzero(scale > 0)
    if medium.scattering_per_m == 0 or not len(lit):
        return out.reshape(-1, rows, cols)
    late = np.zeros(1) if offset_s is None else np.asarray(offset_s, np.float64).ravel()
    reach = target_range_m + np.abs(target_range_m) + np.linalg.norm(view.lamp.position_m)
    furthest = float(np.max(reach)) / speed if np.isfinite(reach).all() else np.inf
    window = _seen(tables, gate[lit], delay_s[lit])
    # Arrival times that any pixel can see: where the gate opens later, so does what it shows.
    begin = max(window[0] + late.min(), nearest_path_m(view) / speed)
    end = min(window[1] + late.max(), furthest)
    if end <= begin:
        return out.reshape(-1, rows, cols)
    sight = _Sight(tables, gate, delay_s, scale, late, speed, window, furthest)
    water = _water(scene, view, phase, (0.5 * max(begin * speed, 1e-3), 0.5 * end * speed), forward)
    direction = pixel_directions(camera, *(a.ravel() for a in np.mgrid[:rows, :cols]))
    per_radiance = np.broadcast_to(view.electrons(cos_field=view.falloff(direction[2])), rows * cols)
    limit = np.where(np.isfinite(target_range_m), target_range_m, np.inf).ravel()
    level, which = _levels(late, _rise_s(tables))
    for number, shift in enumerate(level):
        own = np.flatnonzero(which == number) if late.size > 1 else np.arange(rows * cols)
        if own.size:
            rays = (np.ascontiguousarray(direction[:, own]), per_radiance[own] + 0.0, limit[own])
            left = late[own] - shift if late.size > 1 else np.zeros(own.size)
            _add_level(scene, view, sight, water, rays, shift, left, forward, own, out)
    return out.reshape(-1, rows, cols)


def _water(
    scene: Scene, view: View[RoundBeam], phase: PhaseFunction, range_m: tuple[float, float], forward: bool
) -> _Water:
    """Tables of the beam in the water between two ranges; without `forward` nothing is scattered but once."""
    b, beam = scene.medium.scattering_per_m, view.lamp
    halo, soft = _flat_halo(), np.zeros((2, 2))
    if forward:
        halo = tabulate_beam_halo(beam.profile, beam.edge_rad, phase, b, range_m, 2)
        lengths = np.exp(halo.log_range_start + halo.log_range_step * np.arange(halo.log_shape.shape[0]))
        soft = softened_phase(phase, 2.0 * b * lengths, np.linspace(0.0, np.pi, _SOFT_NODES))
    turn = np.geomspace(_SMALLEST_TURN_RAD, np.pi, _ANGLE_NODES)
    return _Water(
        halo, np.log(np.maximum(phase_density(phase, turn), 1e-300)), 1.0 / np.log(turn[1] / turn[0]),
        np.log(np.maximum(soft, 1e-300)),
    )  # fmt: skip


def _add_level(
    scene: Scene, view: View[RoundBeam], sight: _Sight, water: _Water, rays: tuple[Float, Float, Float], shift: float,
    left: Float, forward: bool, pixel: NDArray[np.int64], out: NDArray[np.float32],
) -> None:  # fmt: skip
    """Write the pixels whose gates open within one level of the offset, `shift` + `left`, into `out` (slice, pixel).

    `rays` of these pixels: directions (3, n), photoelectrons per radiance (n), ranges at which the rays end (n).
    """
    direction, per_radiance, limit = rays
    low = max(sight.window[0], nearest_path_m(view) / sight.speed - shift - left.max())
    high = min(sight.window[1], sight.furthest - shift - left.min())
    if high <= low:
        return
    tau, step, weight = _nodes(view, sight, (low, high), shift)
    shown = weight != 0
    first = np.where(shown.any(axis=1), shown.argmax(axis=1), 0)
    last = np.where(shown.any(axis=1), tau.size - shown[:, ::-1].argmax(axis=1), 0)
    part = np.zeros((len(sight.delay_s), pixel.size), dtype=np.float32)
    beam, halo, medium = view.lamp, water.halo, scene.medium
    _ramp(
        direction, np.asarray(beam.position_m), beam.axis, per_radiance, limit, shift + left, tau, step, sight.speed,
        weight, first, last, beam.profile(np.linspace(0.0, beam.edge_rad, 4096)), beam.edge_rad, water.log_phase,
        np.log(_SMALLEST_TURN_RAD), water.per_turn, medium.scattering_per_m, medium.attenuation_per_m,
        nearest_path_m(view), forward, halo.log_range_start, 1.0 / halo.log_range_step, 1.0 / halo.angle_scale_rad,
        1.0 / halo.angle_step, halo.rate_per_m, halo.log_shape, water.soft, part,
    )  # fmt: skip
    out[:, pixel] = part


def _seen(tables: Sequence[Table], gate: NDArray[np.int32], delay_s: Float) -> tuple[float, float]:
    """First and last arrival time that any slice shows, where the gate has no offset."""
    low = np.array([table.start_s for table in tables])[gate]
    long = np.array([table.step_s * (table.value.size - 1) for table in tables])[gate]
    return float((delay_s + low).min()), float((delay_s + low + long).max())


def _levels(late: Float, rise_s: float) -> tuple[Float, NDArray[np.int64]]:
    """Levels of the gate's offset, and which one each pixel is nearest to: nodes and their weights are shared by a level."""
    spread = float(late.max() - late.min())
    count = int(np.clip(np.ceil(spread / (_LEVEL * rise_s)), 1, _MOST_LEVELS))
    level = late.min() + spread * (np.arange(count) + 0.5) / count
    return level, np.clip((late - late.min()) * (count / max(spread, 1e-300)), 0, count - 1).astype(np.int64)


def _nodes(view: View[Lamp], sight: _Sight, between: tuple[float, float], shift: float) -> tuple[Float, float, Float]:
    """Nodes of gate time, their step, and what each slice shows of the light in each node's cell (slice, node); the light
    of a node arrives by `shift` later."""
    begin, end = between
    count = int(np.clip(np.ceil((end - begin) * _NODES_PER_RISE / _rise_s(sight.tables)), 16, _MOST_NODES))
    step = (end - begin) / count
    tau: Float = begin + step * (np.arange(count, dtype=np.float64) + 0.5)
    # Even shares of a cell's light: lamp and camera at one point, it falls as 1/path².
    inside = tau[:, None] + step * _IN_CELL
    if view.coaxial:
        arrival = tau + shift
        near, far = np.maximum(arrival - 0.5 * step, 1e-3 * step), np.maximum(arrival + 0.5 * step, 2e-3 * step)
        inside = 1.0 / ((0.5 - _IN_CELL) / near[:, None] + (0.5 + _IN_CELL) / far[:, None]) - shift
    weight = np.zeros((len(sight.delay_s), count))
    for k in np.flatnonzero(sight.scale > 0):
        seen = lookup(sight.tables[sight.gate[k]], inside - sight.delay_s[k])
        weight[k] = seen.mean(axis=1) * sight.scale[k] * step
    return tau, step, weight


def _flat_halo() -> BeamHalo:
    return BeamHalo(0.0, 1.0, 1.0, 1.0, 0.0, np.full((2, 2), -700.0))


def _rise_s(tables: Sequence[Table]) -> float:
    """Shortest rise of R among the gates [s]: its peak over its steepest slope."""
    return min(float(np.max(table.value) / np.max(np.abs(table.slope))) for table in tables)


@kernel(parallel=True)
def _ramp(  # type: ignore[no-untyped-def]
    direction, lamp, axis, per_radiance, limit, offset, tau, step, speed, weight, first, last, profile, edge,
    log_phase, turn0, inv_turn, b, c, nearest, forward, v0, inv_dv, inv_scale, inv_du, rate, shape, soft, out,
):  # fmt: skip
    pixels = direction.shape[1]
    nodes = tau.size
    base2 = lamp[0] ** 2 + lamp[1] ** 2 + lamp[2] ** 2
    per = (profile.size - 1) / edge
    block = 64
    for n in prange((pixels + block - 1) // block):
        density = np.empty(nodes)
        for p in range(n * block, min((n + 1) * block, pixels)):
            dx = direction[0, p]
            dy = direction[1, p]
            dz = direction[2, p]
            along = lamp[0] * dx + lamp[1] * dy + lamp[2] * dz
            late = offset[p]
            # where the target ends the ray: its path, as time
            r = limit[p]
            end = np.inf
            if r < np.inf:
                end = (r + np.sqrt(max(r * r - 2.0 * r * along + base2, 0.0))) / speed
            for i in range(nodes):
                density[i] = 0.0
                when = tau[i] + late
                share = min(max((end - when) / step + 0.5, 0.0), 1.0)
                path = when * speed
                if share == 0.0:
                    continue
                # The cell's part beyond the nearest path. Lamp and camera at one point: the light falls as 1/path², whose
                # mean over the cell is known; else the cell's middle stands for it.
                within = 1.0
                if base2 == 0.0:
                    begin = max(path - 0.5 * step * speed, nearest)
                    finish = path + 0.5 * step * speed
                    if finish <= begin:
                        continue
                    path = max(path, nearest)
                    within = path * path * (1.0 / begin - 1.0 / finish) / (step * speed)
                elif path < nearest:
                    continue
                gap = path - along
                r2 = 0.5 * (path * path - base2) / gap
                r1 = path - r2
                bx = (r2 * dx - lamp[0]) / r1
                by = (r2 * dy - lamp[1]) / r1
                bz = (r2 * dz - lamp[2]) / r1
                cx = axis[1] * bz - axis[2] * by
                cy = axis[2] * bx - axis[0] * bz
                cz = axis[0] * by - axis[1] * bx
                theta = np.arctan2(np.sqrt(cx * cx + cy * cy + cz * cz), axis[0] * bx + axis[1] * by + axis[2] * bz)
                light = 0.0
                if theta <= edge:
                    x = theta * per
                    j = min(int(x), profile.size - 2)
                    light = profile[j] + (x - j) * (profile[j + 1] - profile[j])
                veil = 0.0
                if forward:
                    veil = halo_value(theta, 0.5 * path, v0, inv_dv, inv_scale, inv_du, rate, shape)
                if light + veil == 0.0:
                    continue
                sx = by * dz - bz * dy
                sy = bz * dx - bx * dz
                sz = bx * dy - by * dx
                turn = np.arctan2(np.sqrt(sx * sx + sy * sy + sz * sz), -(bx * dx + by * dy + bz * dz))
                x = min(max((np.log(max(turn, 1e-12)) - turn0) * inv_turn, 0.0), log_phase.size - 1.0)
                j = min(int(x), log_phase.size - 2)
                light *= np.exp(log_phase[j] + (x - j) * (log_phase[j + 1] - log_phase[j]))
                if veil > 0.0:
                    x = min(turn / np.pi * (soft.shape[1] - 1.0), soft.shape[1] - 1.0)
                    v = min(max((np.log(0.5 * path) - v0) * inv_dv, 0.0), soft.shape[0] - 1.0)
                    j = min(int(x), soft.shape[1] - 2)
                    m = min(int(v), soft.shape[0] - 2)
                    low = soft[m, j] + (x - j) * (soft[m, j + 1] - soft[m, j])
                    high = soft[m + 1, j] + (x - j) * (soft[m + 1, j + 1] - soft[m + 1, j])
                    light += veil * np.exp(low + (v - m) * (high - low))
                slope = (path * gap - 0.5 * (path * path - base2)) / (gap * gap)
                density[i] = within * share * b * light / (r1 * r1) * np.exp(-c * path) * slope * speed
            for k in range(weight.shape[0]):
                total = 0.0
                for i in range(first[k], last[k]):
                    total += weight[k, i] * density[i]
                out[k, p] = total * per_radiance[p]
