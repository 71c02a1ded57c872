"""An independent walk of photons from a lamp through water to a pinhole: the reference of multiply scattered light.

It shares no physics with `generator` and `optics` (from there it takes the door to Numba alone; pulse, gate and photoelectrons
per unit of radiance are the closed forms of `_gate_closed_form`). Photons leave the lamp and
meet water and one plane wall without end; no event is drawn from the camera. With a, b, c = a + b of the water, p its phase
function, every flight (from y along d, weight w) gives the camera what its next event is expected to give,

    w ∫ b e^{−ct} p(θ) e^{−cr}/r² dt = (w b/h) ∫ p(θ) e^{−c(t+r)} dθ,

r(t) the way on to the pinhole, θ(t) the turn, h the flight's distance from the pinhole (cot θ = (t₀ − t)/h, so that
dt/r² = dθ/h): θ is drawn from p itself, and nothing grows like 1/r² (Kalos 1963, Nucl. Sci. Eng. 16, 111, on estimators of
the flux at a point). The ends of the integral are those of the field of view and of the times. Where the flight meets the
wall, it gives w e^{−cT} ρ/π cosθ e^{−cr}/r².

After an event the photon goes on twice: by the law there, and toward the pinhole, with the density H(θ)/(2π sinθ ∫H) about that
way, H(θ) = ∫_θ^π p, which is how much such a flight will give, 1/h included. With n₁ = 1 flight of the one density f₁ and n₂ = q
of the other (q is the chance that there is a second flight), each has the weight p/(f₁ + q f₂) (balance heuristic, Veach
1997). So no sum holds a term like p(0)/h of a photon that passes the pinhole by chance. Light that meets the camera by a single
scattering or by the wall alone is left out.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np

from beambench.optics.jit import kernel
from beambench.scenes.materials import Lambert
from beambench.scenes.medium_index import group_index
from beambench.scenes.rigs.gated import gated_rig
from beambench.scenes.scene import Scene
from beambench.scenes.shapes import Rectangle

from ._gate_closed_form import C, electrons_per_radiance, gate_response, slices_of
from ._walk_phase import Float, turns_of

#: Points of a flight's integral.
_POINTS = 2
#: Weight below which photons end at random; chance of a second flight of photons that come toward the pinhole already.
_FLOOR, _SELDOM = 0.002, 0.5


class Set(NamedTuple):
    """Lamp at (`x`, `y`, `z`) that shines evenly along z up to a half angle; pinhole at 0 that looks along z, its square image
    `tangent` wide to each side at unit distance; water `a`, `b` [1/m]; a wall of `albedo` through (0, 0, `depth`) with the
    normal (0, `sine`, −`cosine`); paths from `first` to `longest` [m] count."""

    x: float
    y: float
    z: float
    half_angle: float
    tangent: float
    a: float
    b: float
    albedo: float
    depth: float
    sine: float
    cosine: float
    first: float
    longest: float


@kernel
def _cell(turns: Any, theta: float) -> int:
    """The cell that holds θ."""
    if theta < turns.first:
        return 0
    return min(int(np.log(theta / turns.first) / turns.step) + 1, len(turns.law) - 1)


@kernel
def _p(turns: Any, theta: float) -> float:
    """p(θ) [1/sr]: ln p linear in ln θ between edges."""
    x = np.log(max(theta, turns.first) / turns.first) / turns.step
    k = min(int(x), len(turns.log_p) - 2)
    return float(np.exp(turns.log_p[k] + (x - k) * (turns.log_p[k + 1] - turns.log_p[k])))


@kernel
def _inverse(edge: Any, density: Any, total: Any, value: float) -> tuple[float, int]:
    """(θ at which an integral reaches a value, its cell)."""
    k = min(max(int(np.searchsorted(total, value, side="right")) - 1, 0), len(density) - 1)
    return min(edge[k] + max(value - total[k], 0.0) / density[k], edge[k + 1]), k


@kernel
def _about(rng: Any, d: Any, theta: float) -> tuple[float, float, float]:
    """A direction at θ from d, at an even angle about it."""
    phi = 2.0 * np.pi * rng.random()
    sine, cosine = np.sin(theta), np.cos(theta)
    u, v = sine * np.cos(phi), sine * np.sin(phi)
    # A frame without a singular direction (Duff et al. 2017, JCGT 6, 1).
    sign = 1.0 if d[2] >= 0.0 else -1.0
    e = -1.0 / (sign + d[2])
    f = d[0] * d[1] * e
    x = u * (1.0 + sign * d[0] * d[0] * e) + v * f + cosine * d[0]
    y = u * sign * f + v * (sign + d[1] * d[1] * e) + cosine * d[1]
    z = -u * sign * d[0] - v * d[1] + cosine * d[2]
    size = np.sqrt(x * x + y * y + z * z)
    return x / size, y / size, z / size


@kernel
def _angle(d: Any, e: Any) -> float:
    x, y, z = d[1] * e[2] - d[2] * e[1], d[2] * e[0] - d[0] * e[2], d[0] * e[1] - d[1] * e[0]
    return float(np.arctan2(np.sqrt(x * x + y * y + z * z), d[0] * e[0] + d[1] * e[1] + d[2] * e[2]))


@kernel
def _put(at: Any, bins: Any, path: float, value: float) -> None:
    """Add light of this path, seen from a unit of the image at unit distance, to its bin."""
    index = int((path - at.first) / (at.longest - at.first) * len(bins))
    if 0 <= index < len(bins):
        bins[index] += value


@kernel
def _in_view(at: Any, p: Any, d: Any, high: float) -> tuple[float, float]:
    """The part of a flight inside the field of view, a pyramid of four planes (empty: low ≥ high)."""
    low = 0.0
    for side in range(4):
        sign, axis = 1.0 - 2.0 * (side % 2), side // 2
        here, slope = at.tangent * p[2] + sign * p[axis], at.tangent * d[2] + sign * d[axis]
        if slope > 0.0:
            low = max(low, -here / slope)
        elif slope < 0.0:
            high = min(high, -here / slope)
        elif here <= 0.0:
            high = -1.0
    return low, high


@kernel
def _integral(turns: Any, theta: float) -> float:
    """∫ p dθ from 0 to θ."""
    k = _cell(turns, theta)
    return float(turns.turn_sum[k] + (theta - turns.edge[k]) * turns.turn[k])


@kernel
def _flight(rng: Any, at: Any, turns: Any, s: Any, reach: float, bins: Any) -> None:
    """What a flight gives the camera by its next scattering. s: x, y, z, direction, path, weight, scatterings."""
    p, d, path = s[0:3], s[3:6], s[6]
    r2, foot = p[0] ** 2 + p[1] ** 2 + p[2] ** 2, -(p[0] * d[0] + p[1] * d[1] + p[2] * d[2])
    room, soon = at.longest - path, at.first - path
    if room * room <= r2:
        return
    # t + r = room where t = (room² − r₀²)/(2(room − t₀)).
    low, high = _in_view(at, p, d, min(reach, 0.5 * (room * room - r2) / (room - foot)))
    if soon > 0.0 and soon * soon > r2:
        low = max(low, 0.5 * (soon * soon - r2) / (soon - foot))
    if low >= high:
        return
    x, y, z = p[1] * d[2] - p[2] * d[1], p[2] * d[0] - p[0] * d[2], p[0] * d[1] - p[1] * d[0]
    h = np.sqrt(x * x + y * y + z * z)
    one, two = _integral(turns, np.arctan2(h, foot - low)), _integral(turns, np.arctan2(h, foot - high))
    for j in range(_POINTS):
        theta, k = _inverse(turns.edge, turns.turn, turns.turn_sum, one + (two - one) * (j + rng.random()) / _POINTS)
        t = min(max(foot - h / np.tan(theta), low), high)
        r = np.sqrt(h * h + (t - foot) ** 2)
        view = (p[2] + t * d[2]) / r
        value = s[7] * at.b / h * _p(turns, theta) * (two - one) / (turns.turn[k] * _POINTS)
        _put(at, bins, path + t + r, value * np.exp(-(at.a + at.b) * (t + r)) / view**3)


@kernel
def _surface(at: Any, s: Any, reach: float, bins: Any) -> None:
    """What a flight gives the camera by way of the wall, `reach` away: no water turns it before or after."""
    x, y, z = s[0] + reach * s[3], s[1] + reach * s[4], s[2] + reach * s[5]
    if z <= 0.0 or abs(x) >= at.tangent * z or abs(y) >= at.tangent * z:
        return
    r = np.sqrt(x * x + y * y + z * z)
    cosine = (at.cosine * z - at.sine * y) / r
    if cosine > 0.0:
        value = s[7] * at.albedo / np.pi * cosine / r**2 * np.exp(-(at.a + at.b) * (reach + r)) / (z / r) ** 3
        _put(at, bins, s[6] + reach + r, value)


@kernel
def _lobe(turns: Any, theta: float) -> float:
    """Density of flights toward the pinhole [1/sr]."""
    return float(turns.lobe[_cell(turns, theta)] / (2.0 * np.pi * max(np.sin(theta), 1e-30)))


@kernel
def _law(at: Any, turns: Any, hit: bool, d: Any, normal: Any, e: Any) -> tuple[float, float]:
    """(what an event sends from d to e [1/sr], density of flights by its law)."""
    if hit:
        cosine = max(normal[0] * e[0] + normal[1] * e[1] + normal[2] * e[2], 0.0)
        return at.albedo * cosine / np.pi, cosine / np.pi
    theta = _angle(d, e)
    return _p(turns, theta), turns.law[_cell(turns, theta)] / (2.0 * np.pi * max(np.sin(theta), 1e-30))


@kernel
def _event(rng: Any, at: Any, turns: Any, s: Any, stack: Any, top: int, bins: Any) -> int:
    """Follow a photon s to its next event, and put what goes on from there on the stack."""
    normal = (0.0, at.sine, -at.cosine)
    slant = normal[1] * s[4] + normal[2] * s[5]
    reach = np.inf
    if slant < 0.0:
        reach = max((-at.cosine * at.depth - normal[1] * s[1] - normal[2] * s[2]) / slant, 0.0)
    if s[9] > 0.0:
        _flight(rng, at, turns, s, reach, bins)
    if s[8] > 0.0 and reach < at.longest:
        _surface(at, s, reach, bins)
    free = -np.log(1.0 - rng.random()) / at.b
    hit = free >= reach
    step = min(free, reach)
    for i in range(3):
        s[i] += step * s[3 + i]
    r = np.sqrt(s[0] ** 2 + s[1] ** 2 + s[2] ** 2)
    s[6] += step
    s[7] *= np.exp(-at.a * step)
    if s[6] + r >= at.longest:
        return top
    d, toward = (s[3], s[4], s[5]), (-s[0] / r, -s[1] / r, -s[2] / r)
    inward = _angle(d, toward)
    floor = _FLOOR / (1.0 + _lobe(turns, inward))
    if s[7] < floor:
        if rng.random() * floor > s[7]:
            return top
        s[7] = floor
    often = 1.0 if hit or inward > 0.5 else _SELDOM
    for second in range(2):
        if second and rng.random() >= often:
            break
        if second:
            theta, _ = _inverse(turns.edge, turns.lobe, turns.lobe_sum, rng.random())
            e = _about(rng, toward, theta)
        elif hit:
            e = _about(rng, normal, np.arccos(np.sqrt(rng.random())))
        else:
            theta, _ = _inverse(turns.edge, turns.law, turns.law_sum, rng.random())
            e = _about(rng, d, theta)
        sent, density = _law(at, turns, hit, d, normal, e)
        if sent > 0.0:
            new = stack[top]
            new[0:3] = s[0:3]
            new[3], new[4], new[5] = e
            new[6] = s[6]
            new[7] = s[7] * sent / (density + often * _lobe(turns, _angle(e, toward)))
            new[8] = s[8] + (0.0 if hit else 1.0)
            new[9] = s[9] + 1.0
            top += 1
    return top


@kernel
def walk(rng: Any, at: Any, turns: Any, photons: int, bins: Any) -> None:
    """Add to `bins` the light of photons that met water at least once and two events at least, each of weight one."""
    stack, s = np.empty((1024, 10)), np.empty(10)
    for _ in range(photons):
        cosine = 1.0 - rng.random() * (1.0 - np.cos(at.half_angle))
        x, y, z = _about(rng, (0.0, 0.0, 1.0), np.arccos(cosine))
        s[0], s[1], s[2], s[3], s[4], s[5], s[6], s[7], s[8], s[9] = at.x, at.y, at.z, x, y, z, 0.0, 1.0, 0.0, 0.0
        top = _event(rng, at, turns, s, stack, 0, bins)
        while top > 0:
            top -= 1
            s[:] = stack[top]
            top = _event(rng, at, turns, s, stack, top, bins)


def walked(scene: Scene, p: Callable[[Float], Float], photons: int, batches: int, seed: int = 0) -> Float:
    """Photoelectrons (batches, slices) of the mean pixel, of light with scattering that is not single, with `photons` in each
    batch: a scene of `_lit_wall`, whose wall is taken to be without end, in water with the phase function p(θ)."""
    rig, medium, wall = gated_rig(scene), scene.medium, scene.target[0]
    assert isinstance(wall.shape, Rectangle) and isinstance(wall.material, Lambert) and wall.shape.tilt_y_deg == 0.0
    per_metre = group_index(medium, rig.laser.wavelength_m) / C
    delay, tail = slices_of(scene).delay_s, 6 * rig.laser.pulse.fwhm_s / np.sqrt(8 * np.log(2))  # type: ignore[union-attr]
    first, longest = delay.min() - tail, delay.max() + rig.gates[0].width_s + tail  # type: ignore[union-attr]
    half, tilt = rig.laser.illumination.half_angle_rad, np.deg2rad(wall.shape.tilt_x_deg)
    tangent = 0.5 * rig.camera.rows * rig.camera.pixel_pitch_m / rig.camera.focal_length_m
    water = medium.absorption_per_m, medium.scattering_per_m
    plane = wall.material.albedo, wall.shape.center_m[2], float(np.sin(tilt)), float(np.cos(tilt))
    at = Set(*rig.laser.position_m, half, tangent, *water, *plane, first / per_metre, longest / per_metre)
    # Bins of some 1 mm: the pulse is over 9 cm long.
    bins = np.zeros((batches, 4000))
    middle = first + (np.arange(4000) + 0.5) / 4000 * (longest - first)
    turns = turns_of(p)
    for number in range(batches):
        walk(np.random.default_rng([seed, number]), at, turns, photons, bins[number])
    solid = 2 * np.pi * (1 - np.cos(half))
    # An image of unit area at unit distance is (2 tangent)² of them.
    scale = solid * electrons_per_radiance(scene) / (2 * tangent) ** 2 / photons
    return np.asarray(scale * bins @ gate_response(scene, middle).T)
