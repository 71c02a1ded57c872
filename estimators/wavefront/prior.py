"""Reconstruction with the prior of Kolmogorov turbulence: the most probable coefficients, modes beyond the reported ones included.

ĉ = (Gᵀ N⁻¹ G + C⁻¹)⁻¹ Gᵀ N⁻¹ s over modes 2 … J', C Noll's covariance at the strength that the slopes themselves show, by maximum
likelihood. Modes between the reported ones and J' take what would alias into those.
"""

from __future__ import annotations

from functools import lru_cache

import numpy as np
import numpy.typing as npt
import xarray as xr

from ...optics.turbulence.detection import strength_from_slopes
from ...optics.turbulence.noll import zernike_covariance
from ...optics.turbulence.slopes import gradient_covariance
from ...optics.turbulence.strength import kolmogorov_structure
from ...scenes.errors import InputError
from ..registry import estimator
from ..rig import DeclaredRig
from .geometry import Geometry, declared_geometry
from .modal import last_mode, modal_result, modes_of, read_slopes

__all__ = ["zernike_map"]

Float = npt.NDArray[np.float64]
Bool = npt.NDArray[np.bool_]

#: Most lenslets whose slopes tell the strength: the eigenvalues of twice as many take some tenths of a second.
_MOST = 150
#: Weakest turbulence that is taken as the prior, r0 in diameters of the pupil: weaker is none.
_WEAKEST = 1e3
#: Greatest Noll index of the modes that are estimated along, where the slopes allow for as many.
_ALONG = 153


@lru_cache(maxsize=4)
def _unit(rig: DeclaredRig, chosen: tuple[int, ...]) -> Float:
    """Covariance [rad²] of the slopes of some lenslets for r0 = 1 m."""
    geometry = declared_geometry(rig)
    centre = geometry.centre_m[list(chosen)]
    made = gradient_covariance(lambda r: kolmogorov_structure(r, 1.0), centre, geometry.pitch_m)
    return made / geometry.wavenumber**2


def _strength(rig: DeclaredRig, geometry: Geometry, own: Float, variance: Float, valid: Bool) -> float:
    """r0 [m] by maximum likelihood from the frames' slopes, of lenslets valid in all of them; infinite where none shows."""
    there = np.flatnonzero(valid.all(axis=0))
    if there.size < 2:
        return np.inf
    chosen = tuple(int(i) for i in there[:: max(there.size // _MOST, 1)][:_MOST])
    noise = variance[:, list(chosen)].mean(axis=0).ravel()
    found = strength_from_slopes(own[:, list(chosen)].reshape(len(own), -1), _unit(rig, chosen), noise)
    return found.r0_m


@estimator(
    "reconstruction",
    cites="E. P. Wallner, JOSA 73:1771, 1983 (maximum a posteriori with the turbulence's covariance)",
    joint=True,
)
def zernike_map(slopes: xr.Dataset, rig: DeclaredRig, *, modes: int = 0, r0_m: float = 0.0) -> xr.Dataset:
    """c maximises the posterior of slopes with the noise that they state and of Zernike modes under Kolmogorov turbulence.

    Main arguments: slopes [rad] and their standard errors; the declared rig.
    Other arguments:
        modes: greatest Noll index; 0: that of the rig. r0_m: Fried parameter of the wavefront as it reaches the array; 0:
            estimated from all frames together.

    Returns zernike, sigma [rad rms] (frame, mode) and phase [rad] on the pupil's grid; sigma is that of the posterior, aliasing by
    modes up to 153 included. A frame is invalid where fewer than two of its lenslets are valid.
    Raises InputError for a negative r0.
    """
    if not r0_m >= 0.0:
        raise InputError(
            "A Fried parameter is not negative.", where="r0_m", value=r0_m, allowed="above 0, or 0: estimated"
        )
    geometry = declared_geometry(rig)
    last = last_mode(rig, modes)
    own, variance, valid = read_slopes(slopes, geometry)
    many = max(last, min(_ALONG, 2 * len(geometry.centre_m)))
    basis = modes_of(rig, many)
    held = [frame for frame in range(len(own)) if int(valid[frame].sum()) >= 2]
    good = np.zeros(len(own), bool)
    if not held:
        return modal_result(basis, np.full((len(own), many - 1), np.nan), [None] * len(own), good, last)
    r0 = r0_m or _strength(rig, geometry, own[held], variance[held], valid[held])
    prior = zernike_covariance(range(2, many + 1), geometry.diameter_m / min(r0, _WEAKEST * geometry.diameter_m))
    coefficient = np.full((len(own), many - 1), np.nan)
    covariance: list[Float | None] = [None] * len(own)
    inverse = np.linalg.inv(prior)
    for frame in held:
        use = valid[frame]
        root = 1.0 / np.sqrt(variance[frame][use].reshape(-1))
        g = basis.slope[use].reshape(-1, many - 1) * root[:, None]
        posterior = np.linalg.inv(g.T @ g + inverse)
        coefficient[frame] = posterior @ (g.T @ (own[frame][use].reshape(-1) * root))
        covariance[frame], good[frame] = posterior, True
    return modal_result(basis, coefficient, covariance, good, last)
