"""J(μ), tabulated once per noise model and looked up for millions of samples."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable
from functools import lru_cache
from itertools import pairwise

import numpy as np
from numpy.typing import ArrayLike

from ..reflection.angles import Array
from .fisher_moments import quadratic_information
from .model import NoiseModel
from .sample import information

__all__ = ["InformationTable", "information_table"]

#: Relative error allowed in the interpolation; midpoints that exceed it become nodes.
_TOLERANCE = 3e-4
#: Below this J·μ a sample is saturated: it contains no information.
_DEAD = 1e-7
_LOWEST = 1e-4


def _needs_exact(noise: NoiseModel, mu: float) -> bool:
    """False where the second-order form is accurate to 1e-4: bright, finely digitised, far from clipping."""
    mean, variance = noise.mean_e(mu), noise.well_variance_e2(mu)
    spread = math.sqrt(variance + noise.read_noise_e**2)
    bottom = (0.5 - noise.offset_dn) / noise.gain_dn_per_e
    return (
        mu < (400.0 if noise.intensified else 300.0)
        or mean + 9.0 * spread > noise.ceiling_e
        or mean - 9.0 * spread < bottom
        or spread * noise.gain_dn_per_e < 3.0
    )


def _exact(noise: NoiseModel, mu: float) -> float:
    return information(noise, mu) if _needs_exact(noise, mu) else float(quadratic_information(noise, mu))


class InformationTable:
    """Exact information J(μ) [1/electron²] of a noise model, by cubic interpolation of log J in log μ.

    Nodes from 1e-4 photoelectrons to the saturation of the sample; refined until each midpoint agrees with the exact
    value within 3e-4. Below 1e-4 J is extrapolated with its slope there (flat with read noise, where J tends to a
    constant; 1/μ without). Above the last node J = 0. Zero or negative μ is treated as 1e-12.
    """

    def __init__(self, noise: NoiseModel) -> None:
        from scipy.interpolate import CubicSpline

        self.noise = noise
        known: dict[float, float] = {}

        def at(u: float) -> float:
            if u not in known:
                known[u] = _exact(noise, math.exp(u))
            return known[u]

        top = self._last_node(at)
        lowest = math.log(_LOWEST)
        nodes = sorted({*np.linspace(lowest, top, max(8, math.ceil((top - lowest) / 0.22))).tolist(), *self._edge(top)})
        fresh = list(pairwise(nodes))
        for _ in range(12):
            x = np.array(nodes)
            y = np.log([max(at(float(u)), 1e-300) for u in x])
            spline = CubicSpline(x, y)
            added: list[float] = []
            for a, b in fresh:
                middle = 0.5 * (a + b)
                exact = max(at(middle), 1e-300)
                if exact * math.exp(middle) > _DEAD and abs(float(spline(middle)) - math.log(exact)) > _TOLERANCE:
                    added.append(middle)
            if not added:
                break
            # A new node splits its interval; the slopes of its neighbours change too, but by less than its own correction.
            nodes = sorted({*nodes, *added})
            new = set(added)
            fresh = [(a, b) for a, b in pairwise(nodes) if a in new or b in new]
        # The midpoints that agreed have been evaluated anyway: use them as nodes too.
        x = np.array(sorted(u for u in known if u <= top))
        y = np.log([max(known[float(u)], 1e-300) for u in x])
        self.log_mu: Array = x
        self.log_j: Array = y
        self.slope: Array = np.asarray(CubicSpline(x, y)(x, 1))
        self.mu_max: float = math.exp(top)

    def _last_node(self, at: Callable[[float], float]) -> float:
        """log μ at which saturation leaves `_DEAD` of the information, by bisection."""
        clip = max(self.noise.ceiling_e / self.noise.intensifier_gain, 1e-3)
        low = math.log(clip)
        spread = math.sqrt(self.noise.well_variance_e2(clip) + self.noise.read_noise_e**2)
        high = math.log(clip + 60.0 + 12.0 * spread / self.noise.intensifier_gain)
        while at(high) * math.exp(high) > _DEAD:
            high += 0.5
        for _ in range(9):
            middle = 0.5 * (low + high)
            if at(middle) * math.exp(middle) > _DEAD:
                low = middle
            else:
                high = middle
        return low

    def _edge(self, top: float) -> Iterable[float]:
        """Extra nodes around clipping, where J falls, spaced by half a standard deviation."""
        at = max(self.noise.ceiling_e / self.noise.intensifier_gain, 1e-3)
        spread = math.sqrt(self.noise.well_variance_e2(at) + self.noise.read_noise_e**2) / self.noise.intensifier_gain
        nodes = at + 0.5 * spread * np.arange(-12, 20)
        return [math.log(m) for m in nodes if m > 2.0 * _LOWEST and math.log(m) < top - 1e-6]

    def __call__(self, mu: ArrayLike) -> Array:
        """J [1/electron²] for mean photoelectrons of any shape."""
        from .fisher_kernels import lookup

        m = np.ascontiguousarray(mu, dtype=np.float64)
        out = np.empty(m.size)
        lookup(m.ravel(), self.log_mu, self.log_j, self.slope, out)
        return out.reshape(m.shape)


@lru_cache(maxsize=64)
def information_table(noise: NoiseModel) -> InformationTable:
    """The table of a noise model, built once per process."""
    return InformationTable(noise)
