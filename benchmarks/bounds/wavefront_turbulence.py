"""Bounds of what a wavefront sensor tells of turbulence: r0 at each gate; scales of failure of the rest.

Slopes of F frames are Gaussian with the covariance q C + N, q = r0^{−5/3}. Their information on q is

    I = ½ F Σ_i (e_i/(1 + q e_i))²,

e the eigenvalues of N^{−1/2} C N^{−1/2}, and r0 has the bound .6 r0/(q √I). N is even here: the mean variance of the slopes'
bounds; "quasi", since slopes are estimated and not given.
"""

from __future__ import annotations

from collections.abc import Mapping
from functools import lru_cache

import numpy as np
import numpy.typing as npt
import xarray as xr

from ...optics.turbulence.slopes import gradient_covariance
from ...optics.turbulence.strength import kolmogorov_structure
from ..scores.truth import Bound

__all__ = ["image_bound", "turbulence_bounds"]

Float = npt.NDArray[np.float64]

#: A probability has failed beyond .5, half of this.
_CERTAINTY = 1.0


def turbulence_bounds(
    capture: xr.Dataset, sigma_rad: Float, centre_m: Float, pitch_m: float, k_per_m: float
) -> Mapping[str, Bound]:
    """The bounds of `r0` [m] (gate), "quasi", and the scales of `present` and `source`; {} for a capture without their truth.

    Main arguments:
        sigma_rad (frame, lenslet, axis): bounds of the slopes. centre_m (lenslet, axis), pitch_m, k_per_m: of the lenslets.

    r0 has failed where it is off by itself, or five bounds; a source where it is off by more than the distance of two gates.
    """
    if "truth_r0" not in capture:
        return {}
    delay, truth = np.asarray(capture["delay"].values, np.float64), np.asarray(capture["truth_r0"].values, np.float64)
    eigen = _eigenvalues(centre_m.tobytes(), pitch_m) / k_per_m**2
    bound = np.full(truth.shape, np.nan)
    for gate, at in enumerate(np.unique(delay)):
        if not np.isfinite(truth[gate]):
            continue
        variance = sigma_rad[delay == at] ** 2
        q, frames = truth[gate] ** (-5.0 / 3.0), int((delay == at).sum())
        finite = variance[np.isfinite(variance)]
        e = eigen / float(finite.mean()) if finite.size else np.zeros(1)
        information = 0.5 * frames * float(((e / (1.0 + q * e)) ** 2).sum())
        bound[gate] = 0.6 * truth[gate] / (q * np.sqrt(information)) if information > 0 else np.inf
    scale = 2.0 * float(np.nanmin(truth)) if np.isfinite(truth).any() else 1.0
    step, far = _gates(capture)
    present, source = capture["truth_present"].shape, capture["truth_source"].shape
    return {
        "r0": Bound(bound, "quasi", scale, 10.0 * scale),
        "present": Bound(np.full(present, np.nan), "none", _CERTAINTY, 1.0),
        "source": Bound(np.full(source, np.nan), "none", 2.0 * step, far),
    }


def image_bound(capture: xr.Dataset) -> Mapping[str, Bound]:
    """The scale of failure of the deblurred `image`: half of white; {} for a capture without a chart."""
    if "image" not in capture or "truth_image" not in capture:
        return {}
    return {"image": Bound(np.full(capture["image"].shape, np.nan), "none", 1.0, 1.0)}


@lru_cache(maxsize=8)
def _eigenvalues(centre: bytes, pitch_m: float) -> Float:
    """Eigenvalues, largest first, of the covariance of all lenslets' phase gradients for r0 = 1 m, (rad/m)²."""
    unit = gradient_covariance(lambda r: kolmogorov_structure(r, 1.0), np.frombuffer(centre).reshape(-1, 2), pitch_m)
    return np.asarray(np.maximum(np.linalg.eigvalsh(unit)[::-1], 0.0))


def _gates(capture: xr.Dataset) -> tuple[float, float]:
    """(distance of two gates, range of the farthest) [m]; of one gate its range in place of the distance."""
    from ...estimators.rig import read_rig
    from ...estimators.wavefront.turbulence import gate_ranges_m

    at = gate_ranges_m(read_rig(capture), np.unique(np.asarray(capture["delay"].values, np.float64)))
    step = float(np.diff(at).mean()) if at.size > 1 else float(at[-1])
    return max(step, 1e-6), max(float(at[-1]), 1e-6)
