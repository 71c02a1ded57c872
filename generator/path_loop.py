"""The path tracer's loop: light that reaches the camera after two or more events, with its times.

Paths start at the camera. At each surface or scattering event the lamp is asked directly (next-event estimation), then
the path goes on by the law there. The first surface's direct answer is left out: the `direct` rung has it exactly.

A lane owns one pixel, and draws its samples one after the other. So no two lanes add to the same bin, sums have one order
whatever the threads, and equal seeds give equal bits. Paths that end are replaced at once, so that lanes stay busy.

In water, paths that turn straight at the lamp carry most light, and are hardly ever drawn by reflection alone: half the
directions are drawn by the phase function about the direction to the lamp, weighted by the mixture's density.

The five numbers that choose a path's start and first turn come from a lattice, shifted at random in every lane: unbiased,
and more even than independent numbers.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .backend import mitsuba
from .path_world import PathWorld

__all__ = ["COMPONENTS", "Lanes", "Moments", "Window", "trace_lanes"]

#: Kinds of light: two or more surfaces; one scattering event and no surface; any other with scattering; all of them.
COMPONENTS = ("interreflection", "single", "multiple", "all")

#: Steps of a lattice in five dimensions (Roberts 2018): powers of 1/φ₅, φ₅⁶ = φ₅ + 1, as fractions of 2³².
_LATTICE = tuple(round((1.1347241384015194**-k % 1.0) * 2**32) for k in range(1, 6))

#: Share of directions drawn toward the lamp in a scattering medium: at surfaces; at scattering events of light on the way
#: to the lamp; and of light on the way from it. Weights grow by 1/(1 − share) at each event, so it is small where many
#: follow; without it a direction that meets the lamp by chance would weigh as much as the peak of the phase function.
_TOWARD_LAMP = (0.5, 0.3, 0.1)
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


def trace_lanes(world: PathWorld, lanes: Lanes, samples: int, window: Window, component: str = "all") -> Moments:
    """Trace `samples` paths in every lane."""
    import drjit as dr

    mi = mitsuba()
    count = len(lanes.row)
    bins = [dr.zeros(mi.Float, count * window.bins) for _ in range(3)]
    body = _Body(world, lanes, window, component, bins)
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
        dr.zeros(mi.Float, count),  # light of this path
        dr.zeros(mi.Float, count),
        dr.zeros(mi.Float, count),
    )
    state = dr.while_loop(state, lambda rng, done, *_: done < wanted, body.step, mode="symbolic")
    total, square = state[-2], state[-1]
    dr.eval(total, square, *bins)
    moments = np.stack([np.asarray(b.numpy()).reshape(count, window.bins) for b in bins])
    return Moments(moments, np.asarray(total.numpy()), np.asarray(square.numpy()))


class _Body:
    """One event of every lane's path."""

    def __init__(self, world: PathWorld, lanes: Lanes, window: Window, component: str, bins: list[Any]) -> None:
        import drjit as dr

        mi = mitsuba()
        self.world, self.component, self.bins = world, component, bins
        self.row, self.col = mi.Float(lanes.row), mi.Float(lanes.col)
        self.base = dr.arange(mi.UInt32, len(lanes.row)) * window.bins
        self.start, self.per_metre = dr.opaque(mi.Float, window.start_m), dr.opaque(mi.Float, 1.0 / window.width_m)
        words = [
            mi.sample_tea_64(mi.UInt32(mi.UInt64(w) & 0xFFFFFFFF), mi.UInt32(mi.UInt64(w) >> 32))
            for w in (lanes.state, lanes.stream)
        ]
        shift = [mi.UInt32(w & 0xFFFFFFFF) for w in words] + [mi.UInt32(w >> 32) for w in words]
        self.shift = [*shift, shift[0] ^ (shift[3] * 747796405)]
        self.last = dr.opaque(mi.UInt32, window.bins)
        self.longest = dr.opaque(mi.Float, window.start_m + window.width_m * window.bins)
        self.scale = dr.opaque(mi.Float, world.pitch_over_focal)
        self.half_rows, self.half_cols = (dr.opaque(mi.Float, n / 2) for n in (world.rows, world.cols))

    def step(
        self, rng: Any, done: Any, surfaces: Any, scatters: Any, o: Any, d: Any, weight: Any, length: Any, light: Any,
        total: Any, square: Any,
    ) -> tuple[Any, ...]:  # fmt: skip
        """Move every path by one event, and add what the lamp gives there."""
        import drjit as dr

        mi, world = mitsuba(), self.world
        # A new path from a random point of the pixel; pixel centres are at integers.
        fresh = (surfaces + scatters) == 0
        even = [self._lattice(done, j) for j in range(5)]
        x = (self.col + even[0] - self.half_cols) * self.scale
        y = (self.row + even[1] - self.half_rows) * self.scale
        view = dr.normalize(mi.Vector3f(x, y, 1.0))
        o, d = dr.select(fresh, mi.Point3f(0.0), o), dr.select(fresh, view, d)
        length = dr.select(fresh, 0.0, length)
        first = dr.square(dr.square(view.z)) if world.vignetting else mi.Float(1.0)
        weight = dr.select(fresh, first, weight)
        ray = mi.Ray3f(o, d)
        si = world.geometry.ray_intersect(ray)
        hit, distance = si.is_valid(), si.t
        scattered = mi.Bool(False)
        if world.phase is not None:
            free = -dr.log(1.0 - rng.next_float32()) / world.attenuation
            scattered = free < dr.select(hit, distance, dr.inf)
            hit &= ~scattered
            distance = dr.select(scattered, free, distance)
            weight = dr.select(scattered, weight * world.scattering / world.attenuation, weight)
        else:
            weight *= dr.select(hit, dr.exp(-world.attenuation * distance), 1.0)
        event = hit | scattered
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
        answer = dr.select(hit, bsdf.eval(context, si, si.to_local(to_lamp), hit)[0], 0.0)
        if world.phase is not None:
            answer = dr.select(scattered, world.phase.density(d, to_lamp), answer)
        given = weight * answer * world.lamp.intensity(-to_lamp) / dr.maximum(dr.square(away), 1e-12)
        given *= dr.exp(-world.attenuation * away)
        where = (length + away - self.start) * self.per_metre
        wanted = event & self._counted(surfaces, scatters) & (given > 0.0) & (where >= 0.0)
        index = mi.UInt32(dr.select(wanted, where, 0.0))
        wanted &= index < self.last
        shadow = si.spawn_ray_to(world.lamp.position)
        free_ray = mi.Ray3f(point, to_lamp, away * (1.0 - 1e-4), 0.0, mi.Color0f())
        shadow.o, shadow.d = dr.select(hit, shadow.o, free_ray.o), dr.select(hit, shadow.d, free_ray.d)
        shadow.maxt = dr.select(hit, shadow.maxt, free_ray.maxt)
        wanted &= ~world.geometry.ray_test(shadow, wanted)
        given = dr.select(wanted, given, 0.0)
        offset = where - mi.Float(index) - 0.5
        for power, target in enumerate(self.bins):
            value = given * offset**power if power else given
            dr.scatter_reduce(dr.ReduceOp.Add, target, value, self.base + index, wanted, dr.ReduceMode.NoConflicts)
        light = light + given

        # Go on.
        draw, one, two = (dr.select(fresh, e, rng.next_float32()) for e in even[2:])
        pair = mi.Point2f(one, two)
        out, gain, kept = self._next(rng, si, bsdf, context, d, to_lamp, hit, scattered, draw, pair)
        weight = weight * gain
        onward = si.spawn_ray(out)
        o = dr.select(hit, onward.o, point)
        d = dr.select(event, out, d)
        survive = dr.select(surfaces + scatters > _FREE_EVENTS, dr.clip(kept, 0.05, 0.99), 1.0)
        alive = event & (weight > 0.0) & (rng.next_float32() < survive) & (surfaces + scatters < _MOST_EVENTS)
        # No way to the lamp is shorter than the straight one.
        alive &= length + away < self.longest
        weight = weight / survive
        ended = ~alive
        total = total + dr.select(ended, light, 0.0)
        square = square + dr.select(ended, dr.square(light), 0.0)
        done = done + dr.select(ended, mi.UInt32(1), 0)
        zero = mi.UInt32(0)
        surfaces, scatters = dr.select(ended, zero, surfaces), dr.select(ended, zero, scatters)
        light = dr.select(ended, 0.0, light)
        return rng, done, surfaces, scatters, o, d, weight, length, light, total, square

    def _lattice(self, sample: Any, dimension: int) -> Any:
        """Coordinate of a lattice point, 0 ≤ x < 1."""
        mi = mitsuba()
        word = self.shift[dimension] + sample * mi.UInt32(_LATTICE[dimension])
        return mi.Float(word >> 8) * (1.0 / 16777216.0)

    def _counted(self, surfaces: Any, scatters: Any) -> Any:
        """Whether a path with these events belongs to the light asked for."""
        if self.component == "interreflection":
            return (scatters == 0) & (surfaces >= 2)
        if self.component == "single":
            return (scatters == 1) & (surfaces == 0)
        several = surfaces + scatters >= 2
        return several & (scatters >= 1) if self.component == "multiple" else several | (scatters >= 1)

    def _next(
        self, rng: Any, si: Any, bsdf: Any, context: Any, d: Any, to_lamp: Any, hit: Any, scattered: Any, draw: Any,
        pair: Any,
    ) -> tuple[Any, Any, Any]:  # fmt: skip
        """The next direction, value over density there, and the share of light that the event keeps.

        The latter decides on the path's end. The path's own weight must not: drawn toward the lamp it is small just where
        the lamp's answer is large.
        """
        import drjit as dr

        mi, phase = mitsuba(), self.world.phase
        sample, weight = bsdf.sample(context, si, draw, pair, hit)
        out, gain = si.to_world(sample.wo), weight[0]
        if phase is None:
            return out, dr.select(hit, gain, 0.0), gain
        kept = dr.select(scattered, self.world.scattering / self.world.attenuation, gain)
        ahead = dr.select(dr.dot(d, to_lamp) > 0.0, mi.Float(_TOWARD_LAMP[1]), _TOWARD_LAMP[2])
        share = dr.select(scattered, ahead, _TOWARD_LAMP[0])
        guided = rng.next_float32() < share
        about = dr.select(guided, to_lamp, d)
        drawn = phase.sample(about, draw, pair)
        out = dr.select(scattered | guided, drawn, out)
        local = si.to_local(out)
        own = dr.select(scattered, phase.density(d, out), bsdf.pdf(context, si, local, hit))
        value = dr.select(scattered, phase.density(d, out), bsdf.eval(context, si, local, hit)[0])
        density = share * phase.density(to_lamp, out) + (1.0 - share) * own
        return out, dr.select((hit | scattered) & (density > 0.0), value / density, 0.0), kept
