"""Whether the spots of a reference are those of the declared lattice."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from ...scenes.errors import InputError
from .geometry import Geometry

__all__ = ["check_reference"]

Float = npt.NDArray[np.float64]
Bool = npt.NDArray[np.bool_]

#: rms distance of the reference's spots from their declared places, as a share of the pitch, beyond which the lattice is another.
#: Spots anywhere in their cells have .29.
_OFF_LATTICE = 0.2
#: Share by which the spots of the reference may lie wider or closer than the declared lattice: beyond, its pitch is another. A
#: reference of radius R does this by f/R.
_OFF_SCALE = 0.05


def _wider(place: Float, off: Float) -> tuple[float, float]:
    """(s, its standard error): how much wider spots lie than the places (lenslet, axis): least squares of
    `off` = s (place − mean)."""
    away = place - place.mean(axis=0)
    size = float((away**2).sum())
    if len(place) < 3 or size == 0.0:
        return 0.0, np.inf
    wider = float((off * away).sum()) / size
    rest = off - off.mean(axis=0) - wider * away
    return wider, float(np.sqrt((rest**2).sum() / (off.size - 3) / size))


def check_reference(good: Bool, peak: Float, geometry: Geometry) -> None:
    """Raise InputError for a reference without spots, or with spots (`peak`, px from the declared places) anywhere in the cells."""
    if not good.any():
        raise InputError(
            "The reference shows no spot: slopes have no zero.", where="reference",
            value="no lenslet with a spot above the noise", allowed="the spot field of a flat wavefront",
            next_step="record the reference with more light, or check the declared lenslets and detector",
        )  # fmt: skip
    off = peak[good] - np.median(peak[good], axis=0)
    rms = float(np.sqrt((off**2).mean())) / geometry.pitch_px
    wider, error = _wider(geometry.place_px[good], off)
    if abs(wider) - 4.0 * error > _OFF_SCALE:
        raise InputError(
            "The spots of the reference lie on a lattice of another pitch than the declared one.", where="attribute rig: lenslets",
            value=f"{100.0 * wider:+.2g} ± {100.0 * error:.1g} %", allowed=f"{100.0 * _OFF_SCALE:g} % or less",
            next_step="check the declared pitch of lenslets and pixels",
        )  # fmt: skip
    if rms > _OFF_LATTICE or 2 * int(good.sum()) < good.size:
        raise InputError(
            "The spots of the reference do not lie on the declared lattice.", where="attribute rig: lenslets",
            value=f"{rms:.2g} of the pitch rms, {int(good.sum())} of {good.size} spots found",
            allowed=f"{_OFF_LATTICE:g} of the pitch rms or less, half of the spots or more",
            next_step="check pitch, rotation and pixel pitch of the declared rig",
        )  # fmt: skip
