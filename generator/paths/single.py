"""Light scattered exactly once, by quadrature along 3×3 rays of every pixel: the share of the full rung with a closed form.

The path tracer leaves it out (its component "single" is kept for tests), so that `full` and `scatter` agree on it to the last
digit of the quadrature, near gates included: both leave out paths shorter than `nearest_path_m`. The quadrature leaves out
the shadows that the target casts into the water where the lamp stands beside the camera; `full` traces what they take.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from ...optics.correlation.response import Table
from ...scenes.scene import Scene
from ..rays.lamp import RoundBeam
from ..rays.trace import Tracer, pixel_directions
from ..rays.view import View
from ..water.ramp import backscatter_electrons

__all__ = ["single_electrons"]

Float = NDArray[np.float64]

#: Rays along each side of a pixel: the target ends the ray, and at an edge it does so in a part of the pixel.
_RAYS = 3


def single_electrons(
    scene: Scene, view: View[RoundBeam], tables: Sequence[Table], gate: NDArray[np.int32], delay_s: Float, scale: Float,
    offset_s: Float | None,
) -> NDArray[np.float32]:  # fmt: skip
    """Photoelectrons (slices, rows, cols) of light scattered exactly once that meets no surface.

    Main arguments:
        tables: R of every gate. gate, delay_s, scale: gate, optical delay and relative energy of each slice.
        offset_s: of the gate in each pixel (rows·cols), or None.
    """
    camera = view.camera
    rows, cols = camera.rows, camera.cols
    if scene.medium.scattering_per_m == 0.0:
        return np.zeros((len(delay_s), rows, cols), dtype=np.float32)
    phase = scene.medium.phase
    assert phase is not None  # PathWorld.of refuses a medium without one
    fine = camera.model_copy(
        update={"rows": rows * _RAYS, "cols": cols * _RAYS, "pixel_pitch_m": camera.pixel_pitch_m / _RAYS}
    )
    row, col = (a.ravel() for a in np.mgrid[: fine.rows, : fine.cols])
    hits = Tracer(scene).trace((0.0, 0.0, 0.0), pixel_directions(fine, row, col))
    range_m = np.where(hits.target >= 0, hits.distance, np.nan).reshape(fine.rows, fine.cols)
    offset = None
    if offset_s is not None:
        offset = np.repeat(np.repeat(offset_s.reshape(rows, cols), _RAYS, axis=0), _RAYS, axis=1)
    light = backscatter_electrons(
        scene, replace(view, camera=fine), phase, tables, gate, delay_s, scale, range_m, offset, forward=False
    )
    return np.asarray(light.reshape(-1, rows, _RAYS, cols, _RAYS).sum(axis=(2, 4)))
