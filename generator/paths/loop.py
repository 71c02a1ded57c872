"""The path tracer's loop: light that reaches the camera after two or more events, with its times.

Paths start at the camera. At each surface or scattering event the lamp's direct light is added (next-event estimation), then
the path goes on by the law there. The first surface's direct light is left out: the `direct` rung has it exactly.

A lane owns one pixel, and draws its samples one after the other. So no two lanes add to the same bin, sums have one order
whatever the threads, and equal seeds give equal bits. Paths that end are replaced at once, so that lanes stay busy.

In water a path from the camera hardly ever finds its way to the lamp through narrow turns. So each event that is the farthest
from the lamp since the last surface is also given the light of a chain of scatterings from the lamp (`chain`),
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
from .growth import as_grown, growth, lamp_as_grown
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
    world: PathWorld,
    lanes: Lanes,
    samples: int,
    window: Window,
    component: str = "all",
    split: bool = False,
    grown: float = 0.0,
) -> Moments:
    """Trace `samples` paths in every lane. With `split`, light without scattering has the first half of twice as many bins,
    light with scattering the second. `grown`: the share by which the targets are larger, to first order (`growth`)."""
    import drjit as dr

    mi = mitsuba()
    count = len(lanes.row)
    wide = window.bins * (2 if split else 1)
    bins = [dr.zeros(mi.Float, count * wide) for _ in range(3)]
    body = _Body(world, lanes, window, component, bins, split, grown)
    wanted = dr.opaque(mi.UInt32, samples)
    state = dr.while_loop(_Path.start(lanes), lambda rng, done, *_: done < wanted, body.step, mode="symbolic")
    total, square = state[-2], state[-1]
    dr.eval(total, square, *bins)
    moments = np.stack([np.asarray(b.numpy()).reshape(count, wide) for b in bins])
    return Moments(moments, np.asarray(total.numpy()), np.asarray(square.numpy()))


@dataclass
class _Path:
    """The state of every lane's path, in the order of the loop's variables."""

    rng: Any
    done: Any  # samples done
    surfaces: Any  # surfaces met by this path
    scatters: Any  # scattering events of this path
    o: Any
    d: Any
    weight: Any
    length: Any
    farthest: Any  # farthest event from the lamp since the last surface, and
    chained: Any  # density of going on from there by a chain, over that of going on by chance
    light: Any  # light of this path
    total: Any
    square: Any

    @staticmethod
    def start(lanes: Lanes) -> tuple[Any, ...]:
        """The loop's variables before the first event."""
        import drjit as dr

        mi, count = mitsuba(), len(lanes.row)
        rng = mi.PCG32(initstate=mi.UInt64(lanes.state), initseq=mi.UInt64(lanes.stream))
        none = [dr.zeros(mi.UInt32, count) for _ in range(3)]
        dark = [dr.zeros(mi.Float, count) for _ in range(6)]
        return (
            rng, *none, dr.zeros(mi.Point3f, count), dr.zeros(mi.Vector3f, count), dr.ones(mi.Float, count), *dark
        )  # fmt: skip


@dataclass(frozen=True)
class _Event:
    """A surface that is `hit` or a scattering event, at `point`; `met`: either; `fresh`: the first of its path; `even`: the
    lattice's numbers of the path."""

    fresh: Any
    even: list[Any]
    si: Any
    bsdf: Any
    hit: Any
    scattered: Any
    met: Any
    point: Any


@dataclass(frozen=True)
class _ToLamp:
    """The way from an event to the lamp: unit `direction`, length `away`; `reach`: chance of a scattering on it; `far`: whether the
    event is the farthest from the lamp since the last surface."""

    direction: Any
    away: Any
    reach: Any
    far: Any


