"""The path tracer's loop: light that reaches the camera after two or more events, with its times.

Paths start at the camera. At each surface or scattering event the lamp is asked directly (next-event estimation), then
the path goes on by the law there. The first surface's direct answer is left out: the `direct` rung has it exactly.

A lane owns one pixel, and draws its samples one after the other. So no two lanes add to the same bin, sums have one order
whatever the threads, and equal seeds give equal bits. Paths that end are replaced at once, so that lanes stay busy.

In water a path from the camera hardly ever finds its way to the lamp through narrow turns. So each event that is the farthest
from the lamp since the last surface is also given the light of a chain of scatterings from the lamp (`path_chain`),
which needs no luck. A path whose farthest event since the last surface is not its last one can be made both ways, by the
lamp's direct answer at the last event or by a chain at the farthest; each is weighted by its density over the sum of both
(Veach's balance heuristic), so that neither narrow turns nor events close to the lamp weigh much.

The six numbers that choose a path's start and first event come from a lattice, shifted at random in every lane: unbiased,
and more even than independent numbers.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..rays.backend import mitsuba
from .chain import arrive, chance
from .phase import free_path
from .world import PathWorld

__all__ = ["COMPONENTS", "Lanes", "Moments", "Window", "trace_lanes"]

#: Kinds of light: two or more surfaces; one scattering event and no surface; any other with scattering; the first and the
#: third; and single scattering that does not happen, because a surface keeps the lamp from the water.
COMPONENTS = ("interreflection", "single", "multiple", "all", "shadow")

_ONE_EVENT = ("single", "shadow")

#: Steps of a lattice in six dimensions (Roberts 2018): powers of 1/φ₆, φ₆⁷ = φ₆ + 1, as fractions of 2³².
_LATTICE = tuple(round((1.1127756842787055**-k % 1.0) * 2**32) for k in range(1, 7))

#: Events after which paths end at random.
_FREE_EVENTS = 3
_MOST_EVENTS = 400


@dataclass(frozen=True)
class Window:
    """Optical path lengths that are kept [m]: `bins` of `width_m` from `start_m`."""

    start_m: float
    width_m: float
    bins: int


@dataclass(frozen=True)
class Lanes:
    """One lane each: pixel coordinates, and two words that seed its random numbers."""

    row: NDArray[np.uint32]
    col: NDArray[np.uint32]
    state: NDArray[np.uint64]
    stream: NDArray[np.uint64]


@dataclass(frozen=True)
class Moments:
    """Sums over samples. `bins` (3, lanes, bins): light, light·x and light·x² with x = −½ … ½ across the bin; `total` and
    `square` (lanes): a sample's light inside the window and its square."""

    bins: NDArray[np.float32]
    total: NDArray[np.float32]
    square: NDArray[np.float32]


def trace_lanes(
    world: PathWorld, lanes: Lanes, samples: int, window: Window, component: str = "all", split: bool = False
) -> Moments:
    """Trace `samples` paths in every lane. With `split`, light without scattering has the first half of twice as many bins,
    light with scattering the second."""
    import drjit as dr

    mi = mitsuba()
    count = len(lanes.row)
    wide = window.bins * (2 if split else 1)
    bins = [dr.zeros(mi.Float, count * wide) for _ in range(3)]
    body = _Body(world, lanes, window, component, bins, split)
    wanted = dr.opaque(mi.UInt32, samples)
    state = (
        mi.PCG32(initstate=mi.UInt64(lanes.state), initseq=mi.UInt64(lanes.stream)),
        dr.zeros(mi.UInt32, count),  # samples done
        dr.zeros(mi.UInt32, count),  # surfaces met by this path
        dr.zeros(mi.UInt32, count),  # scattering events of this path
        dr.zeros(mi.Point3f, count),
        dr.zeros(mi.Vector3f, count),
        dr.ones(mi.Float, count),  # weight
        dr.zeros(mi.Float, count),  # length
        dr.zeros(mi.Float, count),  # farthest event from the lamp since the last surface, and
        dr.zeros(mi.Float, count),  # density of going on from there by a chain, over that of going on by chance
        dr.zeros(mi.Float, count),  # light of this path
        dr.zeros(mi.Float, count),
        dr.zeros(mi.Float, count),
    )
    state = dr.while_loop(state, lambda rng, done, *_: done < wanted, body.step, mode="symbolic")
    total, square = state[-2], state[-1]
    dr.eval(total, square, *bins)
    moments = np.stack([np.asarray(b.numpy()).reshape(count, wide) for b in bins])
    return Moments(moments, np.asarray(total.numpy()), np.asarray(square.numpy()))


