"""Maximum likelihood with a profile that is learned from the capture: line, halo and curtain of turbid water.

    μ_j = b + a [G((j − c)/s) + T(j − c)],

G the Gaussian of the declared width s integrated over the pixel, and T what all rows have beside it: light that the water
scattered, or a line that is no Gaussian. T is a function of straight pieces between nodes a quarter of a pixel apart, found
from the residuals of all rows, which meet every phase of the pixel; it counts as near zero where they say little. Rows are
fitted one by one (a, b, c), T between them, in turns. A displacement of T cannot be told from one of all lines: the mean of c
is that of the fit without T.

Source: J. Anderson and I. R. King, Publications of the Astronomical Society of the Pacific 112:1360, 2000 (the effective point
spread of stars), for lines and with the Gaussian as a start.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
import xarray as xr

from ...optics.sheet import gaussian_mean
from ..registry import estimator
from .frames import OffFrames
from .profile_fit import fit_profiles
from .windows import Windows, answered, line_windows

__all__ = ["line_template"]

Float = npt.NDArray[np.float64]

#: Nodes of T per pixel; turns of rows and template; steps of a row in each, and after them.
_NODES, _TURNS, _STEPS, _LAST = 4, 6, 2, 6
#: Standard deviation of T and of its second difference before the capture is seen, in units of the whole line.
_PRIOR, _ROUGHNESS = 0.3, 0.02
#: A step of c is cut to this [px]; rows whose last one is longer have not converged.
_CUT_PX, _STILL_PX = 0.3, 2e-3


@estimator(
    "line", joint=True, cites="J. Anderson and I. R. King, PASP 112:1360, 2000 (effective point spread), for lines"
)
def line_template(
    capture: xr.Dataset, *, returns: int = 1, off_frames: OffFrames = "unused", least_sigmas: float = 5.0
) -> xr.Dataset:
    """c, a, b of every row under μ_j = b + a [G((j − c)/s) + T(j − c)], T common to all, with the weights of `line_ml`.

    Returns column, sigma [px], valid (frame, row, return). sigma is that of the row's own noise, and of what it gives T. For
    water that scatters light beside the line; rows of one capture should be alike but for their light. Other arguments as of
    `line_ml`.
    """
    windows = line_windows(capture, least_sigmas=least_sigmas, returns=returns, off_frames=off_frames)
    first, _, good = fit_profiles(
        windows.z, windows.level, windows.floor_e2 / windows.excess, windows.width(), weighted=True, free_width=False
    )
    good = good & windows.sound & np.isfinite(first)
    position, sigma = np.full(first.shape, np.nan), np.full(first.shape, np.nan)
    if good.any():
        found = _Rows(windows, good, first[good])
        template = np.zeros(found.nodes)
        for _ in range(_TURNS):
            for _ in range(_STEPS):
                found.step(template)
            template = found.template()
        for _ in range(_LAST):
            still = found.step(template)
        moved = float(np.mean((found.c - first[good])[still])) if still.any() else 0.0
        position[good], sigma[good] = found.c - moved, found.sigma(still)
        good[good] = still
    return answered(windows, position, sigma * np.sqrt(windows.excess), good)


class _Rows:
    """The rows with a line: their pixels, and a, b, c of each."""

    def __init__(self, windows: Windows, good: npt.NDArray[np.bool_], c: Float) -> None:
        self.z, self.width, self.half = windows.z[good], windows.width()[good], windows.half
        self.floor = np.maximum(windows.level[good], 0.0) + windows.floor_e2 / windows.excess
        self.j = np.arange(-self.half, self.half + 1, dtype=np.float64)
        self.nodes = _NODES * (2 * self.half + 3) + 1
        self.c, self.a, self.b = c.copy(), np.maximum(self.z.sum(axis=1), 1.0), np.zeros(c.size)
        self.inverse = np.zeros((c.size, 3, 3))

    def _place(self) -> tuple[npt.NDArray[np.intp], Float]:
        """(node below, way to the next one in 0 … 1) of every pixel (n, 2h + 1)."""
        at = (self.j - self.c[:, None] + self.half + 1.5) * _NODES
        below = np.clip(np.floor(at).astype(np.intp), 0, self.nodes - 2)
        return below, np.clip(at - below, 0.0, 1.0)

    def _gauss(self, shift: float = 0.0) -> Float:
        u = self.j - self.c[:, None] - shift
        return np.asarray(gaussian_mean(u - 0.5, u + 0.5, self.width[:, None]))

    def step(self, template: Float) -> npt.NDArray[np.bool_]:
        """One Gauss-Newton step of a, b, c of every row; whether that of c was short."""
        below, way = self._place()
        low, high = template[below], template[below + 1]
        shape = self._gauss() + low + way * (high - low)
        slope = (self._gauss(1e-3) - self._gauss(-1e-3)) / 2e-3 - (high - low) * _NODES
        mean = self.a[:, None] * shape + self.b[:, None]
        self.weight = 1.0 / (np.maximum(mean, 0.0) + self.floor[:, None])
        jacobian = np.stack([self.a[:, None] * slope, shape, np.ones_like(shape)])
        normal = np.einsum("inj,nj,knj->nik", jacobian, self.weight, jacobian)
        normal[:, range(3), range(3)] *= 1.0 + 1e-9
        self.inverse = np.linalg.pinv(normal, hermitian=True)
        move = np.einsum("nik,knj,nj->ni", self.inverse, jacobian, self.weight * (self.z - mean))
        self.c += np.clip(move[:, 0], -_CUT_PX, _CUT_PX)
        self.c = np.clip(self.c, -1.0, 1.0)
        self.a, self.b = self.a + move[:, 1], self.b + move[:, 2]
        short = np.abs(move[:, 0]) < _STILL_PX + 0.1 * np.sqrt(self.inverse[:, 0, 0])
        return np.asarray(short & (self.a > 0), bool)

    def template(self) -> Float:
        """T (node) from the residuals of all rows: weighted least squares with its prior."""
        below, way = self._place()
        left = self.z - self.b[:, None] - self.a[:, None] * self._gauss()
        weight = self.weight * self.a[:, None] ** 2
        value = left / self.a[:, None]
        n = self.nodes
        normal, right = np.zeros((n, n)), np.zeros(n)
        parts = ((below, 1.0 - way), (below + 1, way))
        for at, share in parts:
            right += np.bincount(at.ravel(), (weight * share * value).ravel(), n)
            for other, more in parts:
                normal += np.bincount((at * n + other).ravel(), (weight * share * more).ravel(), n * n).reshape(n, n)
        rough = np.diff(np.eye(n), 2, axis=0)
        normal += np.eye(n) / _PRIOR**2 + rough.T @ rough / _ROUGHNESS**2
        return np.asarray(np.linalg.solve(normal, right))

    def sigma(self, still: npt.NDArray[np.bool_]) -> Float:
        """Standard error of c, with the part of the noise that enters T: a share of `_NODES` nodes a pixel over all rows."""
        return np.asarray(np.sqrt(np.maximum(self.inverse[:, 0, 0], 0.0) * (1.0 + _NODES / max(int(still.sum()), 1))))
