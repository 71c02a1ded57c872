"""Light of all lenslets on one detector, and how finely the pupil is cut into cells for that.

A lenslet's field is taken as q × q cells of constant residual (optics.lenslets.coherent). What varies within a cell is lost, which
matters most where it moves light into neighbours. How much follows from the scene: a few lenslets of its optics behind draws of its
turbulence, with every number of cells that divides the pupil's samples, against `FINEST` cells.
"""

from __future__ import annotations

from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from ...optics.lenslets.coherent import Detector, Lenslet
from ...optics.lenslets.lattice import LensletArray, lenslet_array
from ...scenes.rigs.wavefront_spec import WavefrontRig

__all__ = ["FINEST", "REACH_PITCHES", "coarser", "lenslet_light", "pilot"]

Float = NDArray[np.float64]
Complex = NDArray[np.complex128]

#: Half side [pitches] of the square about a lenslet within which its field is kept: 98.7 % of the light of each axis.
REACH_PITCHES = 2.5
#: Cells of a side of a lenslet that others are compared with.
FINEST = 32
#: Lattice points of a pitch p over p²/λf, and the fewest: beyond, images change by less than 1e-3 rms over rms.
_POINTS_PER_CYCLE, _LEAST_POINTS = 7.0, 24


def lenslet_light(
    samples: Complex, tilt: Float, centre_m: Float, pitch_m: float, lenslet: Lenslet, at: Detector, *, apart: bool
) -> Float:
    """∫|Σ U_m|² over each pixel (rows, cols), as `coherent_image` has it, or ∫ Σ|U_m|² with `apart`.

    samples (lenslet, q, q), tilt [rad] (lenslet, axis), centre_m (lenslet, axis)."""
    centre = np.ascontiguousarray(centre_m, np.float64)
    return _plan(lenslet, centre.tobytes(), at, samples.shape[-1], pitch_m).image(samples, tilt, apart=apart)


@lru_cache(maxsize=8)
def _plan(lenslet: Lenslet, centre: bytes, at: Detector, cells: int, pitch_m: float) -> LensletArray:
    points = max(_LEAST_POINTS, int(np.ceil(_POINTS_PER_CYCLE * pitch_m**2 / lenslet.scale_m2)))
    return lenslet_array(
        lenslet, np.frombuffer(centre).reshape(-1, 2), at,
        cells=cells, step_m=pitch_m / points, reach_m=REACH_PITCHES * pitch_m,
    )  # fmt: skip


def coarser(samples: Complex, cells: int) -> Complex:
    """Means (lenslet, cells, cells) of samples (lenslet, q, q), of which `cells` is a divisor."""
    count, per = len(samples), samples.shape[-1] // cells
    return np.asarray(samples.reshape(count, cells, per, cells, per).mean(axis=(2, 4)))


def pilot(rig: WavefrontRig, most_across: int, samples: int | None = None) -> WavefrontRig:
    """The same optics with few lenslets, all lit, in one frame, without aberration; `samples` of the pupil in place of its own."""
    array = rig.lenslets
    across = min(most_across, array.across)
    side = across * array.pitch_m
    pixels = int(np.ceil((side + array.hexagonal * array.pitch_m) / rig.camera.pixel_pitch_m)) + 4
    return rig.model_copy(
        update={
            "lenslets": array.model_copy(
                update={"across": across, "missing": (), "missing_share": None, "offset_m": (0.0, 0.0)}
            ),
            "pupil": rig.pupil.model_copy(
                update={"shape": "square", "diameter_m": side, "samples": samples or rig.pupil.samples}
            ),
            "bench": rig.bench.model_copy(update={"beam_diameter_m": 2.0 * side}),
            "camera": rig.camera.model_copy(update={"rows": pixels, "cols": pixels}),
            "frames": rig.frames.model_copy(update={"count": 1}),
            "aberration": None,
        }
    )
