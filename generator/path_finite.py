"""What a lens and a lamp of finite size change of the light that meets one surface: finite minus pinhole and point.

Both are traced at the same points of the pixel, so that their difference is little noise where it is small. The lens is thin:
light from the point in focus, P, arrives at once over all of the aperture, so that light through its point A from x takes the path

    abs(x − A) + abs(P) − abs(P − A).

The lamp is an evenly bright disc across its axis; each of its points sends out the profile I(θ).
"""

from __future__ import annotations

from typing import Any

import numpy as np

from .backend import mitsuba
from .path_loop import Lanes, Moments, Window
from .path_world import PathWorld

__all__ = ["trace_finite"]

#: Steps of a lattice in six dimensions, as fractions of 2³² (as of the path tracer's).
_STEPS = tuple(round((1.1127756842787055**-k % 1.0) * 2**32) for k in range(1, 7))


def trace_finite(world: PathWorld, lanes: Lanes, samples: int, window: Window) -> tuple[Moments, Moments]:
    """Moments of the light by way of the finite lens and lamp, and by way of points: `samples` of each in every lane."""
    import drjit as dr

    mi = mitsuba()
    count = len(lanes.row)
    sums = [[dr.zeros(mi.Float, count * window.bins) for _ in range(3)] for _ in range(2)]
    words = [
        mi.sample_tea_64(mi.UInt32(mi.UInt64(w) & 0xFFFFFFFF) ^ 0x9E3779B9, mi.UInt32(mi.UInt64(w) >> 32))
        for w in (lanes.state, lanes.stream)
    ]
    shift = [mi.UInt32(w & 0xFFFFFFFF) for w in words] + [mi.UInt32(w >> 32) for w in words]
    shift += [shift[0] ^ (shift[3] * 747796405), shift[1] ^ (shift[2] * 747796405)]
    row, col = mi.Float(lanes.row), mi.Float(lanes.col)
    base = dr.arange(mi.UInt32, count) * window.bins
    start, per_metre = dr.opaque(mi.Float, window.start_m), dr.opaque(mi.Float, 1.0 / window.width_m)
    last, wanted = dr.opaque(mi.UInt32, window.bins), dr.opaque(mi.UInt32, samples)
    scale = dr.opaque(mi.Float, world.pitch_over_focal)
    half_rows, half_cols = (dr.opaque(mi.Float, n / 2) for n in (world.rows, world.cols))
    lens = dr.opaque(mi.Float, world.aperture_radius)
    lamp_radius = dr.opaque(mi.Float, world.source_radius)
    across = mi.Frame3f(world.lamp.axis)

    def light(target: list[Any], o: Any, d: Any, more: Any, weight: Any, lamp: Any) -> None:
        si = world.geometry.ray_intersect(mi.Ray3f(mi.Point3f(o), d))
        hit = si.is_valid()
        way = lamp - si.p
        away = dr.norm(way)
        way /= dr.maximum(away, 1e-12)
        value = si.bsdf().eval(mi.BSDFContext(), si, si.to_local(way), hit)[0] * weight * world.lamp.intensity(-way)
        value *= dr.exp(-world.attenuation * (si.t + away)) / dr.maximum(dr.square(away), 1e-12)
        where = (si.t + more + away - start) * per_metre
        seen = hit & (value > 0.0) & (where >= 0.0)
        index = mi.UInt32(dr.select(seen, where, 0.0))
        seen &= index < last
        seen &= ~world.geometry.ray_test(si.spawn_ray_to(lamp), seen)
        offset = where - mi.Float(index) - 0.5
        for power, sums_of in enumerate(target):
            part = value * offset**power if power else value
            dr.scatter_reduce(dr.ReduceOp.Add, sums_of, part, base + index, seen, dr.ReduceMode.NoConflicts)

    def body(i: Any) -> tuple[Any]:
        u = [mi.Float((shift[j] + i * mi.UInt32(_STEPS[j])) >> 8) * (1.0 / 16777216.0) for j in range(6)]
        view = dr.normalize(mi.Vector3f((col + u[0] - half_cols) * scale, (row + u[1] - half_rows) * scale, 1.0))
        weight = dr.square(dr.square(view.z)) if world.vignetting else mi.Float(1.0)
        light(sums[1], mi.Point3f(0.0), view, mi.Float(0.0), weight, world.lamp.position)
        o, d, more = mi.Point3f(0.0), view, mi.Float(0.0)
        if world.focus_distance is not None:
            a = mi.warp.square_to_uniform_disk_concentric(mi.Point2f(u[2], u[3])) * lens
            o = mi.Point3f(a.x, a.y, 0.0)
            focus = mi.Point3f(view / view.z * dr.opaque(mi.Float, world.focus_distance))
            d = focus - o
            more = dr.norm(mi.Vector3f(focus)) - dr.norm(d)
            d = dr.normalize(d)
        s = mi.warp.square_to_uniform_disk_concentric(mi.Point2f(u[4], u[5])) * lamp_radius
        lamp = world.lamp.position + across.to_world(mi.Vector3f(s.x, s.y, 0.0))
        light(sums[0], o, d, more, weight, lamp)
        return (i + 1,)

    dr.while_loop((dr.zeros(mi.UInt32, count),), lambda i: i < wanted, body, mode="symbolic")
    dr.eval(*sums[0], *sums[1])
    nothing = np.zeros(count, dtype=np.float32)
    found = [np.stack([np.asarray(b.numpy()).reshape(count, window.bins) for b in side]) for side in sums]
    return Moments(found[0], nothing, nothing), Moments(found[1], nothing, nothing)