class _Body:
    """One event of every lane's path."""

    def __init__(
        self, world: PathWorld, lanes: Lanes, window: Window, component: str, bins: list[Any], split: bool
    ) -> None:
        import drjit as dr

        mi = mitsuba()
        self.world, self.component, self.bins = world, component, bins
        self.row, self.col = mi.Float(lanes.row), mi.Float(lanes.col)
        self.split = split
        self.base = dr.arange(mi.UInt32, len(lanes.row)) * (window.bins * (2 if split else 1))
        self.start, self.per_metre = dr.opaque(mi.Float, window.start_m), dr.opaque(mi.Float, 1.0 / window.width_m)
        words = [
            mi.sample_tea_64(mi.UInt32(mi.UInt64(w) & 0xFFFFFFFF), mi.UInt32(mi.UInt64(w) >> 32))
            for w in (lanes.state, lanes.stream)
        ]
        shift = [mi.UInt32(w & 0xFFFFFFFF) for w in words] + [mi.UInt32(w >> 32) for w in words]
        self.shift = [*shift, shift[0] ^ (shift[3] * 747796405), shift[1] ^ (shift[2] * 747796405)]
        self.last = dr.opaque(mi.UInt32, window.bins)
        self.longest = dr.opaque(mi.Float, window.start_m + window.width_m * window.bins)
        self.scale = dr.opaque(mi.Float, world.pitch_over_focal)
        self.half_rows, self.half_cols = (dr.opaque(mi.Float, n / 2) for n in (world.rows, world.cols))

    def step(
        self, rng: Any, done: Any, surfaces: Any, scatters: Any, o: Any, d: Any, weight: Any, length: Any, farthest: Any,
        chained: Any, light: Any, total: Any, square: Any,
    ) -> tuple[Any, ...]:  # fmt: skip
        """Move every path by one event, and add what the lamp gives there."""
        import drjit as dr

        mi, world = mitsuba(), self.world
        # A new path from a random point of the pixel; pixel centres are at integers.
        fresh = (surfaces + scatters) == 0
        even = [self._lattice(done, j) for j in range(6)]
        x = (self.col + even[0] - self.half_cols) * self.scale
        y = (self.row + even[1] - self.half_rows) * self.scale
        view = dr.normalize(mi.Vector3f(x, y, 1.0))
        o, d = dr.select(fresh, mi.Point3f(0.0), o), dr.select(fresh, view, d)
        length = dr.select(fresh, 0.0, length)
        farthest, chained = dr.select(fresh, 0.0, farthest), dr.select(fresh, 0.0, chained)
        first = dr.square(dr.square(view.z)) if world.vignetting else mi.Float(1.0)
        weight = dr.select(fresh, first, weight)
        ray = mi.Ray3f(o, d)
        si = world.geometry.ray_intersect(ray)
        hit, distance = si.is_valid(), si.t
        scattered = mi.Bool(False)
        if world.phase is not None:
            free = free_path(dr.select(fresh, even[5], rng.next_float32()), world.scattering)
            scattered = free < dr.select(hit, distance, dr.inf)
            hit &= ~scattered
            distance = dr.select(scattered, free, distance)
        event = hit | scattered
        weight *= dr.select(event, dr.exp(-world.absorption * distance), 1.0)
        length += dr.select(event, distance, 0.0)
        surfaces += dr.select(hit, mi.UInt32(1), 0)
        scatters += dr.select(scattered, mi.UInt32(1), 0)
        point = dr.select(hit, si.p, ray(dr.select(scattered, distance, 0.0)))
        si.p = point  # spawned rays start here whichever event it is

        # Ask the lamp.
        bsdf, context = si.bsdf(), mi.BSDFContext()
        to_lamp = world.lamp.position - point
        away = dr.norm(to_lamp)
        to_lamp /= dr.maximum(away, 1e-12)
        given = weight * world.lamp.intensity(-to_lamp) / dr.maximum(dr.square(away), 1e-12)
        given *= dr.exp(-world.attenuation * away)
        reach, far, turn = mi.Float(1.0), mi.Bool(True), mi.Float(0.0)
        if world.phase is None:
            given *= dr.select(hit, bsdf.eval(context, si, si.to_local(to_lamp), hit)[0], 0.0)
        else:
            turn = world.phase.density(d, to_lamp)
            given *= dr.select(scattered, turn, bsdf.eval(context, si, si.to_local(to_lamp), hit)[0])
            far = hit | (away > farthest)
            straight = dr.square(away) / (dr.exp(-world.scattering * away) * turn)
            given *= dr.select(far, 1.0, straight / (straight + chained))
            reach = chance(world.scattering * away)
        wanted = event & self._counted(surfaces, scatters) & (given > 0.0)
        wanted &= length + away >= self.start

        def seen(target: Any, active: Any) -> Any:
            shadow = si.spawn_ray_to(target)
            way = target - point
            gap = dr.norm(way)
            shadow.o = dr.select(hit, shadow.o, point)
            shadow.d = dr.select(hit, shadow.d, way / dr.maximum(gap, 1e-12))
            shadow.maxt = dr.select(hit, shadow.maxt, gap)
            return active & (world.geometry.ray_test(shadow, active) ^ (self.component != "shadow"))

        wanted = seen(world.lamp.position, wanted & (length + away < self.longest))
        light += self._add(given, length + away, wanted, scatters > 0)

        # Bring the lamp's scattered light.
        if world.phase is not None and self.component in ("multiple", "all"):
            room = self.longest - length
            open_ = event & far & (away < room)
            rng, came = arrive(world, rng, point, away, room, seen, open_)
            answer = bsdf.eval(context, si, si.to_local(-came.travel), hit)[0]
            answer = dr.select(hit, answer, world.phase.density(d, -came.travel))
            pdf = dr.select(hit, bsdf.pdf(context, si, si.to_local(-came.travel), hit), answer)
            more = weight * answer * came.light * dr.exp(-world.absorption * came.length)
            by_chain = dr.square(away) * came.cosine / (reach * pdf)
            by_chance = dr.square(came.radius) / (dr.exp(-world.scattering * came.radius) * came.turn_density)
            more *= dr.select(pdf > 0.0, by_chain / (by_chain + by_chance), 1.0)
            light += self._add(more, length + came.length, open_ & (more > 0.0), mi.Bool(True))

        # Go on.
        draw, one, two = (dr.select(fresh, e, rng.next_float32()) for e in even[2:5])
        pair = mi.Point2f(one, two)
        sample, gain = bsdf.sample(context, si, draw, pair, hit)
        out, kept, density = si.to_world(sample.wo), gain[0], sample.pdf
        if world.phase is not None:
            turned, turned_density = world.phase.draw(d, rng.next_uint32(), pair)
            out = dr.select(scattered, turned, out)
            density = dr.select(scattered, turned_density, density)
            kept = dr.select(scattered, 1.0, kept)
            inward = dr.maximum(dr.dot(out, to_lamp), 0.0)
            chained = dr.select(far, dr.square(away) * inward / (reach * density), chained)
            farthest = dr.select(far, away, farthest)
        weight *= kept
        onward = si.spawn_ray(out)
        o = dr.select(hit, onward.o, point)
        d = dr.select(event, out, d)
        survive = dr.select(surfaces + scatters > _FREE_EVENTS, dr.clip(kept, 0.05, 0.99), 1.0)
        alive = event & (weight > 0.0) & (rng.next_float32() < survive) & (surfaces + scatters < _MOST_EVENTS)
        # No way to the lamp is shorter than the straight one.
        alive &= length + away < self.longest
        if self.component in _ONE_EVENT:
            alive = mi.Bool(False)
        weight = weight / survive
        ended = ~alive
        total = total + dr.select(ended, light, 0.0)
        square = square + dr.select(ended, dr.square(light), 0.0)
        done = done + dr.select(ended, mi.UInt32(1), 0)
        zero = mi.UInt32(0)
        surfaces, scatters = dr.select(ended, zero, surfaces), dr.select(ended, zero, scatters)
        light = dr.select(ended, 0.0, light)
        return rng, done, surfaces, scatters, o, d, weight, length, farthest, chained, light, total, square

    def _add(self, light: Any, path: Any, wanted: Any, by_water: Any) -> Any:
        """Put light of this path length into its bin; the light that had one."""
        import drjit as dr

        mi = mitsuba()
        where = (path - self.start) * self.per_metre
        wanted = wanted & (where >= 0.0)
        index = mi.UInt32(dr.select(wanted, where, 0.0))
        wanted &= index < self.last
        offset = where - mi.Float(index) - 0.5
        place = self.base + index
        if self.split:
            place += dr.select(by_water, self.last, 0)
        for power, target in enumerate(self.bins):
            value = light * offset**power if power else light
            dr.scatter_reduce(dr.ReduceOp.Add, target, value, place, wanted, dr.ReduceMode.NoConflicts)
        return dr.select(wanted, light, 0.0)

    def _lattice(self, sample: Any, dimension: int) -> Any:
        """Coordinate of a lattice point, 0 ≤ x < 1."""
        mi = mitsuba()
        word = self.shift[dimension] + sample * mi.UInt32(_LATTICE[dimension])
        return mi.Float(word >> 8) * (1.0 / 16777216.0)

    def _counted(self, surfaces: Any, scatters: Any) -> Any:
        """Whether a path with these events belongs to the light asked for."""
        if self.component == "interreflection":
            return (scatters == 0) & (surfaces >= 2)
        if self.component in _ONE_EVENT:
            return (scatters == 1) & (surfaces == 0)
        several = surfaces + scatters >= 2
        return several & (scatters >= 1) if self.component == "multiple" else several
