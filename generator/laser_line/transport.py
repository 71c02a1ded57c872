"""Paths of light from a sheet to a camera by way of two or more events, traced backward from the camera.

An event is a surface that is met or a scattering. The first event on a path from the laser lies in the sheet, which is so thin that
a path from the camera never finds it by chance: at each event V of a path a beam of the sheet is drawn, by its fan angle φ and its
place across the sheet, and V is joined to both things that the beam does,

- the surface B that it ends on, which shines toward V as its reflection law says;
- the water that it passes: at a place X of the beam, of which V is D away, light turns by ψ toward V. With dr/|X − V|² = dψ/D,

      ∫ b β̃(ψ) e^{−c(r + |X − V|)}/|X − V|² dr = ∫ b β̃(ψ) e^{−c(r + |X − V|)} dψ/D,

  and ψ is drawn with the density of β̃(ψ) (equi-angular sampling, with another density).

Where V itself is a scattering, its place on the path's way is drawn likewise for each B: most of the halo of a line is there.
Fan angles follow the fan's profile in a quarter of the draws, else the density 1/D about the angle at which V (or the end of the
way) lies from the laser, as the integral over ψ does, and places across the sheet likewise; the density of the mixture divides
(balance heuristic).

What the camera sees of the first event alone (the line itself, and the curtain before it) is left out: the other rungs have it in
closed form. Of the first ways of paths at least half are scattered.

Source: E. Veach, Robust Monte Carlo Methods for Light Transport Simulation, 1997, ch. 9 (balance heuristic); C. Kulla and
M. Fajardo, Computer Graphics Forum 31:1519, 2012 (equi-angular sampling).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..paths.phase import free_path
from ..rays.backend import mitsuba
from .device import LineWorld

__all__ = ["Rays", "trace_rest"]

Float = NDArray[np.float64]

#: Events after which a path ends at random, the chances to go on, and the most events.
_FREE_EVENTS, _LEAST, _MOST = 2, 0.05, 0.9
#: The exponent of that fading over that of the light.
_FADING = 2.0
_MOST_EVENTS = 300
#: Share of the fan's own profile in the mixture of angles.
_EVEN = 0.25
#: Share of the paths that leave a surface in water toward the laser.
_AIMED = 0.5
#: Least distance [m] between places that are joined, and farther than any scene, m.
_CLOSE, _FAR = 1e-6, 1e6
#: Standard deviations of the sheet within which beams are drawn near a place.
_MOST_SIGMAS = 5.0
#: A normal number from a uniform one: kept this far from ±1.
_INNER = 1.0 - 1e-6


@dataclass(frozen=True, eq=False)
class Rays:
    """One path each: `origin`, unit `direction` (3, n) of the camera's rays in the scene; `even` (4, n): uniform numbers below one
    that draw the first beams; `state`, `stream` (n): words that seed all other random numbers."""

    origin: Float
    direction: Float
    even: Float
    state: NDArray[np.uint64]
    stream: NDArray[np.uint64]


def trace_rest(world: LineWorld, rays: Rays) -> NDArray[np.float32]:
    """Radiance (n) [1/(m² sr)] per emitted power at the end of each ray, by one path for each."""
    import drjit as dr

    mi = mitsuba()
    count = rays.state.size
    body = _Body(world, rays.even)
    start = (
        mi.PCG32(initstate=mi.UInt64(rays.state), initseq=mi.UInt64(rays.stream)),
        mi.Point3f(*(np.ascontiguousarray(v, np.float32) for v in rays.origin)),
        mi.Vector3f(*(np.ascontiguousarray(v, np.float32) for v in rays.direction)),
        dr.ones(mi.Float, count),
        dr.zeros(mi.UInt32, count),
        dr.zeros(mi.Float, count),
        dr.full(mi.Bool, True, count),
    )
    end = dr.while_loop(start, lambda *state: state[-1], body.step, mode="symbolic")
    light = end[-2]
    dr.eval(light)
    return np.asarray(light.numpy())


def _asinh(x: Any) -> Any:
    """arsinh, which keeps its digits on both sides."""
    import drjit as dr

    size = dr.abs(x)
    return dr.copysign(dr.log(size + dr.sqrt(dr.square(size) + 1.0)), x)


def _across(uniform: Any, half: Any, middle: Any, width: Any) -> tuple[Any, Any]:
    """(place z across the sheet in σ, its Gaussian density over that which it is drawn with).

    It is drawn with the Gaussian where `half`, else with 1/D about `middle`, D² = width² + (z − middle)²."""
    import drjit as dr

    width = dr.maximum(width, 1e-3)
    low, high = (_asinh((side * _MOST_SIGMAS - middle) / width) for side in (-1.0, 1.0))
    near = middle + width * dr.sinh(low + uniform * (high - low))
    z = dr.select(half, 1.41421356 * dr.erfinv(dr.clip(2.0 * uniform - 1.0, -_INNER, _INNER)), near)
    gaussian = 0.39894228 * dr.exp(-0.5 * dr.square(z))
    other = dr.rsqrt(dr.square(z - middle) + dr.square(width)) / dr.maximum(high - low, 1e-12)
    other = dr.select(dr.abs(z) <= _MOST_SIGMAS, other, 0.0)
    return z, gaussian / dr.maximum(0.5 * (gaussian + other), 1e-30)


@dataclass(frozen=True)
class _Event:
    """A surface that is `hit` or a `scattered` place, `point`; `d`: direction of the path that came there."""

    si: Any
    bsdf: Any
    hit: Any
    scattered: Any
    point: Any
    d: Any

    @property
    def met(self) -> Any:
        """Whether there is an event."""
        return self.hit | self.scattered


@dataclass(frozen=True)
class _Beam:
    """A ray of the sheet: unit `direction`; `end`, its length [m]; `lit`, what it ends on where `ends`; `gain`, p(φ) over the
    density that φ was drawn with."""

    direction: Any
    end: Any
    lit: Any
    ends: Any
    gain: Any


class _Body:
    """One event of every path."""

    def __init__(self, world: LineWorld, even: Float) -> None:
        mi = mitsuba()
        self.world = world
        self.even = [mi.Float(np.minimum(v, 1.0 - 1e-7).astype(np.float32)) for v in even]

    def _draws(self, rng: Any, first: Any) -> tuple[Any, list[Any]]:
        """Four uniform numbers: those of the lattice for the first event of a path."""
        import drjit as dr

        return rng, [dr.select(first, even, rng.next_float32()) for even in self.even]

    def step(self, rng: Any, o: Any, d: Any, weight: Any, events: Any, light: Any, alive: Any) -> tuple[Any, ...]:
        """Follow every path to its next event, and add the light that comes there."""
        import drjit as dr

        mi, world = mitsuba(), self.world
        ray = mi.Ray3f(o, d)
        si = world.geometry.ray_intersect(ray, alive)
        hit = si.is_valid() & alive
        far = dr.select(hit, si.t, dr.inf)
        scattered, distance, first = mi.Bool(False), far, events == 0
        if world.phase is not None:
            rng, draws = self._draws(rng, first)
            beam = self._beam(draws, *self._seen_from(dr.select(hit, si.p, o)), alive)
            found = self._along_ray(draws[3], o, d, far, beam, alive)
            light += dr.select(alive, weight * found, 0.0)
            rng, scattered, distance, factor = self._free(rng, far, first)
            weight *= factor
            scattered &= alive
            hit &= ~scattered
        met = hit | scattered
        weight *= dr.select(met, dr.exp(-world.absorption * dr.select(met, distance, 0.0)), 1.0)
        point = dr.select(hit, si.p, ray(dr.select(scattered, distance, 0.0)))
        si.p = point
        event = _Event(si, si.bsdf(), hit, scattered, point, d)
        rng, draws = self._draws(rng, first & hit)
        beam = self._beam(draws, *self._seen_from(point), met)
        # Where the event is a scattering, this light is what `_along_ray` has.
        light += dr.select(hit, weight * self._from_surface(event, beam), 0.0)
        if world.phase is not None:
            light += dr.select(met, weight * self._from_water(draws[3], event, beam), 0.0)
        return self._go_on(rng, event, weight, events, light)

    def _free(self, rng: Any, far: Any, first: Any) -> tuple[Any, Any, Any, Any]:
        """(whether the path is scattered before `far`, where, and what its weight changes by). Of first ways at least half are."""
        import drjit as dr

        chance = 1.0 - dr.exp(-self.world.scattering * dr.minimum(far, _FAR))
        taken = dr.select(first & (chance > 0.0) & (far < _FAR), dr.maximum(chance, 0.5), chance)
        scattered = rng.next_float32() < taken
        free = free_path(dr.minimum(rng.next_float32() * chance, 1.0 - 1e-7), self.world.scattering)
        passing = dr.select(taken < 1.0, (1.0 - chance) / dr.maximum(1.0 - taken, 1e-7), 0.0)
        factor = dr.select(scattered, chance / dr.maximum(taken, 1e-20), passing)
        return rng, scattered, dr.select(scattered, dr.minimum(free, far), far), factor

    def _seen_from(self, point: Any) -> tuple[Any, Any]:
        """(fan angle of a place, signed angle by which it is off the sheet)."""
        import drjit as dr

        sheet = self.world.sheet
        way = point - sheet.source
        x, y = dr.dot(sheet.axis, way), dr.dot(sheet.along, way)
        r = dr.maximum(dr.sqrt(dr.square(x) + dr.square(y)), 1e-4)
        return dr.clip(dr.atan2(y, x), -sheet.reach, sheet.reach), dr.clip(dr.dot(sheet.normal, way) / r, -1.0, 1.0)

    def _beam(self, draws: list[Any], near: Any, off: Any, active: Any) -> _Beam:
        """A beam of the sheet, drawn about a place at the fan angle `near` and `off` the sheet."""
        import drjit as dr

        mi, world = mitsuba(), self.world
        sheet = world.sheet
        uniform, which, third = draws[:3]
        spread = dr.maximum(dr.abs(off), 0.1 * sheet.sigma(world.reached) / world.reached)
        low, high = (_asinh((side * sheet.reach - near) / spread) for side in (-1.0, 1.0))
        close = low + uniform * (high - low)
        phi = dr.select(which < _EVEN, sheet.drawn(uniform), near + spread * dr.sinh(close))
        nearby = dr.rsqrt(dr.square(phi - near) + dr.square(spread)) / (high - low)
        p = sheet.density(phi)
        gain = p / dr.maximum(_EVEN * p + (1.0 - _EVEN) * nearby, 1e-20)
        active = active & (gain > 0.0)
        sine, cosine = dr.sincos(phi)
        middle = sheet.axis * cosine + sheet.along * sine
        first = world.geometry.ray_intersect(mi.Ray3f(sheet.source, middle), active)
        reached = dr.select(first.is_valid(), first.t, 1.0)
        sigma = sheet.sigma(reached)
        half = which * 64.0 - dr.floor(which * 64.0) < 0.5
        across, share = _across(third, half, off * reached / sigma, dr.abs(phi - near) * reached / sigma)
        direction = dr.normalize(middle * reached + sheet.normal * (sigma * across))
        lit = world.geometry.ray_intersect(mi.Ray3f(sheet.source, direction), active)
        hit = lit.is_valid() & active
        return _Beam(direction, dr.select(hit, lit.t, _FAR), lit, hit, dr.select(active, gain * share, 0.0))

    def _turn(self, uniform: Any, start: Any, toward: Any, end: Any, target: Any) -> tuple[Any, Any]:
        """A place on the way from `start` along the unit vector `toward`, as long as `end`, at which light turns by ψ to or from a
        `target` beside it: (distance of the place from the start, weight dψ/D of the draw)."""
        import drjit as dr

        way = target - start
        foot = dr.dot(way, toward)
        aside = dr.maximum(dr.norm(way - toward * foot), _CLOSE)
        least, most = dr.atan2(aside, foot), dr.atan2(aside, foot - end)
        turns = self.world.turns
        assert turns is not None
        psi, per = turns.drawn(uniform, least, most)
        return dr.clip(foot - aside / dr.tan(psi), 0.0, end), per / aside

    def _along_ray(self, uniform: Any, o: Any, d: Any, far: Any, beam: _Beam, active: Any) -> Any:
        """Light of the line on surfaces that is scattered into the way (o, d) and comes to o by it."""
        import drjit as dr

        world = self.world
        assert world.phase is not None
        target = dr.select(beam.ends, beam.lit.p, o + d)
        along, weight = self._turn(uniform, o, d, dr.minimum(far, _FAR), target)
        place = o + d * along
        active = active & beam.ends
        turn = world.phase.density(d, dr.normalize(target - place))
        shone = self._shone(beam, place, active)
        light = beam.gain * world.scattering * turn * shone * dr.exp(-world.attenuation * along) * weight
        return dr.select(active, light, 0.0)

    def _shone(self, beam: _Beam, place: Any, active: Any) -> Any:
        """Intensity [1/sr] of the spot that a beam makes on a surface, in the direction of a place, with the loss on the whole way;
        0 where the place does not see it."""
        import drjit as dr

        mi, lit = mitsuba(), beam.lit
        way = place - lit.p
        gap = dr.maximum(dr.norm(way), _CLOSE)
        lit.wi = lit.to_local(way / gap)
        back = lit.to_local(-beam.direction)
        shone = lit.bsdf().eval(mi.BSDFContext(), lit, back, active)[0]
        shone *= dr.abs(lit.wi.z) / dr.maximum(dr.abs(back.z), 1e-6)
        active = active & (shone > 0.0)
        active &= ~self.world.geometry.ray_test(lit.spawn_ray_to(place), active)
        return dr.select(active, shone * dr.exp(-self.world.attenuation * (beam.end + gap)), 0.0)

    def _from_surface(self, event: _Event, beam: _Beam) -> Any:
        """Light that comes to a surface from the surface that a beam ends on."""
        import drjit as dr

        way = beam.lit.p - event.point
        gap = dr.maximum(dr.norm(way), _CLOSE)
        answer = self._answer(event, way / gap)
        active = event.hit & beam.ends & (answer > 0.0)
        light = beam.gain * answer * self._shone(beam, event.point, active) / dr.square(gap)
        return dr.select(active, light, 0.0)

    def _from_water(self, uniform: Any, event: _Event, beam: _Beam) -> Any:
        """Light that comes to the event from the water that a beam passes."""
        import drjit as dr

        world = self.world
        assert world.phase is not None
        r, weight = self._turn(uniform, world.sheet.source, beam.direction, beam.end, event.point)
        place = world.sheet.source + beam.direction * r
        way = place - event.point
        gap = dr.maximum(dr.norm(way), _CLOSE)
        way /= gap
        answer = self._answer(event, way)
        active = event.met & (answer > 0.0) & (beam.gain > 0.0)
        shadow = event.si.spawn_ray(way)
        shadow.o = dr.select(event.hit, shadow.o, event.point)
        shadow.maxt = gap * (1.0 - 1e-4)
        active &= ~world.geometry.ray_test(shadow, active)
        turned = world.scattering * world.phase.density(beam.direction, -way) * weight
        light = beam.gain * answer * turned * dr.exp(-world.attenuation * (r + gap))
        return dr.select(active, light, 0.0)

    def _answer(self, event: _Event, d: Any) -> Any:
        """f cosθ, or β̃ [1/sr], of the event for light from direction d."""
        import drjit as dr

        answer = event.bsdf.eval(mitsuba().BSDFContext(), event.si, event.si.to_local(d), event.hit)[0]
        if self.world.phase is None:
            return answer
        return dr.select(event.hit, answer, self.world.phase.density(event.d, d))

    def _go_on(self, rng: Any, event: _Event, weight: Any, events: Any, light: Any) -> tuple[Any, ...]:
        """Turn the path by the law of its event, or end it."""
        import drjit as dr

        mi, world, si, hit = mitsuba(), self.world, event.si, event.hit
        pair = mi.Point2f(rng.next_float32(), rng.next_float32())
        sample, gain = event.bsdf.sample(mi.BSDFContext(), si, rng.next_float32(), pair, hit)
        out, kept = si.to_world(sample.wo), gain[0]
        if world.phase is not None:
            # Surfaces send half of the paths toward the laser, about which light arrives that water turned by small angles.
            to_source = dr.normalize(world.sheet.source - event.point)
            aimed = hit & (rng.next_float32() < _AIMED)
            turned, _ = world.phase.draw(dr.select(hit, to_source, event.d), rng.next_uint32(), pair)
            out = dr.select(event.scattered | aimed, turned, out)
            local = si.to_local(out)
            answer = event.bsdf.eval(mi.BSDFContext(), si, local, hit)[0]
            density = (1.0 - _AIMED) * event.bsdf.pdf(mi.BSDFContext(), si, local, hit)
            density += _AIMED * world.phase.density(to_source, out)
            kept = dr.select(hit, dr.select(density > 0.0, answer / density, 0.0), 1.0)
        weight *= kept
        o = dr.select(hit, si.spawn_ray(out).o, event.point)
        events += 1
        # Beyond the line's distance from the laser light fades, and so do the chances to go on.
        beyond = dr.maximum(dr.norm(world.sheet.source - event.point) - world.reached, 0.0)
        going = dr.clip(weight * dr.exp(-_FADING * world.attenuation * beyond), _LEAST, _MOST)
        survive = dr.select(events > _FREE_EVENTS, going, 1.0)
        alive = event.met & (weight > 0.0) & (rng.next_float32() < survive) & (events < _MOST_EVENTS)
        return rng, o, out, weight / survive, events, light, alive
