"""The spot field behind the lenslets, photoelectrons per pixel, at each rung.

`geometric`: the spot of a flat wavefront, moved by the lenslet's mean slope. Its light over pixels is a product over x and y,
A ΔF(x/w) ΔF(y/w), F the integral of sinc², w = λf/d, so that the whole image is a product of two matrices.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.special import sici

from ...scenes.rigs.wavefront_geometry import Lattice, spot_px
from ...scenes.rigs.wavefront_spec import WavefrontRig
from .truth import slopes

__all__ = ["geometric", "sinc2_integral", "spot_field"]

Float = NDArray[np.float64]
Complex = NDArray[np.complex128]


def sinc2_integral(t: Float) -> Float:
    """∫₀ᵗ sinc² = Si(2πt)/π − sin²(πt)/(π² t), sinc t = sin πt/πt; ±½ at ±∞."""
    safe = np.where(t == 0.0, 1.0, t)
    value = sici(2.0 * np.pi * safe)[0] / np.pi - np.sin(np.pi * safe) ** 2 / (np.pi**2 * safe)
    return np.asarray(np.where(t == 0.0, 0.0, value))


def spot_field(rig: WavefrontRig, lattice: Lattice, field: Complex, flux: float, rung: str) -> Float:
    """Photoelectrons (rows, cols) of a field (side + 2, side + 2) that gives each whole lenslet `flux` photoelectrons."""
    tilt = slopes(field, lattice, rig.pupil.samples, rig.wavelength_m)
    return geometric(rig, lattice, tilt, np.full(lattice.row.size, flux))


def geometric(rig: WavefrontRig, lattice: Lattice, slopes: Float, flux: Float) -> Float:
    """Photoelectrons (rows, cols) of spots moved by `slopes` [rad] (lenslet, axis), of `flux` [photoelectrons] (lenslet) each."""
    per_rad = rig.lenslets.focal_length_m / rig.camera.pixel_pitch_m
    width = spot_px(rig)
    along = _shares(rig.camera.cols, lattice.col_px + per_rad * slopes[:, 0], width)
    down = _shares(rig.camera.rows, lattice.row_px + per_rad * slopes[:, 1], width)
    return np.asarray((down * flux[:, None]).T @ along)


def _shares(size: int, at: Float, width: float) -> Float:
    """Share (lenslet, pixel) of a spot's light in each pixel of a line."""
    edge = np.arange(size + 1) - 0.5
    return np.diff(sinc2_integral((edge - at[:, None]) / width), axis=1)
