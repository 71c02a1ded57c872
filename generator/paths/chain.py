"""The lamp's light after any number of scatterings, brought to a point: chains drawn from the lamp and turned about it.

In an even medium the light of a lamp that shines evenly to all sides is the same on all of a sphere about it. So a chain
of scatterings is drawn from the lamp without a goal, up to its first way out of the ball of radius r = |x − lamp|, and
then turned about the lamp, with the place where it leaves, onto x. Nothing is connected at a small angle or a small
distance: the irradiance that the chain brings to a surface is

    E = (1 − e^{−br}) I(θ) e^{−aL} cosθ_x / (r² μ),

with L its length, μ the cosine between its last step and the sphere's normal, θ_x its angle to the surface, I(θ) the lamp's
radiant intensity where the turned chain starts. The first factor is the chance of a scattering on the way: chains without
one are left to the straight connection. Solids in the way are met by following the turned chain a second time.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from ..rays.backend import mitsuba
from .phase import free_path

if TYPE_CHECKING:
    from .world import PathWorld

__all__ = ["Arrival", "arrive", "chance"]


@dataclass(frozen=True)
class Arrival:
    """Light that a chain brings to a point x. `travel`: its direction there; `length` of the chain; `light`: the factor above
    without e^{−aL} and cosθ_x; `cosine` μ; `events` of scattering; `turn_density` of the first turn [1/sr], and
    `radius`: distance of the first event from the lamp. `light` is zero where nothing comes."""

    travel: Any
    length: Any
    light: Any
    events: Any
    cosine: Any
    turn_density: Any
    radius: Any


def chance(depth: Any) -> Any:
    """1 − e^{−x} without loss of digits."""
    import drjit as dr

    series = depth * (1.0 - depth / 2.0 * (1.0 - depth / 3.0 * (1.0 - depth / 4.0)))
    return dr.select(depth < 0.05, series, 1.0 - dr.exp(-depth))


@dataclass(frozen=True)
class _Chain:
    """A chain from a lamp at the origin that shines along z, up to its way out of the ball of radius r. `place` and `travel` of the
    way out, `length`, `events`; `first`: distance, direction after it and density of the first turn; `good`: whether it
    leaves the ball within the room; `keep`: random numbers that follow the same chain again."""

    place: Any
    travel: Any
    length: Any
    events: Any
    first: tuple[Any, Any, Any]
    good: Any
    keep: Any


def arrive(
    world: PathWorld, rng: Any, x: Any, away: Any, room: Any, start_ray: Any, active: Any
) -> tuple[Any, Arrival]:
    """One chain for each lane.

    Main arguments:
        rng: random numbers (returned advanced); x, away: the point and its distance from the lamp.
        room: chains longer than this are not wanted.
        start_ray: function of a target point and a mask: whether x sees it.
    """
    import drjit as dr

    mi = mitsuba()
    reach = chance(world.scattering * away)
    rng, chain = _drawn(world, rng, away, reach, room, active)
    # Turn the place of leaving onto x, and by an even angle about it.
    normal = chain.place / dr.maximum(away, 1e-12)
    mu = dr.maximum(dr.dot(normal, chain.travel), 0.0)
    sin_phi, cos_phi = dr.sincos(2.0 * dr.pi * rng.next_float32())
    here, there = mi.Frame3f(normal), mi.Frame3f((x - world.lamp.position) / dr.maximum(away, 1e-12))

    def turn(v: Any) -> Any:
        w = here.to_local(v)
        return there.to_world(mi.Vector3f(cos_phi * w.x - sin_phi * w.y, sin_phi * w.x + cos_phi * w.y, w.z))

    travel, emitted = turn(chain.travel), turn(mi.Vector3f(0.0, 0.0, 1.0))
    light = reach * world.lamp.intensity(emitted) / (dr.square(away) * mu)
    good = chain.good & (light > 0.0) & (mu > 0.0)
    end, clear = _clear(world, chain, turn, good)
    clear &= start_ray(world.lamp.position + turn(end), clear)
    radius, _, density = chain.first
    return rng, Arrival(travel, chain.length, dr.select(clear, light, 0.0), chain.events, mu, density, radius)


def _drawn(world: PathWorld, rng: Any, away: Any, reach: Any, room: Any, active: Any) -> tuple[Any, _Chain]:
    """A chain for each lane, with at least one scattering within the ball of radius `away`."""
    import drjit as dr

    mi, phase, b = mitsuba(), world.phase, world.scattering
    assert phase is not None
    first = dr.minimum(-dr.log(1.0 - rng.next_float32() * reach) / b, away)
    d, density = phase.draw(
        mi.Vector3f(0.0, 0.0, 1.0), rng.next_uint32(), mi.Point2f(rng.next_float32(), rng.next_float32())
    )
    keep = mi.PCG32(rng)
    p = mi.Vector3f(0.0, 0.0, first)
    r2 = dr.square(away)

    def forth(rng: Any, p: Any, d: Any, length: Any, events: Any, going: Any, out: Any) -> tuple[Any, ...]:
        step = free_path(rng.next_float32(), b)
        along = dr.dot(p, d)
        leave = dr.safe_sqrt(dr.square(along) + r2 - dr.squared_norm(p)) - along
        crosses = step >= leave
        step = dr.minimum(step, leave)
        p = p + d * step
        length = length + step
        turned, _ = phase.draw(d, rng.next_uint32(), mi.Point2f(rng.next_float32(), rng.next_float32()))
        out = out | crosses
        going = going & ~crosses & (length < room)
        d = dr.select(crosses, d, turned)
        events = events + dr.select(crosses, mi.UInt32(0), 1)
        return rng, p, d, length, events, going, out

    state = (rng, p, d, first, mi.UInt32(1), mi.Bool(active), mi.Bool(False))
    state = dr.while_loop(state, lambda rng, p, d, length, events, going, out: going, forth, mode="symbolic")
    rng, p, last, length, events, _, out = state
    return rng, _Chain(p, last, length, events, (first, d, density), active & out & (length < room), keep)


def _clear(world: PathWorld, chain: _Chain, turn: Any, good: Any) -> tuple[Any, Any]:
    """(the last event of the chain, about the lamp; whether no solid is in the way of the turned chain up to there)."""
    import drjit as dr

    mi, phase = mitsuba(), world.phase
    assert phase is not None
    first, d, _ = chain.first

    def again(rng: Any, i: Any, before: Any, at: Any, d: Any, clear: Any) -> tuple[Any, ...]:
        way = turn(at - before)
        distance = dr.norm(way)
        ray = mi.Ray3f(
            world.lamp.position + turn(before), way / dr.maximum(distance, 1e-12), distance, 0.0, mi.Color0f()
        )
        clear = clear & ~world.geometry.ray_test(ray, clear)
        step = free_path(rng.next_float32(), world.scattering)
        last = i + 1 >= chain.events
        on = at + d * step
        d, _ = phase.draw(d, rng.next_uint32(), mi.Point2f(rng.next_float32(), rng.next_float32()))
        return rng, i + 1, dr.select(last, before, at), dr.select(last, at, on), d, clear

    state = (chain.keep, mi.UInt32(0), mi.Vector3f(0.0), mi.Vector3f(0.0, 0.0, first), d, mi.Bool(good))
    state = dr.while_loop(
        state, lambda rng, i, before, at, d, clear: clear & (i < chain.events), again, mode="symbolic"
    )  # fmt: skip
    return state[3], state[5]
