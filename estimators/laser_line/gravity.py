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
from ..registry import estimator
from ..result import stage_result
from ..rig import DeclaredRig

__all__ = ["level_points"]


@estimator("gravity", cites="Kusters 1992: an instrument with two inclinometers in its housing")
def level_points(points: xr.Dataset, rig: DeclaredRig, coordinates: xr.Dataset) -> xr.Dataset:
    """Triangulated points in the level frame of each frame: y down, z along the camera's heading.

    Main arguments:
        points: point and sigma (frame, row, return, xyz) [m] and valid. coordinates: with `pitch` and `roll` [rad] (frame).

    Returns level_point (frame, row, return, xyz), sigma [m], valid. Places are from the camera at each frame: `pose` says how it
    moved. Raises InputError for a capture without inclinometers.
    """
    if "pitch" not in coordinates or "roll" not in coordinates:
        raise InputError(
            "The capture holds no attitude.", where="coordinates pitch, roll", value=", ".join(map(str, coordinates.coords)),
            allowed="the readings of inclinometers, rad per frame", next_step="add rig.inclinometers to the scene",
        )  # fmt: skip
    sigma_rad = np.deg2rad(rig.number("inclinometers.sigma_deg", least=0))
    pitch, roll = (np.asarray(coordinates[name].values, np.float64) for name in ("pitch", "roll"))
    x, sigma = (np.asarray(points[name].values, np.float64) for name in ("point", "sigma"))
    turn = level_matrix(pitch, roll)
    level = np.einsum("fik,frnk->frni", turn, x)
    variance = np.einsum("fik,frnk->frni", turn**2, sigma**2)
    for slope in level_slopes(pitch, roll):
        variance = variance + (np.einsum("fik,frnk->frni", slope, x) * sigma_rad) ** 2
    valid = np.asarray(points["valid"].values, bool)
    return stage_result("gravity", level_point=level, sigma=np.sqrt(variance), valid=valid)
