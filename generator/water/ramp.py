"""Backscatter of the medium itself: the light that is turned back before it reaches the target.

For slice k and a pixel's ray the ramp is

    B_k = K ∫ b [β̃(ψ) I + β̄(ψ, s) I ⊗ h]/r₁² · e^{−c(r₁ + r₂)} · R(n_g(r₁ + r₂)/c − t_k) dr₂   up to the target,

K the photoelectrons per radiance of the pixel, I ⊗ h what was scattered forward on both ways and β̄ its mean turn (one
turn by a large angle, any number by small ones; h = 0 leaves exactly single scattering). All pixels share cells of
arrival time, short near the rig, where the light is steep, and at most a part of a rise of R elsewhere. In every cell R is
expanded once in Legendre polynomials, and each pixel's light is integrated against them by adaptive quadrature
(`ramp_kernel`): for pulses of .1-20 ns, narrow and flat-top beams, with and without a baseline, within .3 % in every slice that
holds 1e-4 of the brightest one's light (tests/test_generator_ramp.py); fainter slices err by up to 3 %.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ...optics.constants import C_M_PER_S
from ...optics.correlation.response import Table, lookup
from ...optics.water.beam import BeamHalo, tabulate_beam_halo
from ...optics.water.halo import softened_phase
from ...optics.water.phase_forms import PhaseFunction, phase_density
from ...scenes.medium_index import group_index
from ...scenes.scene import Scene
from ..rays.lamp import Lamp, RoundBeam
from ..rays.trace import pixel_directions
from ..rays.view import View
from .ramp_kernel import KRONROD_NODE, KRONROD_WEIGHT, MOMENTS, TOLERANCE, ramp_of_pixels

__all__ = ["backscatter_electrons", "nearest_path_m"]

Float = NDArray[np.float64]

#: Cells of arrival time per rise of R (its peak over its steepest slope; 1.65 σ of a Gaussian): polynomials of the third
#: degree then miss 4e-4 of its peak.
_CELLS_PER_RISE = 2.5
#: Near the rig, cells are at most this share of their arrival time long.
_CELL_SHARE = 0.25
#: Long gates: about this many cells at most.
_MOST_CELLS = 1024
#: R is read at so many points of a cell, and at so many per rise in longer ones.
_READINGS, _READINGS_PER_RISE = 16, 12.0
#: Weights below this share of R's greatest are none.
_NO_WEIGHT = 1e-14
_ANGLE_NODES = 2048
_SMALLEST_TURN_RAD = 1e-5
_SOFT_NODES = 181
#: Pixels whose gates open within this share of a rise of R of each other share cells; and how many groups at most.
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
    border = _borders(sight, (low, high), max(low + shift + left.max(), 1e-15))
    weight = _weights(sight, border)
    shown = (weight != 0).any(axis=2)
    first = np.where(shown.any(axis=1), shown.argmax(axis=1), 0)
    last = np.where(shown.any(axis=1), shown.shape[1] - shown[:, ::-1].argmax(axis=1), 0)
    part = np.zeros((len(sight.delay_s), pixel.size), dtype=np.float32)
    beam, halo, medium = view.lamp, water.halo, scene.medium
    ramp_of_pixels(
        direction, np.asarray(beam.position_m), beam.axis, per_radiance, limit, shift + left, border, sight.speed,
        weight.reshape(len(weight), -1), first, last, beam.profile(np.linspace(0.0, beam.edge_rad, 4096)), beam.edge_rad,
        water.log_phase, np.log(_SMALLEST_TURN_RAD), water.per_turn, medium.scattering_per_m, medium.attenuation_per_m,
        nearest_path_m(view), forward, halo.log_range_start, 1.0 / halo.log_range_step, 1.0 / halo.angle_scale_rad,
        1.0 / halo.angle_step, halo.rate_per_m, halo.log_shape, water.soft, KRONROD_NODE, KRONROD_WEIGHT, MOMENTS,
        TOLERANCE, part,
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


def _borders(sight: _Sight, between: tuple[float, float], arrival: float) -> Float:
    """Borders of the cells of gate time between two times, at whose first light arrives at `arrival` after the pulse."""
    begin, end = between
    longest = max(_rise_s(sight.tables) / _CELLS_PER_RISE, (end - begin) / _MOST_CELLS)
    # Cells grow with arrival time until they are as long as R allows.
    turn = min(max(longest / _CELL_SHARE, arrival), arrival + end - begin)
    near = int(np.ceil(np.log(turn / arrival) / np.log1p(_CELL_SHARE)))
    far = int(np.ceil((arrival + end - begin - turn) / longest * (1.0 - 1e-12)))
    first = np.geomspace(arrival, turn, near + 1) if near else np.array([arrival])
    border = np.concatenate([first, np.linspace(turn, arrival + end - begin, far + 1)[1:]])
    return np.asarray(border - arrival + begin, dtype=np.float64)


def _weights(sight: _Sight, border: Float) -> Float:
    """(2m + 1) ⟨R P_m⟩ of every cell for every slice, times its energy (slice, cell, moment)."""
    length = np.diff(border)
    rise = _rise_s(sight.tables)
    readings = int(np.clip(np.ceil(_READINGS_PER_RISE * float(length.max()) / rise), _READINGS, 512))
    node, share = np.polynomial.legendre.leggauss(readings)
    legendre = np.polynomial.legendre.legvander(node, MOMENTS - 1) * (2.0 * np.arange(MOMENTS) + 1.0)
    project = 0.5 * share[:, None] * legendre
    time = border[:-1, None] + 0.5 * length[:, None] * (node + 1.0)
    weight = np.zeros((len(sight.delay_s), length.size, MOMENTS))
    for k in np.flatnonzero(sight.scale > 0):
        table = sight.tables[sight.gate[k]]
        seen = lookup(table, time - sight.delay_s[k])
        weight[k] = np.where(np.abs(seen).max(axis=1) > _NO_WEIGHT * table.value.max(), 1.0, 0.0)[:, None] * (
            seen @ project
        )
        weight[k] *= sight.scale[k]
    return weight


def _flat_halo() -> BeamHalo:
    return BeamHalo(0.0, 1.0, 1.0, 1.0, 0.0, np.full((2, 2), -700.0))


def _rise_s(tables: Sequence[Table]) -> float:
    """Shortest rise of R among the gates [s]: its peak over its steepest slope."""
    return min(float(np.max(table.value) / np.max(np.abs(table.slope))) for table in tables)
