"""The truth of a frame: slopes averaged over lenslets, the phase, and its Zernike coefficients.

Slope of lenslet l: Im∫u*∇u dA/(k∫|u|² dA) over its clear area. With increments arg(u_b u_a*) between neighbouring samples the
mean of the two beside each sample takes the place of Im(u*∇u)/|u|²: exact for fields of even light, and of second order in the
distance of samples otherwise.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ...optics.zernike import zernike
from ...scenes.errors import InputError
from ...scenes.rigs.wavefront_geometry import Lattice

__all__ = ["Projector", "irradiances", "slopes"]

Float = NDArray[np.float64]
Complex = NDArray[np.complex128]

#: Greatest condition of the modes' products over the samples: rounding then stays below 1e-8 of the phase.
_MOST_CONDITION = 1e8


def slopes(field: Complex, lattice: Lattice, wavelength_m: float) -> Float:
    """Slopes [rad] (lenslet, axis) along the camera's x and y, of a field (side + 2, side + 2) with one sample around the grid.

    NaN where a lenslet receives no light.
    """
    power = np.abs(field[1:-1, 1:-1]) ** 2
    along_x = np.angle(field[1:-1, 1:] * np.conj(field[1:-1, :-1]))
    along_y = np.angle(field[1:, 1:-1] * np.conj(field[:-1, 1:-1]))
    steps = (0.5 * (along_x[:, 1:] + along_x[:, :-1]), 0.5 * (along_y[1:] + along_y[:-1]))
    light = lattice.totals(power)
    with np.errstate(divide="ignore", invalid="ignore"):
        own = [lattice.totals(power * step) / light for step in steps]
    k = 2.0 * np.pi / wavelength_m
    own = [np.where(light > 0, value / (k * lattice.step_m), np.nan) for value in own]
    c, s = np.cos(lattice.rotation_rad), np.sin(lattice.rotation_rad)
    return np.stack([c * own[0] - s * own[1], s * own[0] + c * own[1]], axis=1)


def irradiances(field: Complex, lattice: Lattice) -> Float:
    """Mean of |u|² (lenslet) over each clear area, of a field (side + 2, side + 2); 0 where no sample is clear."""
    power = lattice.totals(np.abs(field[1:-1, 1:-1]) ** 2)
    clear = lattice.totals(np.ones(lattice.open.shape))
    # A wave of even light has exactly 1: what lies below 1e-12 is rounding.
    return np.asarray(np.round(power / np.where(clear > 0.0, clear, 1.0), 12))


class Projector:
    """Least squares of Zernike coefficients over the samples inside the pupil."""

    def __init__(self, lattice: Lattice, diameter_m: float, modes: int) -> None:
        self.mask = lattice.mask
        unit = lattice.grid_m / (0.5 * diameter_m)
        x, y = np.broadcast_arrays(unit[None, :], unit[:, None])
        self._values = zernike(range(1, modes + 1), x[self.mask], y[self.mask])
        gram = self._values @ self._values.T
        if not np.linalg.cond(gram) < _MOST_CONDITION:
            raise InputError(
                "The Zernike modes are not independent over the samples of the pupil.", where="rig.pupil.modes", value=modes,
                allowed=f"well below the {int(self.mask.sum())} samples inside the pupil, which must lie on the array",
                next_step="lower rig.pupil.modes, or raise rig.pupil.samples",
            )  # fmt: skip
        self._gram = np.linalg.inv(gram)

    def coefficients(self, phase: Float) -> Float:
        """Coefficients [rad rms] (mode), Noll's index from 2, of a phase (side, side), whose samples of NaN do not count."""
        values, own = phase[self.mask], self._values
        good = np.isfinite(values)
        if good.all():
            return np.asarray(self._gram @ (own @ values))[1:]
        # The few samples at branch points leave the condition as it is.
        own, values = own[:, good], values[good]
        return np.asarray(np.linalg.solve(own @ own.T, own @ values))[1:]

    def shown(self, phase: Float) -> Float:
        """The phase without its mean over the pupil, NaN outside."""
        return np.asarray(np.where(self.mask, phase - np.nanmean(phase[self.mask]), np.nan))
