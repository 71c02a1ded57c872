"""Maximum likelihood of the declared spot in the pixels of a cell, compiled: Levenberg-Marquardt for every spot alone.

    μ_ij = A P(x_j − cx) P(y_i − cy),    weights 1/(F²(μ + B) + σ²), anew in each step,

over cx, cy and A. P and its slope come from tables with `fine` nodes per pixel, linear between them.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from ...optics.jit import kernel

__all__ = ["fit_spots", "light_of_others"]

Float = npt.NDArray[np.float64]


def fit_spots(
    z: Float, x: Float, y: Float, inside: npt.NDArray[np.bool_], level: Float, start: Float,
    tables: tuple[Float, Float], origin: float, fine: int, excess: float, floor_e2: float, steps: int,
) -> tuple[Float, Float, npt.NDArray[np.bool_], Float]:  # fmt: skip
    """(position [px] (spot, axis), variance [px²] (spot, axis), whether the fit converged (spot), photoelectrons (spot)).

    Main arguments:
        z (spot, w, w): photoelectrons above the background `level` (spot, w, w). x, y (spot, w): pixels from the declared place.
        start (spot, 3): cx, cy, A to begin with. tables: P and dP/du from u = `origin` on.
    """
    out = np.empty((6, len(z)))
    _fit(
        np.ascontiguousarray(z), np.ascontiguousarray(x), np.ascontiguousarray(y), np.ascontiguousarray(inside),
        np.ascontiguousarray(level), np.ascontiguousarray(start), tables[0], tables[1], origin, float(fine), excess, floor_e2,
        steps, out,
    )  # fmt: skip
    return out[:2].T.copy(), out[2:4].T.copy(), out[4] > 0, out[5]


def light_of_others(
    place: Float, near: npt.NDArray[np.int64], position: Float, light: Float, x: Float, y: Float, inside: npt.NDArray[np.bool_],
    share: Float, origin: float, fine: int,
) -> Float:  # fmt: skip
    """Photoelectrons (spot, w, w) of other lenslets' spots in the pixels of every cell: Σ_n A_n P(x_j − c_n) P(y_i − c_n).

    Main arguments:
        place (lenslet, 2): declared places [px]. near (lenslet, k): numbers of the neighbours, −1 for none. position (spot, 2):
            of each spot from its own place; light (spot): its photoelectrons, 0 for none; the spots of several images follow
            each other. x, y (spot, w), inside (spot, w, w): the cells. share: P from u = `origin` on, `fine` nodes per pixel.
    """
    out = np.zeros(inside.shape)
    _others(
        np.ascontiguousarray(place), np.ascontiguousarray(near), np.ascontiguousarray(position), np.ascontiguousarray(light),
        np.ascontiguousarray(x), np.ascontiguousarray(y), np.ascontiguousarray(inside), share, origin, float(fine), out,
    )  # fmt: skip
    return out


@kernel
def _others(place, near, position, light, x, y, inside, share, origin, fine, out):  # type: ignore[no-untyped-def]
    spots, size = x.shape
    lenslets = len(place)
    px, py = np.empty(size), np.empty(size)
    for k in range(spots):
        own = k % lenslets
        for n in near[own]:
            other = k - own + n
            if n < 0 or light[other] == 0.0:
                continue
            away_x = place[n, 0] - place[own, 0] + position[other, 0]
            away_y = place[n, 1] - place[own, 1] + position[other, 1]
            for j in range(size):
                px[j] = _look(share, origin, fine, x[k, j] - away_x)
                py[j] = light[other] * _look(share, origin, fine, y[k, j] - away_y)
            for i in range(size):
                for j in range(size):
                    if inside[k, i, j]:
                        out[k, i, j] += py[i] * px[j]


@kernel
def _look(table, origin, fine, u):  # type: ignore[no-untyped-def]
    at = (u - origin) * fine
    last = table.size - 2
    if at < 0.0 or at > last:
        return 0.0
    node = int(at)
    return table[node] + (at - node) * (table[node + 1] - table[node])


@kernel
def _cost(z, inside, px, py, light, weight):  # type: ignore[no-untyped-def]
    total = 0.0
    for i in range(py.size):
        for j in range(px.size):
            if inside[i, j]:
                total += weight[i, j] * (z[i, j] - light * py[i] * px[j]) ** 2
    return total


@kernel
def _inverse(n, out):  # type: ignore[no-untyped-def]
    """Inverse of a symmetric 3 × 3 matrix; False where there is none."""
    a = n[1, 1] * n[2, 2] - n[1, 2] * n[1, 2]
    b = n[0, 2] * n[1, 2] - n[0, 1] * n[2, 2]
    c = n[0, 1] * n[1, 2] - n[0, 2] * n[1, 1]
    det = n[0, 0] * a + n[0, 1] * b + n[0, 2] * c
    if not det > 1e-12 * n[0, 0] * n[1, 1] * n[2, 2] or not det > 0.0:
        return False
    out[0, 0] = a / det
    out[0, 1] = out[1, 0] = b / det
    out[0, 2] = out[2, 0] = c / det
    out[1, 1] = (n[0, 0] * n[2, 2] - n[0, 2] ** 2) / det
    out[1, 2] = out[2, 1] = (n[0, 2] * n[0, 1] - n[0, 0] * n[1, 2]) / det
    out[2, 2] = (n[0, 0] * n[1, 1] - n[0, 1] ** 2) / det
    return True


@kernel
def _fit(z, x, y, inside, level, start, share, slope, origin, fine, excess, floor, steps, out):  # type: ignore[no-untyped-def]
    spots, size, _ = z.shape
    px, py, dx, dy = np.empty(size), np.empty(size), np.empty(size), np.empty(size)
    qx, qy = np.empty(size), np.empty(size)
    weight = np.empty((size, size))
    normal, damped, inverse = np.empty((3, 3)), np.empty((3, 3)), np.empty((3, 3))
    pull, p, q, g = np.empty(3), np.empty(3), np.empty(3), np.empty(3)
    for k in range(spots):
        out[:, k] = np.nan
        out[4, k] = 0.0
        for a in range(3):
            p[a] = start[k, a]
        damping = 1e-3
        done = False
        for _ in range(steps):
            for j in range(size):
                px[j] = _look(share, origin, fine, x[k, j] - p[0])
                py[j] = _look(share, origin, fine, y[k, j] - p[1])
                dx[j] = _look(slope, origin, fine, x[k, j] - p[0])
                dy[j] = _look(slope, origin, fine, y[k, j] - p[1])
            normal[:] = 0.0
            pull[:] = 0.0
            cost = 0.0
            for i in range(size):
                for j in range(size):
                    if not inside[k, i, j]:
                        continue
                    mu = p[2] * py[i] * px[j]
                    v = max(excess * max(mu + level[k, i, j], 0.0) + floor, 1e-12)
                    w = 1.0 / v
                    weight[i, j] = w
                    g[0] = -p[2] * py[i] * dx[j]
                    g[1] = -p[2] * dy[i] * px[j]
                    g[2] = py[i] * px[j]
                    rest = z[k, i, j] - mu
                    cost += w * rest * rest
                    for a in range(3):
                        pull[a] += w * g[a] * rest
                        for b in range(a, 3):
                            normal[a, b] += w * g[a] * g[b]
            for a in range(3):
                for b in range(a):
                    normal[a, b] = normal[b, a]
                for b in range(3):
                    damped[a, b] = normal[a, b]
                damped[a, a] *= 1.0 + damping
            if not _inverse(damped, inverse):
                break
            for a in range(3):
                step = 0.0
                for b in range(3):
                    step += inverse[a, b] * pull[b]
                if a < 2:
                    step = min(max(step, -0.5), 0.5)
                q[a] = p[a] + step
            for j in range(size):
                qx[j] = _look(share, origin, fine, x[k, j] - q[0])
                qy[j] = _look(share, origin, fine, y[k, j] - q[1])
            moved = max(abs(q[0] - p[0]), abs(q[1] - p[1]))
            # Steps below a thousandth of a pixel change the cost by less than the tables' rounding: they are taken.
            if moved < 1e-3 or _cost(z[k], inside[k], qx, qy, q[2], weight) <= cost:
                for a in range(3):
                    p[a] = q[a]
                damping = max(0.2 * damping, 1e-12)
                if moved < 1e-5 and damping < 0.1:
                    done = True
                    break
            else:
                damping *= 8.0
                if damping > 1e12:
                    done = True
                    break
        if not done or not p[2] > 0.0 or not _inverse(normal, inverse):
            continue
        out[0, k] = p[0]
        out[1, k] = p[1]
        out[2, k] = inverse[0, 0]
        out[3, k] = inverse[1, 1]
        out[4, k] = 1.0
        out[5, k] = p[2]
