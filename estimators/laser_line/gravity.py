"""Points of a laser line in the gravity frame, by the inclinometers of the rig.

    X' = Rx(p) Rz(r) X,    σ'² = Σ_k (R_ik σ_k)² + ((∂R/∂p X)_i σ_m)² + ((∂R/∂r X)_i σ_m)²,

p and r the readings of the frame and σ_m their stated error. The errors of a point's coordinates lie along its ray, and so are
alike or opposite: taken as independent here, σ'_y may be wrong by √2 where the rig is tilted much.
"""

from __future__ import annotations

import numpy as np
import xarray as xr

from ...optics.gravity import level_matrix, level_slopes
from ...scenes.errors import InputError
from ..rig import read_rig

__all__ = ["gravity_points"]


def gravity_points(points: xr.Dataset, capture: xr.Dataset) -> xr.Dataset:
    """A result of the stage `triangulation`, turned into the level frame of each frame: y down, z along the camera's heading.

    Main arguments:
        points: point and sigma (frame, row, return, xyz) [m] and valid. capture: with the coordinates `pitch` and `roll`.

    Returns the same variables. Places are those of the camera at each frame: `pose` says how it moved. Raises InputError for a
    capture without inclinometers.
    """
    if "pitch" not in capture.coords or "roll" not in capture.coords:
        raise InputError(
            "The capture holds no attitude.", where="coordinates pitch, roll", value=", ".join(map(str, capture.coords)),
            allowed="the readings of inclinometers, rad per frame", next_step="add rig.inclinometers to the scene",
        )  # fmt: skip
    sigma_rad = np.deg2rad(read_rig(capture, "laser_line").number("inclinometers.sigma_deg", least=0))
    pitch, roll = (np.asarray(capture[name].values, np.float64) for name in ("pitch", "roll"))
    x, sigma = (np.asarray(points[name].values, np.float64) for name in ("point", "sigma"))
    turn = level_matrix(pitch, roll)
    level = np.einsum("fik,frnk->frni", turn, x)
    variance = np.einsum("fik,frnk->frni", turn**2, sigma**2)
    for slope in level_slopes(pitch, roll):
        variance = variance + (np.einsum("fik,frnk->frni", slope, x) * sigma_rad) ** 2
    return points.assign(point=(points["point"].dims, level), sigma=(points["sigma"].dims, np.sqrt(variance)))
