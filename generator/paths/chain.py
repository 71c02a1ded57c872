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

    mi, phase = mitsuba(), world.phase
    assert phase is not None
    b = world.scattering
    forward = mi.Vector3f(0.0, 0.0, 1.0)
    reach = chance(b * away)
    first = dr.minimum(-dr.log(1.0 - rng.next_float32() * reach) / b, away)
    d, density = phase.draw(forward, rng.next_uint32(), mi.Point2f(rng.next_float32(), rng.next_float32()))
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
    state = dr.while_loop(
        state, lambda rng, p, d, length, events, going, out: going, forth, mode="symbolic"
    )  # fmt: skip
    rng, p, last, length, events, _, out = state
    good = active & out & (length < room)
    # Turn the place of leaving onto x, and by an even angle about it.
    normal = p / dr.maximum(away, 1e-12)
    mu = dr.maximum(dr.dot(normal, last), 0.0)
    sin_phi, cos_phi = dr.sincos(2.0 * dr.pi * rng.next_float32())
    here, there = mi.Frame3f(normal), mi.Frame3f((x - world.lamp.position) / dr.maximum(away, 1e-12))

    def turn(v: Any) -> Any:
        w = here.to_local(v)
        return there.to_world(mi.Vector3f(cos_phi * w.x - sin_phi * w.y, sin_phi * w.x + cos_phi * w.y, w.z))

    travel, emitted = turn(last), turn(forward)
    light = reach * world.lamp.intensity(emitted) / (r2 * mu)
    good &= (light > 0.0) & (mu > 0.0)

    def again(rng: Any, i: Any, before: Any, at: Any, d: Any, clear: Any) -> tuple[Any, ...]:
        way = turn(at - before)
        distance = dr.norm(way)
        ray = mi.Ray3f(
            world.lamp.position + turn(before), way / dr.maximum(distance, 1e-12), distance, 0.0, mi.Color0f()
        )
        clear = clear & ~world.geometry.ray_test(ray, clear)
        step = free_path(rng.next_float32(), b)
        last = i + 1 >= events
        on = at + d * step
        d, _ = phase.draw(d, rng.next_uint32(), mi.Point2f(rng.next_float32(), rng.next_float32()))
        return rng, i + 1, dr.select(last, before, at), dr.select(last, at, on), d, clear

    state2 = (keep, mi.UInt32(0), mi.Vector3f(0.0), mi.Vector3f(0.0, 0.0, first), d, mi.Bool(good))
    state2 = dr.while_loop(state2, lambda rng, i, before, at, d, clear: clear & (i < events), again, mode="symbolic")
    end, clear = state2[3], state2[5]
    clear &= start_ray(world.lamp.position + turn(end), clear)
    return rng, Arrival(travel, length, dr.select(clear, light, 0.0), events, mu, density, first)
