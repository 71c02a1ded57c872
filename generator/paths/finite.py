"""What a lens and a lamp of finite size change of the light that meets one surface: finite minus pinhole and point.

Both are traced at the same points of the pixel, so that their difference is little noise where it is small. The lens is thin:
light from the point in focus, P, arrives at once over all of the aperture, so that light through its point A from x takes the path

    abs(x − A) + abs(P) − abs(P − A).

The lamp is an evenly bright disc across its axis; each of its points sends out the profile I(θ).

With F and P the light of a sample by way of the finite and of the points, at the times τ_F and τ_P, a slice gets R(τ_P) (F − P)
from their difference, and F (R(τ_F) − R(τ_P)) more. So the error of the stack is below that of F − P, the whole of it at an open
gate, and that of F·clip(s (τ_F − τ_P), −1, 1), s the steepest slope of R: an edge between two surfaces as bright as each
other changes nothing at an open gate, and all at a gate that shows one of them.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..rays.backend import mitsuba
from .loop import Lanes, Moments, Window
from .world import PathWorld

__all__ = ["Change", "FiniteLight", "FiniteSums", "trace_finite"]

Float = NDArray[np.float64]

#: Steps of a lattice in six dimensions, as fractions of 2³² (as of the path tracer's).
_STEPS = tuple(round((1.1127756842787055**-k % 1.0) * 2**32) for k in range(1, 7))


@dataclass(frozen=True)
class Change:
    """Sums over the samples of lanes, times outside the window included. `sums` (4, lanes): F − P, its square, what times change,
    its square; `first_m`, `last_m` (lanes): shortest and longest path of light by way of the finite (±inf where none came)."""

    sums: NDArray[np.float32]
    first_m: NDArray[np.float32]
    last_m: NDArray[np.float32]


@dataclass(frozen=True)
class FiniteLight:
    """Of pixels (rows, cols): `amplitude`, photoelectrons that finite lens and lamp add at an open gate; `sigma`, standard error of
    that and of every slice; `first_m`, `last_m`, shortest and longest path of the light (NaN where none came)."""

    amplitude: Float
    sigma: Float
    first_m: Float
    last_m: Float


class FiniteSums:
    """Sums of `Change` over lanes and rounds, per pixel."""

    def __init__(self, pixels: int) -> None:
        self.sums = np.zeros((4, pixels))
        self.first_m, self.last_m = np.full(pixels, np.inf), np.full(pixels, -np.inf)

    def add(self, change: Change, pixels: slice) -> None:
        """Add lanes (lane, pixel) of some pixels."""
        count = pixels.stop - pixels.start
        self.sums[:, pixels] += change.sums.reshape(4, -1, count).sum(axis=1, dtype=np.float64)
        first, last = (path.reshape(-1, count).astype(np.float64) for path in (change.first_m, change.last_m))
        self.first_m[pixels] = np.minimum(self.first_m[pixels], first.min(axis=0))
        self.last_m[pixels] = np.maximum(self.last_m[pixels], last.max(axis=0))

    def result(self, samples: int, electrons: float, shape: tuple[int, int]) -> FiniteLight:
        """`samples` per pixel, of `electrons` each per unit of light."""
        light, square, moved, moved_square = self.sums / samples
        # Both come from the same samples: their standard errors add.
        sigma = np.sqrt(np.maximum(square - light**2, 0.0)) + np.sqrt(np.maximum(moved_square - moved**2, 0.0))
        first, last = (np.where(np.isfinite(path), path, np.nan) for path in (self.first_m, self.last_m))
        maps = (electrons * light, electrons / np.sqrt(samples) * sigma, first, last)
        return FiniteLight(*(np.asarray(value).reshape(shape) for value in maps))


def trace_finite(
    world: PathWorld, lanes: Lanes, samples: int, window: Window, steepest: float
) -> tuple[Moments, Moments, Change]:
    """Moments of the light by way of the finite lens and lamp, and by way of points: `samples` of each in every lane; and what
    the pixels' truth and errors follow from. `steepest`: largest slope of R over its peak, per bin."""
    import drjit as dr

    mi, count = mitsuba(), len(lanes.row)
    body = _Body(world, lanes, window, steepest)
    wanted = dr.opaque(mi.UInt32, samples)
    state = (dr.zeros(mi.UInt32, count), *(dr.zeros(mi.Float, count) for _ in range(4)))
    state = (*state, dr.full(mi.Float, dr.inf, count), dr.full(mi.Float, -dr.inf, count))
    sums = dr.while_loop(state, lambda i, *_: i < wanted, body.step, mode="symbolic")[1:]
    dr.eval(*body.sums[0], *body.sums[1], *sums)
    nothing = np.zeros(count, dtype=np.float32)
    bins = [np.stack([np.asarray(b.numpy()).reshape(count, window.bins) for b in side]) for side in body.sums]
    arrays = [np.asarray(value.numpy()) for value in sums]
    change = Change(np.stack(arrays[:4]), arrays[4], arrays[5])
    return Moments(bins[0], nothing, nothing), Moments(bins[1], nothing, nothing), change


