"""Strength of turbulence from the slopes of several frames, of lenslets that all frames show."""

from __future__ import annotations

from functools import lru_cache

import numpy as np
import numpy.typing as npt

from ...optics.turbulence.detection import Strength, strength_and_probability
from ...optics.turbulence.slopes import gradient_covariance
from ...optics.turbulence.strength import kolmogorov_structure
from ..rig import DeclaredRig
from .geometry import declared_geometry

__all__ = ["shared_lenslets", "slope_covariance", "strength_of"]

Float = npt.NDArray[np.float64]
Bool = npt.NDArray[np.bool_]

#: Most lenslets whose slopes tell the strength: the eigenvalues of twice as many take some tenths of a second.
_MOST = 150
#: r0 over the pupil's diameter between which turbulence is looked for.
_LEAST_R0, _GREATEST_R0 = 1e-2, 1e2


def shared_lenslets(valid: Bool) -> tuple[int, ...] | None:
    """Lenslets that are valid in all frames of `valid` (frame, lenslet), every other one and so on of many; None where they are
    fewer than half of all, or fewer than two."""
    there = np.flatnonzero(valid.all(axis=0))
    if 2 * there.size < valid.shape[1] or there.size < 2:
        return None
    return tuple(int(i) for i in there[:: max(there.size // _MOST, 1)][:_MOST])


def strength_of(rig: DeclaredRig, own: Float, variance: Float, valid: Bool) -> tuple[Strength, float]:
    """(strength by maximum likelihood, probability that there is turbulence) from slopes along the array's axes [rad] (frame,
    lenslet, axis), their variances, and which are valid (frame, lenslet).

    r0 is taken as likely, in ln r0, anywhere between a hundredth of the pupil's diameter and a hundred of them.
    Raises ValueError where the frames share too few lenslets (`shared_lenslets`).
    """
    chosen = shared_lenslets(valid)
    if chosen is None:
        raise ValueError("These frames share too few lenslets.")
    noise = variance[:, list(chosen)].mean(axis=0).ravel()
    slopes, unit = own[:, list(chosen)].reshape(len(own), -1), slope_covariance(rig, chosen)
    size = declared_geometry(rig).diameter_m
    return strength_and_probability(slopes, unit, noise, (_LEAST_R0 * size, _GREATEST_R0 * size))


@lru_cache(maxsize=4)
def slope_covariance(rig: DeclaredRig, chosen: tuple[int, ...]) -> Float:
    """Covariance [rad²] of the slopes of some lenslets for r0 = 1 m."""
    geometry = declared_geometry(rig)
    centre = geometry.centre_m[list(chosen)]
    return (
        gradient_covariance(lambda r: kolmogorov_structure(r, 1.0), centre, geometry.pitch_m) / geometry.wavenumber**2
    )
