"""Turbulence from slopes: whether there is any, how strong, and at which range, from the light of one gate or several.

A gate is a delay that frames have in common. Its light comes from a reflector at range r and has passed the water from 0 to r, so
that a gate does not select a layer. Where the turbulence is follows from what is added between successive gates: with W the
strength at the array per strength of a layer between two gates (4 before a mirror, an integral of (1 − z/r)^{5/3} before a diffuse
target), the layers' strengths are the x ≥ 0 of least Σ((q − W x)/σ)².
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
import xarray as xr

from ...optics.constants import C_M_PER_S
from ...optics.turbulence.detection import Strength, layer_shares, layer_strengths, range_weights
from ..registry import estimator
from ..result import stage_result
from ..rig import DeclaredRig
from .geometry import declared_geometry
from .modal import check_square, read_slopes
from .strengths import shared_lenslets, strength_of

__all__ = ["gate_ranges_m", "turbulence_ml"]

Float = npt.NDArray[np.float64]

#: Standard errors of a 95 % interval's half, and by how many of its own the strongest layer must stand out of no turbulence.
_HALF = 1.96
#: A probability is no nearer to 0 or 1: so far out in its tails nobody knows the likelihood.
_CERTAIN = 1e-6


@estimator(
    "turbulence",
    cites="S. S. Wilks, Ann. Math. Stat. 9:60, 1938 (interval); "
    "C. L. Lawson and R. J. Hanson, Solving Least Squares Problems, 1974 (x ≥ 0)",
    joint=True,
)
def turbulence_ml(slopes: xr.Dataset, rig: DeclaredRig, coordinates: xr.Dataset) -> xr.Dataset:
    """Kolmogorov's r0 of the wavefront at the array by maximum likelihood of the slopes' covariance, for every gate.

    Main arguments: slopes [rad] and their standard errors; the declared rig; coordinates with `delay` [s] (frame).

    Returns r0, sigma [m], valid (gate), gates in the order of their delays. sigma is the half 95 % interval of the likelihood ratio
    over 1.96; r0 is invalid where this interval holds no turbulence, or where the gate's frames share fewer than half of their
    lenslets. present (gate): probability of turbulence if half of the captures have some, ln r0 even from .01 to 100 diameters of
    the pupil, and 1e-6 or more from 0 and 1; sigma_present = √(P(1 − P)). source [m] (layer): middle m of the interval
    between gates whose layer is strongest; sigma_source² = Σ p_k ((m_k − m)² + (w_k/2)²), p_k the probability that interval
    k, w_k wide about m_k, holds the strongest (`layer_shares`). Gates do not tell where in its interval a layer is; half of
    its width is the error at the ends, where a reflector is that water flows past, and of layers anywhere in it the error is
    w/√12. It is invalid for one gate, for a rig that does not declare the gate's centre, and where this layer is less than
    1.96 of its standard errors above 0.
    """
    check_square(declared_geometry(rig), "turbulence-ml", "the covariance of slopes is that of squares")
    own, variance, valid = read_slopes(slopes, declared_geometry(rig))
    delay = np.asarray(coordinates["delay"].values, np.float64)
    gates = np.unique(delay)
    found: list[tuple[Strength, float] | None] = []
    for gate in gates:
        held = (delay == gate) & (2 * valid.sum(axis=1) > valid.shape[1])
        use = bool(held.any()) and shared_lenslets(valid[held]) is not None
        found.append(strength_of(rig, own[held], variance[held], valid[held]) if use else None)
    r0, sigma = (np.full(gates.size, np.nan) for _ in range(2))
    present = np.full(gates.size, np.nan)
    for number, one in enumerate(found):
        if one is None:
            continue
        present[number] = min(max(one[1], _CERTAIN), 1.0 - _CERTAIN)
        low, high = one[0].r0_interval_m
        if np.isfinite(high):
            r0[number], sigma[number] = one[0].r0_m, (high - low) / (2.0 * _HALF)
    source, sigma_source = _source(rig, gates, [one[0] for one in found if one is not None])
    with np.errstate(invalid="ignore"):
        doubt = np.sqrt(present * (1.0 - present))
    return stage_result(
        "turbulence", r0=r0, sigma=sigma, valid=np.isfinite(r0), present=present, sigma_present=doubt,
        valid_present=np.isfinite(present), source=np.array([source]), sigma_source=np.array([sigma_source]),
        valid_source=np.array([np.isfinite(source)]),
    )  # fmt: skip


def gate_ranges_m(rig: DeclaredRig, delay_s: Float) -> Float:
    """Range [m] whose light falls in the middle of a gate: c(t + centre)/2n_g, less the bench's arms."""
    arms = rig.number("bench.laser_arm_m", least=0) + rig.number("bench.camera_arm_m", least=0)
    travelled = C_M_PER_S * (delay_s + rig.number("gate.centre_s")) - arms
    return np.asarray(travelled / (2.0 * rig.number("medium.group_index", above=0)))


def _source(rig: DeclaredRig, gates: Float, strengths: list[Strength]) -> tuple[float, float]:
    """(middle of the interval between gates whose layer is strongest, its error) [m]; NaN where none can be told."""
    if gates.size < 2 or len(strengths) < gates.size or rig.get("gate.centre_s") is None:
        return np.nan, np.nan
    edge = np.concatenate([[0.0], gate_ranges_m(rig, gates)])
    if not (np.diff(edge) > 0).all():
        return np.nan, np.nan
    reflection = "diffuse" if rig.word("reflection", "mirror", "diffuse") == "diffuse" else "mirror"
    weight = range_weights(edge[1:], edge, reflection)  # type: ignore[arg-type]
    q, sigma = np.array([one.q for one in strengths]), np.array([one.sigma for one in strengths])
    layer = layer_strengths(q, sigma, weight)
    error = np.sqrt(np.diagonal(np.linalg.pinv((weight / sigma[:, None] ** 2).T @ weight)))
    best = int(np.argmax(layer))
    if not layer[best] > _HALF * error[best]:
        return np.nan, np.nan
    middle, half = 0.5 * (edge[1:] + edge[:-1]), 0.5 * np.diff(edge)
    share = layer_shares(strengths, weight)
    return float(middle[best]), float(np.sqrt((share * ((middle - middle[best]) ** 2 + half**2)).sum()))