class _Body:
    """One sample of every lane, by way of the finite lens and lamp and by way of points; `sums`: the moments of both."""

    def __init__(self, world: PathWorld, lanes: Lanes, window: Window, steepest: float) -> None:
        import drjit as dr

        mi, count = mitsuba(), len(lanes.row)
        self.world = world
        self.sums = [[dr.zeros(mi.Float, count * window.bins) for _ in range(3)] for _ in range(2)]
        words = [
            mi.sample_tea_64(mi.UInt32(mi.UInt64(w) & 0xFFFFFFFF) ^ 0x9E3779B9, mi.UInt32(mi.UInt64(w) >> 32))
            for w in (lanes.state, lanes.stream)
        ]
        shift = [mi.UInt32(w & 0xFFFFFFFF) for w in words] + [mi.UInt32(w >> 32) for w in words]
        self.shift = [*shift, shift[0] ^ (shift[3] * 747796405), shift[1] ^ (shift[2] * 747796405)]
        self.row, self.col = mi.Float(lanes.row), mi.Float(lanes.col)
        self.base = dr.arange(mi.UInt32, count) * window.bins
        self.start, self.per_metre = dr.opaque(mi.Float, window.start_m), dr.opaque(mi.Float, 1.0 / window.width_m)
        self.last = dr.opaque(mi.UInt32, window.bins)
        self.scale = dr.opaque(mi.Float, world.pitch_over_focal)
        self.half_rows, self.half_cols = (dr.opaque(mi.Float, n / 2) for n in (world.rows, world.cols))
        self.lens = dr.opaque(mi.Float, world.aperture_radius)
        self.lamp_radius = dr.opaque(mi.Float, world.source_radius)
        self.across = mi.Frame3f(world.lamp.axis)
        self.slope = dr.opaque(mi.Float, steepest)

    def step(
        self, i: Any, change: Any, square: Any, moved: Any, moved_square: Any, first: Any, final: Any
    ) -> tuple[Any, ...]:
        """Add the light of sample `i` to the moments, and what the finite size changes of it to the sums."""
        import drjit as dr

        mi, world = mitsuba(), self.world
        u = [mi.Float((self.shift[j] + i * mi.UInt32(_STEPS[j])) >> 8) * (1.0 / 16777216.0) for j in range(6)]
        x, y = (self.col + u[0] - self.half_cols) * self.scale, (self.row + u[1] - self.half_rows) * self.scale
        view = dr.normalize(mi.Vector3f(x, y, 1.0))
        weight = dr.square(dr.square(view.z)) if world.vignetting else mi.Float(1.0)
        by_point, when = self._light(
            self.sums[1], mi.Point3f(0.0), view, mi.Float(0.0), weight, world.lamp.position
        )  # fmt: skip
        o, d, more = self._through_the_lens(view, mi.Point2f(u[2], u[3]))
        s = mi.warp.square_to_uniform_disk_concentric(mi.Point2f(u[4], u[5])) * self.lamp_radius
        lamp = world.lamp.position + self.across.to_world(mi.Vector3f(s.x, s.y, 0.0))
        by_disc, path = self._light(self.sums[0], o, d, more, weight, lamp)
        apart = by_disc - by_point
        late = dr.clip(self.slope * self.per_metre * (path - when), -1.0, 1.0)
        turned = dr.select((by_disc > 0.0) & (by_point > 0.0), by_disc * late, 0.0)
        first = dr.select(by_disc > 0.0, dr.minimum(first, path), first)
        final = dr.select(by_disc > 0.0, dr.maximum(final, path), final)
        sums = change + apart, square + dr.square(apart), moved + turned, moved_square + dr.square(turned)
        return (i + 1, *sums, first, final)

    def _through_the_lens(self, view: Any, point: Any) -> tuple[Any, Any, Any]:
        """(origin, direction, extra path) of the ray through a point of the aperture, given by two even numbers."""
        import drjit as dr

        mi, distance = mitsuba(), self.world.focus_distance
        if distance is None:
            return mi.Point3f(0.0), view, mi.Float(0.0)
        a = mi.warp.square_to_uniform_disk_concentric(point) * self.lens
        o = mi.Point3f(a.x, a.y, 0.0)
        focus = mi.Point3f(view / view.z * dr.opaque(mi.Float, distance))
        d = focus - o
        more = dr.norm(mi.Vector3f(focus)) - dr.norm(d)
        return o, dr.normalize(d), more

    def _light(self, sums: list[Any], o: Any, d: Any, more: Any, weight: Any, lamp: Any) -> tuple[Any, Any]:
        """Add the light of a ray by way of one point of the lamp to its moments; that light, and its path."""
        import drjit as dr

        mi, world = mitsuba(), self.world
        si = world.geometry.ray_intersect(mi.Ray3f(mi.Point3f(o), d))
        hit = si.is_valid()
        way = lamp - si.p
        away = dr.norm(way)
        way /= dr.maximum(away, 1e-12)
        value = si.bsdf().eval(mi.BSDFContext(), si, si.to_local(way), hit)[0] * weight * world.lamp.intensity(-way)
        value *= dr.exp(-world.attenuation * (si.t + away)) / dr.maximum(dr.square(away), 1e-12)
        path = si.t + more + away
        where = (path - self.start) * self.per_metre
        lit = hit & (value > 0.0)
        lit &= ~world.geometry.ray_test(si.spawn_ray_to(lamp), lit)
        seen = lit & (where >= 0.0)
        index = mi.UInt32(dr.select(seen, where, 0.0))
        seen &= index < self.last
        offset = where - mi.Float(index) - 0.5
        for power, target in enumerate(sums):
            part = value * offset**power if power else value
            dr.scatter_reduce(dr.ReduceOp.Add, target, part, self.base + index, seen, dr.ReduceMode.NoConflicts)
        return dr.select(lit, value, 0.0), path
