"""Small Monte Carlos of scattered light: exactly once (the camera counts what it can see), and a pencil to a plane.

Independent of the quadrature: the first samples volume (a direction of the beam, a free path), not the camera's ray.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from beambench.optics.water.phase_forms import PhaseFunction, phase_cdf, phase_density

Float = NDArray[np.float64]


def cone(rng: np.random.Generator, half_angle: float, n: int) -> Float:
    """Directions (n, 3) even in solid angle in a cone about z."""
    cosine = 1.0 - rng.random(n) * (1.0 - np.cos(half_angle))
    sine = np.sqrt(1.0 - cosine**2)
    around = 2 * np.pi * rng.random(n)
    return np.stack([sine * np.cos(around), sine * np.sin(around), cosine], axis=1)


def radiance_of_paths(
    rng: np.random.Generator,
    photons: int,
    edges: Float,
    *,
    lamp: Float,
    lamp_half: float,
    view: Float,
    view_half: float,
    phase: PhaseFunction,
    a: float,
    b: float,
) -> tuple[Float, Float]:
    """Mean radiance over a cone of view, per unit of emitted energy, in bins of path: (estimate, standard error)."""
    c = a + b
    direction = cone(rng, lamp_half, photons)
    free = rng.exponential(1.0 / c, photons)
    point = lamp + direction * free[:, None]
    r2 = np.linalg.norm(point, axis=1)
    inside = (point @ view) / r2 > np.cos(view_half)
    point, direction, free, r2 = point[inside], direction[inside], free[inside], r2[inside]
    # the photon turns toward the camera: cosψ = −direction · (point/r2)
    turn = np.arccos(np.clip(-np.sum(direction * point, axis=1) / r2, -1.0, 1.0))
    weight = (b / c) * phase_density(phase, turn) * np.exp(-c * r2) / r2**2
    weight /= 2 * np.pi * (1 - np.cos(view_half))
    bin_of = np.digitize(free + r2, edges) - 1
    bins = len(edges) - 1
    keep = (bin_of >= 0) & (bin_of < bins)
    first = np.bincount(bin_of[keep], weight[keep], bins) / photons
    second = np.bincount(bin_of[keep], weight[keep] ** 2, bins) / photons
    return first, np.sqrt(np.maximum(second - first**2, 0.0) / photons)


def pencil_to_plane(
    rng: np.random.Generator, photons: int, distance: float, phase: PhaseFunction, a: float, b: float
) -> tuple[Float, Float]:
    """A pencil beam's photons at their first crossing of a plane at `distance`, in three dimensions, without small-angle
    approximation: (angle from the axis seen from the source, weight e^{−a·path} per photon)."""
    edge = np.geomspace(1e-9, np.pi, 20_000)
    cdf, log_edge = phase_cdf(phase, edge), np.log(edge)
    position, direction = np.zeros((photons, 3)), np.tile([0.0, 0.0, 1.0], (photons, 1))
    path = np.zeros(photons)
    angles, weights = [], []
    while path.size:
        step = rng.exponential(1 / b, path.size)
        z = np.maximum(direction[:, 2], 1e-12)
        need = np.where(direction[:, 2] > 1e-12, (distance - position[:, 2]) / z, np.inf)
        hit = step >= need
        at = position[hit] + direction[hit] * need[hit, None]
        angles.append(np.arctan(np.hypot(at[:, 0], at[:, 1]) / distance))
        weights.append(np.exp(-a * (path[hit] + need[hit])))
        position, direction, path = (
            position[~hit] + direction[~hit] * step[~hit, None], direction[~hit], path[~hit] + step[~hit],
        )  # fmt: skip
        # what has gone eight distances is below e^{−8ar}, and far from the axis
        near = (path < 8 * distance) & (position[:, 2] > -3 * distance)
        position, direction, path = position[near], direction[near], path[near]
        direction = turned(rng, direction, np.exp(np.interp(rng.random(path.size), cdf, log_edge)))
    return np.concatenate(angles), np.concatenate(weights)


def turned(rng: np.random.Generator, direction: Float, angle: Float) -> Float:
    """Unit directions (n, 3) turned by `angle` toward a random side."""
    around = 2 * np.pi * rng.random(len(direction))
    side = np.cross(direction, np.where(np.abs(direction[:, 2:]) < 0.9, [[0.0, 0.0, 1.0]], [[1.0, 0.0, 0.0]]))
    side /= np.linalg.norm(side, axis=1, keepdims=True)
    up = np.cross(direction, side)
    across = np.cos(around)[:, None] * side + np.sin(around)[:, None] * up
    new = np.cos(angle)[:, None] * direction + np.sin(angle)[:, None] * across
    return np.asarray(new / np.linalg.norm(new, axis=1, keepdims=True))


def ramp_after_forward_turns(
    rng: np.random.Generator,
    photons: int,
    edges: Float,
    *,
    beam_half: float,
    view_half: float,
    phase: PhaseFunction,
    a: float,
    b: float,
) -> tuple[Float, Float]:
    """Coaxial ramp, mean over a cone of view, of light that turns forward any number of times on its way out and then
    once by more than a right angle straight to the camera: in bins of path, (estimate, standard error).

    In three dimensions and with true paths. `beam_half` is the 1/e² half angle of a Gaussian beam (small).
    """
    theta = 0.5 * beam_half * np.sqrt(-2.0 * np.log(1.0 - rng.random(photons)))
    around = 2 * np.pi * rng.random(photons)
    direction = np.stack([np.sin(theta) * np.cos(around), np.sin(theta) * np.sin(around), np.cos(theta)], axis=1)
    position, path = np.zeros((photons, 3)), np.zeros(photons)
    bins = len(edges) - 1
    first, second = np.zeros(bins), np.zeros(bins)
    edge = np.geomspace(1e-9, np.pi, 20_000)
    cdf, log_edge = phase_cdf(phase, edge), np.log(edge)
    while path.size:
        step = rng.exponential(1 / b, path.size)
        position, path = position + direction * step[:, None], path + step
        r = np.linalg.norm(position, axis=1)
        back = np.arccos(np.clip(-np.sum(direction * position, axis=1) / r, -1.0, 1.0))
        seen = (position[:, 2] / r > np.cos(view_half)) & (back > 0.5 * np.pi)
        weight = phase_density(phase, back[seen]) * np.exp(-a * (path + r)[seen] - b * r[seen]) / r[seen] ** 2
        weight /= 2 * np.pi * (1 - np.cos(view_half))
        first += np.histogram((path + r)[seen], edges, weights=weight)[0]
        second += np.histogram((path + r)[seen], edges, weights=weight**2)[0]
        turn = np.exp(np.interp(rng.random(path.size), cdf, log_edge))
        on = (turn < 0.5 * np.pi) & (path < edges[-1])
        position, path = position[on], path[on]
        direction = turned(rng, direction[on], turn[on])
    return first / photons, np.sqrt(second) / photons
