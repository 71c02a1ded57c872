"""Random fields on a grid whose structure function is right at every lag: intrinsic circulant embedding (Stein 2002).

For a structure function D and lags up to ℓ (the diagonal of the grid), in units of ℓ:

    φ(r) = c₀ − D(r)/2 + c₂ r²  (r ≤ 1),    β (R − r)³/r  (1 ≤ r ≤ R),    0  (r > R),

with c₀, c₂, β such that φ, φ' and φ'' are continuous at 1. φ is summed over a torus of period ≥ R + the grid's length, so that its
images do not reach the lags in use, and a field G of that covariance is drawn by FFT. Then

    Z(x) = G(x) − G(0) + √(2 c₂) (N₁ x + N₂ y)

has the structure function D, exactly, where the torus has no negative power. For D = r^{5/3}, R = 2 has none. The share that had to
be clipped is kept with the plan, and `ScreenPlan.structure` is D as the plan realises it, with no sampling.

Sources: M. L. Stein, J. Comput. Graph. Stat. 11:587, 2002; T. Gneiting et al., J. Comput. Graph. Stat. 15:483, 2006.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.fft import irfft2, next_fast_len, rfft2

__all__ = ["ScreenPlan", "covariance_plan", "structure_plan"]

Float = NDArray[np.float64]
Complex = NDArray[np.complex128]
Radial = Callable[[Float], Float]


@dataclass(frozen=True, eq=False)
class ScreenPlan:
    """How fields of one shape and structure function are drawn.

    Main arguments:
        root (rows, cols//2 + 1): square roots of the torus' eigenvalues [rad]. period (2): rows and columns of the torus.
        shape (2): rows and columns of a screen. spacing_m: distance of its points. tilt_rad_per_m: rms of the random tilt per axis.
        clipped: sum of the negative eigenvalues over the sum of all magnitudes, which were set to zero; 0 where D is exact.
    """

    root: Float
    period: tuple[int, int]
    shape: tuple[int, int]
    spacing_m: float
    tilt_rad_per_m: float
    clipped: float

    def scaled(self, factor: float) -> ScreenPlan:
        """The plan of a field `factor` times as large."""
        return ScreenPlan(
            self.root * factor, self.period, self.shape, self.spacing_m, self.tilt_rad_per_m * factor, self.clipped
        )

    def structure(self) -> Float:
        """D [rad²] (rows, cols) between the points (0, 0) and (row, col), as the plan realises it: no sampling."""
        covariance = self.covariance()
        y, x = (self.spacing_m * np.arange(n) for n in self.shape)
        radius2 = y[:, None] ** 2 + x[None, :] ** 2
        return np.asarray(2.0 * (covariance[0, 0] - covariance) + self.tilt_rad_per_m**2 * radius2)

    def covariance(self) -> Float:
        """Covariance [rad²] (rows, cols) of the field on the torus between (0, 0) and (row, col), without the random tilt."""
        return np.asarray(irfft2(self.root**2, s=self.period)[: self.shape[0], : self.shape[1]])

    def draw(self, rng: np.random.Generator) -> Float:
        """One screen (rows, cols) [rad], its mean removed: the mean is not defined for unlimited outer scales."""
        screen = self.field(self.noise(rng))
        return np.asarray(screen - screen.mean())

    def noise(self, rng: np.random.Generator) -> tuple[Complex, Float]:
        """The random numbers of one screen: the torus' spectrum, and the two tilts [rad/m] along x and y."""
        white = rng.standard_normal(self.period)
        return self.root * rfft2(white, overwrite_x=True), self.tilt_rad_per_m * rng.standard_normal(2)

    def field(self, noise: tuple[Complex, Float], shift_m: tuple[float, float] = (0.0, 0.0)) -> Float:
        """The screen (rows, cols) [rad] of such numbers, seen from a window moved by `shift_m` (x, y) over the torus.

        Exact for whole points, trigonometric interpolation between them. The window must stay within the torus' part that the
        plan's shape allows for: plan for the larger shape.
        """
        spectrum, tilt = noise
        if shift_m[0] or shift_m[1]:
            spectrum = spectrum * _moved(self.period, shift_m[0] / self.spacing_m, shift_m[1] / self.spacing_m)
        field = irfft2(spectrum, s=self.period)[: self.shape[0], : self.shape[1]]
        y, x = (self.spacing_m * np.arange(n) for n in self.shape)
        return np.asarray(field + tilt[0] * (x[None, :] + shift_m[0]) + tilt[1] * (y[:, None] + shift_m[1]))


def structure_plan(
    structure: Radial,
    shape: tuple[int, int],
    spacing_m: float,
    *,
    limit: float = 2.0,
    slopes: tuple[float, float] | None = None,
) -> ScreenPlan:
    """Plan of a field with structure function `structure` (m → rad²) by intrinsic embedding.

    Main arguments:
        structure: D of arrays of separations [m]. shape: rows, columns. spacing_m: distance of the points.

    Other arguments:
        limit: R, in diagonals of the grid. slopes: D' and D'' at the diagonal [rad²/m, rad²/m²]; by differences if not given.

    Raises ValueError where D bends the wrong way for a random tilt (an outer scale below the diagonal: use `covariance_plan`).
    """
    rows, cols = _shape(shape, spacing_m)
    reach = spacing_m * float(np.hypot(rows - 1, cols - 1)) or spacing_m
    first, second = slopes if slopes is not None else _slopes(structure, reach)
    value = float(structure(np.array([reach]))[0])
    # −D/2 takes the place of −r^α: Stein's conditions in units of the diagonal.
    b1, b2 = -0.5 * first * reach, -0.5 * second * reach**2
    over = limit - 1.0
    beta = (b2 - b1) / (3.0 * over * limit * (limit + 1.0))
    c2 = 0.5 * (-beta * (3.0 * over**2 + over**3) - b1)
    c0 = beta * over**3 + 0.5 * value - c2
    if c2 < 0.0 or beta < 0.0:
        raise ValueError(
            "The structure function flattens within the grid's diagonal: embed its covariance (covariance_plan)."
        )

    def tail(distance: Float) -> Float:
        r = distance / reach
        inner = c0 - 0.5 * structure(np.minimum(distance, reach)) + c2 * r**2
        outer = beta * np.maximum(limit - r, 0.0) ** 3 / np.maximum(r, 1.0)
        return np.where(r <= 1.0, inner, outer)

    least = [int(np.ceil(limit * reach / spacing_m)) + n for n in (rows, cols)]
    root, period, clipped = _torus(tail, (least[0], least[1]), spacing_m, limit * reach)
    return ScreenPlan(root, period, (rows, cols), spacing_m, float(np.sqrt(2.0 * c2)) / reach, clipped)


def covariance_plan(covariance: Radial, shape: tuple[int, int], spacing_m: float, support_m: float) -> ScreenPlan:
    """Plan of a stationary field with this covariance (m → rad²), negligible beyond `support_m` [m], where it is cut.

    No random tilt is needed. What the cut makes of the spectrum is seen in `clipped`.
    """
    rows, cols = _shape(shape, spacing_m)
    cells = int(np.ceil(support_m / spacing_m))
    root, period, clipped = _torus(covariance, (rows + cells, cols + cells), spacing_m, support_m)
    return ScreenPlan(root, period, (rows, cols), spacing_m, 0.0, clipped)


def _torus(
    covariance: Radial, least: tuple[int, int], spacing_m: float, support_m: float
) -> tuple[Float, tuple[int, int], float]:
    """Roots of the eigenvalues of the covariance summed over a torus of at least this size, its size, and the clipped share."""
    period = (next_fast_len(least[0], real=True), next_fast_len(least[1], real=True))
    # A quarter of the torus holds all values.
    total = np.zeros((period[0] // 2 + 1, period[1] // 2 + 1))
    images = [int(np.ceil(support_m / spacing_m / n)) for n in period]
    axis = [np.arange(n // 2 + 1) for n in period]
    for i in range(-images[0], images[0] + 1):
        y = (axis[0] + i * period[0]) * spacing_m
        if np.abs(y).min() > support_m:
            continue
        for j in range(-images[1], images[1] + 1):
            x = (axis[1] + j * period[1]) * spacing_m
            if np.hypot(np.abs(y).min(), np.abs(x).min()) > support_m:
                continue
            distance = np.hypot(y[:, None], x[None, :])
            near = distance <= support_m
            total[near] += covariance(distance[near])
    fold = [np.minimum(np.arange(n), n - np.arange(n)) for n in period]
    power = rfft2(total[fold[0]][:, fold[1]]).real
    whole = float(np.abs(power).sum())
    clipped = float(np.maximum(-power, 0.0).sum() / whole) if whole > 0 else 0.0
    return np.sqrt(np.maximum(power, 0.0)), period, clipped


def _moved(period: tuple[int, int], shift_x: float, shift_y: float) -> Complex:
    """Factor of a real half spectrum that moves the window by points (x, y); at the Nyquist frequency its real part."""
    phase = []
    for n, shift, frequency in (
        (period[0], shift_y, np.fft.fftfreq(period[0])),
        (period[1], shift_x, np.fft.rfftfreq(period[1])),
    ):
        factor = np.exp(2j * np.pi * frequency * shift)
        if n % 2 == 0:
            factor[n // 2] = factor[n // 2].real
        phase.append(factor)
    return np.asarray(phase[0][:, None] * phase[1][None, :])


def _slopes(structure: Radial, at_m: float) -> tuple[float, float]:
    """D' and D'' by central differences of fourth order."""
    h = 1e-3 * at_m
    f = structure(np.asarray(at_m + h * np.arange(-2, 3), np.float64))
    first = float((f[0] - 8 * f[1] + 8 * f[3] - f[4]) / (12 * h))
    return first, float((-f[0] + 16 * f[1] - 30 * f[2] + 16 * f[3] - f[4]) / (12 * h * h))


def _shape(shape: tuple[int, int], spacing_m: float) -> tuple[int, int]:
    rows, cols = (int(n) for n in shape)
    if rows < 1 or cols < 1:
        raise ValueError(f"shape must be two whole numbers of at least 1, not {shape!r}.")
    if not (spacing_m > 0 and np.isfinite(spacing_m)):
        raise ValueError(f"spacing_m must be positive and finite, not {spacing_m!r}.")
    return rows, cols
