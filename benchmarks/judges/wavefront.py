"""The judge of wavefronts: spots, slopes, Zernike coefficients and phases."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import xarray as xr

from ...estimators.rig import read_rig
from ...scenes.rigs.wavefront import wavefront_rig
from ..bounds.instrument import true_scene
from ..bounds.wavefront import wavefront_bounds
from ..scores.truth import Truth
from .judge import Judge
from .wavefront_reference import reference_calibration

__all__ = ["JUDGE"]


def _truth(capture: xr.Dataset) -> Mapping[str, Truth]:
    """The true slope, coefficients and phase, turbulence and chart where the capture has them; and the spot: the declared
    place, moved by f times the true slope.

    Positions are read against a reference, so that a place that is declared wrongly is the same in estimate and truth.
    """
    slope, zernike, phase = (
        np.asarray(capture[f"truth_{name}"].values, np.float64) for name in ("slope", "zernike", "phase")
    )
    found = {"slope": Truth.plain(slope), "zernike": Truth.plain(zernike), "phase": Truth.plain(phase)}
    found |= {
        name: Truth.plain(np.asarray(capture[f"truth_{name}"].values, np.float64))
        for name in ("r0", "present", "source")
        if f"truth_{name}" in capture
    }
    if "truth_image" in capture and "image" in capture:
        found["image"] = Truth.plain(np.broadcast_to(capture["truth_image"].values, capture["image"].shape))
    return {"spot": Truth.plain(_place(capture, slope)), **found}


def _place(capture: xr.Dataset, slope: np.ndarray) -> np.ndarray:
    declared = read_rig(capture)
    place = np.stack([declared.numbers("lenslets.col_px"), declared.numbers("lenslets.row_px")], axis=1)
    if isinstance(capture.attrs.get("truth_scene"), str):
        rig = wavefront_rig(true_scene(capture))
        focal_length, pixel = rig.lenslets.focal_length_m, rig.camera.pixel_pitch_m
    else:
        focal_length, pixel = declared.number("lenslets.focal_length_m"), declared.number("camera.pixel_pitch_m")
    if place.shape != slope.shape[1:]:
        return np.full(slope.shape, np.nan)  # a declared array of other lenslets: none of them has a truth
    return np.asarray(place + slope * focal_length / pixel)


JUDGE = Judge(
    truth=_truth,
    bound=wavefront_bounds,
    calibrate=reference_calibration,
    neighbours=("spot-ml", "spot-centroid", "spot-gaussian"),
    scenes=("gated-turbulence",),
    feeders={
        "assignment": "spot-ml", "reconstruction": "spot-ml+slope-cell", "turbulence": "spot-ml+slope-cell",
        "deconvolution": "spot-ml+slope-cell+zernike-map",
    },
    laws="beambench.benchmarks.laws.wavefront:LAWS",
    twin="beambench.benchmarks.twin.wavefront:TWIN",
    design="beambench.benchmarks.design.wavefront:DESIGNS",
)  # fmt: skip
