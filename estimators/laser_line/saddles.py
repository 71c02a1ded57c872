"""Corners of a checkerboard: places where an image is a saddle, and their coordinates to a hundredth of a pixel.

Found where the Hessian of the smoothed image has eigenvalues of both signs, and where the image on a circle goes through light
and dark twice. Then, in a window around each, the image of two crossing edges is fitted by least squares,

    z(x, y) = B + g·(x, y) + A erf(d₁/(√2 s)) erf(d₂/(√2 s)),    d_i = (x − x₀) sinθ_i − (y − y₀) cosθ_i,

s the blur of the edges and g an uneven light. Source: L. Lucchese and S. K. Mitra, Proc. APCCAS 2:29, 2002 (saddle points);
A. Geiger et al., Proc. ICRA 2012, p. 3936 (two edges).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from scipy.ndimage import gaussian_filter, map_coordinates, maximum_filter
from scipy.special import erf

__all__ = ["Corners", "fit_saddles", "saddle_places"]

Float = npt.NDArray[np.float64]

#: Points on the circle that is read around a candidate.
_AROUND = 32
#: Least share of the second and sixth harmonic in what varies around a corner. Around an ideal one it is .95 or more.
_LEAST_SHARE = 0.7
#: Parameters of a fit: x₀, y₀, θ₁, θ₂, ln s, A, B, g_x, g_y.
_FREE = 9
_ROOT2, _ROOT_PI = np.sqrt(2.0), np.sqrt(np.pi)


@dataclass(frozen=True, eq=False)
class Corners:
    """Fitted corners: `place` (n, 2) row and column [px], `sigma` (n, 2) their standard errors, from the residuals of the fit;
    `angle` (n, 2) directions of the two edges from the columns' axis toward the rows' [rad], `good` (n) whether the fit holds."""

    place: Float
    sigma: Float
    angle: Float
    good: npt.NDArray[np.bool_]


def saddle_places(image: Float, *, blur_px: float = 2.0, radius_px: float = 6.0, least: float = 0.05) -> Float:
    """Rows and columns (n, 2) of what looks like the crossing of two edges, the strongest first.

    Main arguments:
        image (rows, cols): light, in any unit.
    Other arguments:
        blur_px: smoothing before the derivatives. radius_px: of the circle. least: strength √(−det Hessian), relative to the
            strongest.
    """
    smooth = gaussian_filter(np.asarray(image, np.float64), blur_px)
    d_row, d_col = np.gradient(smooth)
    rr, rc = np.gradient(d_row)
    cc = np.gradient(d_col, axis=1)
    strength = np.sqrt(np.maximum(rc * rc - rr * cc, 0.0))
    edge = int(np.ceil(radius_px)) + 1
    strength[:edge], strength[-edge:], strength[:, :edge], strength[:, -edge:] = 0.0, 0.0, 0.0, 0.0
    top = (strength == maximum_filter(strength, int(2 * radius_px) + 1)) & (strength > 0)
    place = np.argwhere(top).astype(np.float64)
    if not place.size:
        return place
    place = place[_crossing(smooth, place, radius_px)]
    found = strength[tuple(place.astype(int).T)]
    if not found.size:
        return place
    # The strongest may be a speck: the strength of a board's corners is that of many.
    bright = np.sort(found)[-min(found.size, 8) :].min()
    place, found = place[found >= least * bright], found[found >= least * bright]
    return np.asarray(place[np.argsort(-found)])


def _crossing(image: Float, place: Float, radius_px: float) -> npt.NDArray[np.bool_]:
    """Whether the image on a circle around each place (n) goes through light and dark twice, evenly."""
    angle = 2.0 * np.pi * np.arange(_AROUND) / _AROUND
    row = place[:, :1] + radius_px * np.sin(angle)
    col = place[:, 1:] + radius_px * np.cos(angle)
    ring = map_coordinates(image, [row, col], order=1, mode="nearest")
    power = np.abs(np.fft.rfft(ring, axis=1)) ** 2
    whole = power[:, 1:].sum(axis=1)
    with np.errstate(invalid="ignore", divide="ignore"):
        share = (power[:, 2] + power[:, 6]) / whole
    return np.asarray((whole > 0) & (share >= _LEAST_SHARE))


def fit_saddles(image: Float, place: Float, half_px: npt.NDArray[np.int64], *, steps: int = 40) -> Corners:
    """Fit of two crossing edges around each place.

    Main arguments:
        image (rows, cols); place (n, 2): row and column [px], to 2 px. half_px (n): half the window of each.

    Not good: windows that leave the image or hold a value that is not finite, fits that do not converge, that move by more than
    half their window, or whose edges cross at less than 15 degrees.
    """
    made = Corners(
        np.array(place, np.float64), np.full(place.shape, np.nan), np.full(place.shape, np.nan),
        np.zeros(len(place), bool),
    )  # fmt: skip
    for half in np.unique(half_px):
        own = np.flatnonzero(half_px == half)
        window, whole = _windows(image, made.place[own], int(half))
        own, window = own[whole], window[whole]
        if own.size:
            start = np.rint(made.place[own])
            p, sigma, good = _fit(window, int(half), steps, made.place[own] - start)
            made.place[own] = start + p[:, 1::-1]
            made.sigma[own] = sigma[:, ::-1]
            made.angle[own] = p[:, 2:4]
            made.good[own] = good
    return made


def _windows(image: Float, place: Float, half: int) -> tuple[Float, npt.NDArray[np.bool_]]:
    """(pixels (n, (2h + 1)²) about each place, whether all are there and finite)."""
    at = np.rint(place).astype(np.int64)
    inside = (at >= half).all(axis=1) & (at < np.array(image.shape) - half).all(axis=1)
    reach = np.arange(-half, half + 1)
    row = np.clip(at[:, 0, None, None] + reach[:, None], 0, image.shape[0] - 1)
    col = np.clip(at[:, 1, None, None] + reach, 0, image.shape[1] - 1)
    window = np.asarray(image[row, col], np.float64).reshape(len(place), -1)
    return window, np.asarray(inside & np.isfinite(window).all(axis=1))


def _fit(z: Float, half: int, steps: int, offset: Float) -> tuple[Float, Float, npt.NDArray[np.bool_]]:
    """Levenberg-Marquardt on all windows at once: (parameters (n, 9), standard errors of x₀ and y₀, whether they hold)."""
    reach = np.arange(-half, half + 1, dtype=np.float64)
    y, x = (part.ravel() for part in np.meshgrid(reach, reach, indexing="ij"))
    p = _first(z, half, x, y, offset)
    damping = np.full(len(z), 1e-3)
    model, grad = _model(p, x, y)
    cost = ((z - model) ** 2).sum(axis=1)
    for _ in range(steps):
        normal = np.einsum("nak,nbk->nab", grad, grad)
        slope = np.einsum("nak,nk->na", grad, z - model)
        diagonal = np.einsum("naa->na", normal)
        step = _solved(normal + (damping[:, None] * diagonal + 1e-30)[:, :, None] * np.eye(_FREE), slope)
        trial = p + np.clip(step, -1.0 * half, 1.0 * half)
        new_model, new_grad = _model(trial, x, y)
        new_cost = ((z - new_model) ** 2).sum(axis=1)
        better = new_cost <= cost * (1.0 + 1e-12)
        moved = np.where(better, np.abs(trial[:, :2] - p[:, :2]).max(axis=1), np.inf)
        p = np.where(better[:, None], trial, p)
        model, grad = np.where(better[:, None], new_model, model), np.where(better[:, None, None], new_grad, grad)
        cost = np.where(better, new_cost, cost)
        damping = np.clip(np.where(better, 0.2, 8.0) * damping, 1e-9, 1e9)
        if (np.minimum(moved, np.where(damping > 1e8, 0.0, np.inf)) < 1e-6).all():
            break
    normal = np.einsum("nak,nbk->nab", grad, grad)
    inverse = _solved(normal + 1e-30 * np.eye(_FREE), np.broadcast_to(np.eye(_FREE), normal.shape))
    variance = cost / (z.shape[1] - _FREE)
    sigma = np.sqrt(np.maximum(np.einsum("naa->na", inverse)[:, :2], 0.0) * variance[:, None])
    apart = np.abs(np.sin(p[:, 2] - p[:, 3]))
    good = np.isfinite(p).all(axis=1) & np.isfinite(sigma).all(axis=1) & (sigma < 1.0).all(axis=1)
    good &= (np.abs(p[:, :2]).max(axis=1) <= 0.5 * half) & (apart > np.sin(np.deg2rad(15.0)))
    good &= np.abs(p[:, 5]) > 3.0 * np.sqrt(variance)
    return p, np.maximum(sigma, 1e-9), good


def _solved(a: Float, b: Float) -> Float:
    """x of a x = b, (n, 9, 9) and (n, 9) or (n, 9, m); NaN where a has no inverse."""
    try:
        return np.asarray(np.linalg.solve(a, b[..., None])[..., 0] if b.ndim == 2 else np.linalg.solve(a, b))
    except np.linalg.LinAlgError:
        return np.asarray(np.einsum("nab,nb...->na...", np.linalg.pinv(a), b))


def _first(z: Float, half: int, x: Float, y: Float, offset: Float) -> Float:
    """Parameters to begin with: edges from the sign changes around the place."""
    side = 2 * half + 1
    angle = 2.0 * np.pi * np.arange(_AROUND) / _AROUND
    radius = 0.7 * half
    grid = z.reshape(-1, side, side)
    row, col = half + radius * np.sin(angle), half + radius * np.cos(angle)
    n = len(z)
    at = np.broadcast_to(np.arange(n)[:, None], (n, _AROUND))
    row = np.clip(row + offset[:, :1], 0, side - 1)
    col = np.clip(col + offset[:, 1:], 0, side - 1)
    ring = map_coordinates(grid, [at, row, col], order=1, mode="nearest")
    # Opposite points are alike: their mean is free of uneven light. Its sign changes are the edges.
    mean = 0.5 * (ring + np.roll(ring, _AROUND // 2, axis=1))
    mean = mean - mean.mean(axis=1, keepdims=True)
    harmonic = (mean * np.exp(-2j * angle)).sum(axis=1)
    crest = -0.5 * np.angle(harmonic)  # the middle of a light sector
    p = np.zeros((n, _FREE))
    p[:, 0], p[:, 1] = offset[:, 1], offset[:, 0]
    p[:, 2], p[:, 3] = crest - 0.25 * np.pi, crest + 0.25 * np.pi
    p[:, 2:4] = _edges(mean, angle, crest)
    p[:, 4] = 0.0
    low, high = np.percentile(z, 10, axis=1), np.percentile(z, 90, axis=1)
    p[:, 6] = 0.5 * (low + high)
    # The light sector lies between the edges, where d₁ and d₂ have opposite signs.
    d1 = np.sin(p[:, 2]) * np.cos(crest) - np.cos(p[:, 2]) * np.sin(crest)
    d2 = np.sin(p[:, 3]) * np.cos(crest) - np.cos(p[:, 3]) * np.sin(crest)
    p[:, 5] = 0.5 * (high - low) * np.sign(d1 * d2)
    return p


def _edges(mean: Float, angle: Float, crest: Float) -> Float:
    """Directions (n, 2) of the edges: where the light on the circle passes its mean, before and after the crest."""
    fine = np.linspace(0.0, 0.5 * np.pi, 46)
    found = np.empty((len(mean), 2))
    step = angle[1]
    for number, sign in enumerate((-1.0, 1.0)):
        at = (crest[:, None] + sign * fine) / step
        whole = np.floor(at).astype(np.int64)
        part = at - whole
        take = np.take_along_axis
        value = (1.0 - part) * take(mean, whole % _AROUND, axis=1) + part * take(mean, (whole + 1) % _AROUND, axis=1)
        below = value < 0
        first = np.where(below.any(axis=1), below.argmax(axis=1), 22)
        found[:, number] = crest + sign * fine[first]
    return found


def _model(p: Float, x: Float, y: Float) -> tuple[Float, Float]:
    """The image (n, k) and its gradient (n, 9, k) by the parameters."""
    x0, y0, t1, t2, ln_s, a, b, gx, gy = (p[:, i, None] for i in range(_FREE))
    dx, dy, s = x - x0, y - y0, np.exp(np.clip(ln_s, -3.0, 3.0))
    s1, c1, s2, c2 = np.sin(t1), np.cos(t1), np.sin(t2), np.cos(t2)
    d1, d2 = dx * s1 - dy * c1, dx * s2 - dy * c2
    e1, e2 = erf(d1 / (_ROOT2 * s)), erf(d2 / (_ROOT2 * s))
    f1, f2 = (_ROOT2 / (_ROOT_PI * s) * np.exp(-0.5 * (d / s) ** 2) for d in (d1, d2))
    along1, along2 = a * f1 * e2, a * e1 * f2
    grad = np.stack(
        [
            -along1 * s1 - along2 * s2, along1 * c1 + along2 * c2, along1 * (dx * c1 + dy * s1),
            along2 * (dx * c2 + dy * s2), -(along1 * d1 + along2 * d2), e1 * e2, np.ones_like(d1),
            np.broadcast_to(x, d1.shape), np.broadcast_to(y, d1.shape),
        ],
        axis=1,
    )  # fmt: skip
    return b + gx * x + gy * y + a * e1 * e2, grad