class _Body:
    """One event of every lane's path."""

    def __init__(
        self,
        world: PathWorld,
        lanes: Lanes,
        window: Window,
        component: str,
        bins: list[Any],
        split: bool,
        grown: float,
    ) -> None:
        import drjit as dr

        mi = mitsuba()
        self.world, self.component, self.bins = world, component, bins
        self.row, self.col = mi.Float(lanes.row), mi.Float(lanes.col)
        self.split = split
        self.grown = None if grown == 0.0 else dr.opaque(mi.Float, grown)
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

    def step(self, *state: Any) -> tuple[Any, ...]:
        """Move every path by one event, and add what the lamp gives there."""
        path = _Path(*state)
        event = self._next_event(path)
        lamp = self._direct(path, event)
        if self.world.phase is not None and self.component in ("multiple", "all"):
            self._chained(path, event, lamp)
        self._go_on(path, event, lamp)
        return tuple(vars(path).values())

    def _next_event(self, path: _Path) -> _Event:
        """Begin a path where the last one ended, and follow it to its next surface or scattering event."""
        import drjit as dr

        mi, world = mitsuba(), self.world
        # A new path from a random point of the pixel; pixel centres are at integers.
        fresh = (path.surfaces + path.scatters) == 0
        even = [self._lattice(path.done, j) for j in range(6)]
        x = (self.col + even[0] - self.half_cols) * self.scale
        y = (self.row + even[1] - self.half_rows) * self.scale
        view = dr.normalize(mi.Vector3f(x, y, 1.0))
        path.o, path.d = dr.select(fresh, mi.Point3f(0.0), path.o), dr.select(fresh, view, path.d)
        path.length = dr.select(fresh, 0.0, path.length)
        path.farthest, path.chained = dr.select(fresh, 0.0, path.farthest), dr.select(fresh, 0.0, path.chained)
        first = dr.square(dr.square(view.z)) if world.vignetting else mi.Float(1.0)
        path.weight = dr.select(fresh, first, path.weight)
        ray = mi.Ray3f(path.o, path.d)
        si = world.geometry.ray_intersect(ray)
        hit, distance = si.is_valid(), si.t
        scattered = mi.Bool(False)
        if world.phase is not None:
            free = free_path(dr.select(fresh, even[5], path.rng.next_float32()), world.scattering)
            scattered = free < dr.select(hit, distance, dr.inf)
            hit &= ~scattered
            distance = dr.select(scattered, free, distance)
        met = hit | scattered
        path.weight *= dr.select(met, dr.exp(-world.absorption * distance), 1.0)
        path.length += dr.select(met, distance, 0.0)
        path.surfaces += dr.select(hit, mi.UInt32(1), 0)
        path.scatters += dr.select(scattered, mi.UInt32(1), 0)
        point = dr.select(hit, si.p, ray(dr.select(scattered, distance, 0.0)))
        si.p = point  # spawned rays start here whichever event it is
        return _Event(fresh, even, si, si.bsdf(), hit, scattered, met, point)

    def _direct(self, path: _Path, event: _Event) -> _ToLamp:
        """Add the light that comes from the lamp to the event at once."""
        import drjit as dr

        mi, world = mitsuba(), self.world
        si, hit, context = event.si, event.hit, mi.BSDFContext()
        share = None if self.grown is None else growth()
        to_lamp = lamp_as_grown(world.lamp.position, share, world.phase is not None) - event.point
        away = dr.norm(to_lamp)
        to_lamp /= dr.maximum(away, 1e-12)
        given = path.weight * world.lamp.intensity(-to_lamp) / dr.maximum(dr.square(away), 1e-12)
        given *= dr.exp(-world.attenuation * away)
        reach, far = mi.Float(1.0), mi.Bool(True)
        if world.phase is None:
            given *= dr.select(hit, event.bsdf.eval(context, si, si.to_local(to_lamp), hit)[0], 0.0)
        else:
            turn = world.phase.density(path.d, to_lamp)
            answer = event.bsdf.eval(context, si, si.to_local(to_lamp), hit)[0]
            given *= dr.select(event.scattered, turn, answer)
            far = hit | (away > path.farthest)
            straight = dr.square(away) / (dr.exp(-world.scattering * away) * turn)
            given *= dr.select(far, 1.0, straight / (straight + path.chained))
            reach = chance(world.scattering * away)
        given, length = as_grown(share, self.grown, given, path.length + away, path.scatters, world.attenuation)
        to_lamp, away, reach, far = (dr.detach(one) for one in (to_lamp, away, reach, far))
        wanted = event.met & self._counted(path.surfaces, path.scatters) & (given > 0.0)
        wanted &= length >= self.start
        wanted = self._seen(event, world.lamp.position, wanted & (length < self.longest))
        path.light += self._add(given, length, wanted, path.scatters > 0)
        return _ToLamp(to_lamp, away, reach, far)

    def _seen(self, event: _Event, target: Any, active: Any) -> Any:
        """Whether the event sees a point; of the component "shadow", whether it does not."""
        import drjit as dr

        shadow = event.si.spawn_ray_to(target)
        way = target - event.point
        gap = dr.norm(way)
        shadow.o = dr.select(event.hit, shadow.o, event.point)
        shadow.d = dr.select(event.hit, shadow.d, way / dr.maximum(gap, 1e-12))
        shadow.maxt = dr.select(event.hit, shadow.maxt, gap)
        return active & (self.world.geometry.ray_test(shadow, active) ^ (self.component != "shadow"))

    def _chained(self, path: _Path, event: _Event, lamp: _ToLamp) -> None:
        """Add the light that comes from the lamp to the event by a chain of scatterings."""
        import drjit as dr

        mi, world = mitsuba(), self.world
        assert world.phase is not None
        si, hit, context = event.si, event.hit, mi.BSDFContext()
        room = self.longest - path.length
        open_ = event.met & lamp.far & (lamp.away < room)
        path.rng, came = arrive(
            world,
            path.rng,
            event.point,
            lamp.away,
            room,
            lambda target, active: self._seen(event, target, active),
            open_,
        )
        answer = event.bsdf.eval(context, si, si.to_local(-came.travel), hit)[0]
        answer = dr.select(hit, answer, world.phase.density(path.d, -came.travel))
        pdf = dr.select(hit, event.bsdf.pdf(context, si, si.to_local(-came.travel), hit), answer)
        more = path.weight * answer * came.light * dr.exp(-world.absorption * came.length)
        by_chain = dr.square(lamp.away) * came.cosine / (lamp.reach * pdf)
        by_chance = dr.square(came.radius) / (dr.exp(-world.scattering * came.radius) * came.turn_density)
        more *= dr.select(pdf > 0.0, by_chain / (by_chain + by_chance), 1.0)
        share, events = None if self.grown is None else growth(), path.scatters + came.events
        more, length = as_grown(share, self.grown, more, path.length + came.length, events, world.attenuation)
        path.light += self._add(more, length, open_ & (more > 0.0), mi.Bool(True))

    def _go_on(self, path: _Path, event: _Event, lamp: _ToLamp) -> None:
        """Turn the path by the law of its event, or end it and count its light."""
        import drjit as dr

        mi, world, si, hit = mitsuba(), self.world, event.si, event.hit
        draw, one, two = (dr.select(event.fresh, e, path.rng.next_float32()) for e in event.even[2:5])
        pair = mi.Point2f(one, two)
        sample, gain = event.bsdf.sample(mi.BSDFContext(), si, draw, pair, hit)
        out, kept, density = si.to_world(sample.wo), gain[0], sample.pdf
        if world.phase is not None:
            turned, turned_density = world.phase.draw(path.d, path.rng.next_uint32(), pair)
            out = dr.select(event.scattered, turned, out)
            density = dr.select(event.scattered, turned_density, density)
            kept = dr.select(event.scattered, 1.0, kept)
            inward = dr.maximum(dr.dot(out, lamp.direction), 0.0)
            chained = dr.square(lamp.away) * inward / (lamp.reach * density)
            path.chained = dr.select(lamp.far, chained, path.chained)
            path.farthest = dr.select(lamp.far, lamp.away, path.farthest)
        path.weight *= kept
        onward = si.spawn_ray(out)
        path.o = dr.select(hit, onward.o, event.point)
        path.d = dr.select(event.met, out, path.d)
        events = path.surfaces + path.scatters
        survive = dr.select(events > _FREE_EVENTS, dr.clip(kept, 0.05, 0.99), 1.0)
        alive = event.met & (path.weight > 0.0) & (path.rng.next_float32() < survive) & (events < _MOST_EVENTS)
        # No way to the lamp is shorter than the straight one.
        alive &= path.length + lamp.away < self.longest
        if self.component in _ONE_EVENT:
            alive = mi.Bool(False)
        path.weight = path.weight / survive
        ended = ~alive
        path.total = path.total + dr.select(ended, path.light, 0.0)
        path.square = path.square + dr.select(ended, dr.square(path.light), 0.0)
        path.done = path.done + dr.select(ended, mi.UInt32(1), 0)
        zero = mi.UInt32(0)
        path.surfaces, path.scatters = dr.select(ended, zero, path.surfaces), dr.select(ended, zero, path.scatters)
        path.light = dr.select(ended, 0.0, path.light)

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
        """Whether the light of a path with these events belongs to the component."""
        if self.component == "interreflection":
            return (scatters == 0) & (surfaces >= 2)
        if self.component in _ONE_EVENT:
            return (scatters == 1) & (surfaces == 0)
        several = surfaces + scatters >= 2
        return several & (scatters >= 1) if self.component == "multiple" else several
