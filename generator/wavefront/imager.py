"""What the camera beside the lenslets sees: a chart, blurred by the wave in the pupil.

v = H(u) + p (Guo et al. 2017, Eq. 31): H the convolution with |F[field]|², u the chart in photoelectrons, p the noise of photons
and of reading. The chart lies on a black ground twice as wide as the image, so that light leaves the image and none comes in.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ...optics.deconvolution import blurred_eq31, point_spread, transfer_of
from ...scenes.rigs.wavefront_parts import Imager
from ..random import Stage, generator

__all__ = ["blurred_chart", "chart", "seen_chart"]

Float = NDArray[np.float64]

#: Border of the chart that is black, as a share of its side.
_BORDER = 0.15


def chart(side: int) -> Float:
    """Bars of three widths, a disc and a ramp (side, side), 0 to 1, within a black border."""
    t = (np.arange(side) + 0.5) / side
    y, x = np.broadcast_arrays(t[:, None], t[None, :])
    fine = np.where(x < 0.4, 30.0, np.where(x < 0.62, 18.0, 9.0))
    image = np.where(y < 0.45, np.floor(x * fine) % 2, np.clip((x - _BORDER) / (1.0 - 2.0 * _BORDER), 0.0, 1.0))
    image = np.where(np.hypot(x - 0.36, y - 0.66) < 0.13, 1.0, image)
    inside = (np.abs(x - 0.5) < 0.5 - _BORDER) & (np.abs(y - 0.5) < 0.5 - _BORDER)
    return np.where(inside, image, 0.0)


def blurred_chart(imager: Imager, field: NDArray[np.complex128], mask: NDArray[np.bool_]) -> Float:
    """Expected photoelectrons (side, side) of the chart seen through `field` (samples, samples) inside the pupil `mask`.

    The light of the image as a whole does not depend on the field's.
    """
    side = imager.side
    wide = np.zeros((2 * side, 2 * side))
    wide[:side, :side] = imager.photoelectrons * chart(side)
    spread = point_spread(np.angle(field), np.where(mask, np.abs(field), 0.0))
    blurred = blurred_eq31(wide, transfer_of(spread, wide.shape))[:side, :side]
    return np.asarray(np.maximum(blurred, 0.0))


def seen_chart(imager: Imager, mean: Float, frame: int, seed: int, key: int) -> NDArray[np.float32]:
    """A draw of the image of a frame [photoelectrons]: Poisson, and Gaussian read noise."""
    rng = generator(seed, key, Stage.IMAGER, frame)
    return (rng.poisson(mean) + imager.read_noise_e * rng.standard_normal(mean.shape)).astype(np.float32)
