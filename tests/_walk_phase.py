"""Phase functions of the independent walk (`_walk`), and the cells that choose its angles: nothing here is the generator's.

Sources: Henyey and Greenstein 1941, Astrophys. J. 93, 70; Fournier and Jonasz 1999, Proc. SPIE 3761, 62.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

Float = NDArray[np.float64]

#: Cells of θ, even in ln θ from the first edge to π; below it there is one.
_CELLS, _FIRST = 4096, 1e-9


def henyey_greenstein(g: float, theta: Float) -> Float:
    """p [1/sr] = (1 − g²)/(4π (1 + g² − 2g cosθ)^{3/2}), with 1 + g² − 2g cosθ = (1 − g)² + 4g sin²(θ/2)."""
    return np.asarray((1 - g * g) / (4 * np.pi * ((1 - g) ** 2 + 4 * g * np.sin(0.5 * theta) ** 2) ** 1.5))


def fournier_forand(index: float, slope: float, theta: Float) -> Float:
    """p [1/sr] of particles of relative index n and Junge slope μ: ν = (3 − μ)/2, δ = 4 sin²(θ/2)/(3(n − 1)²),

    p = [ν(1 − δ) − (1 − δ^ν) + (δ(1 − δ^ν) − ν(1 − δ))/sin²(θ/2)]/(4π(1 − δ)² δ^ν)
        + (1 − δ_π^ν)(3cos²θ − 1)/(16π(δ_π − 1) δ_π^ν).
    """
    nu, s = (3 - slope) / 2, np.sin(0.5 * theta) ** 2
    top = 4 / (3 * (index - 1) ** 2)
    delta = top * s
    power = delta**nu
    near = (nu * (1 - delta) - (1 - power) + (delta * (1 - power) - nu * (1 - delta)) / s) / (
        4 * np.pi * (1 - delta) ** 2 * power
    )
    far = (1 - top**nu) / (16 * np.pi * (top - 1) * top**nu) * (3 * np.cos(theta) ** 2 - 1)
    return np.asarray(near + far)


class Turns(NamedTuple):
    """A phase function: `first` edge and `step` in ln θ of cells, ln p at their edges, and three densities of θ that are constant
    in each cell, with their integrals up to the edges: `law` ∝ p sinθ, `lobe` ∝ H, and `turn` = p, whose integral is not
    one. All that kernels know of the cells is here: a number of this file in their code would be stale after an edit."""

    first: float
    step: float
    edge: Float
    log_p: Float
    law: Float
    law_sum: Float
    lobe: Float
    lobe_sum: Float
    turn: Float
    turn_sum: Float


def turns_of(p: Callable[[Float], Float]) -> Turns:
    """The cells of p(θ). They only choose angles: every weight holds p itself."""
    step = float(np.log(np.pi / _FIRST) / _CELLS)
    edge = np.concatenate([[0.0], _FIRST * np.exp(step * np.arange(_CELLS + 1))])
    edge[-1] = np.pi
    at = np.concatenate([[0.5 * _FIRST], np.sqrt(edge[1:-1] * edge[2:])])
    width, value = np.diff(edge), p(at)
    rest = np.cumsum((value * width)[::-1])[::-1]
    law = value * np.sin(at) / (value * np.sin(at) @ width)
    lobe = rest / (rest @ width)
    sums = [np.concatenate([[0.0], np.cumsum(density * width)]) for density in (law, lobe, value)]
    return Turns(_FIRST, step, edge, np.log(p(edge[1:])), law, sums[0], lobe, sums[1], value, sums[2])
