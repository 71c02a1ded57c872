"""Figures 13 to 16 as generated frames: spot fields, and the wavefronts that centroids and least squares make of them.

The rig is that of the scene `gated-turbulence`; r₀ by flow and range is our table (`optics.turbulence.flow`). One frame per setting
shows nothing about the document's tank; how often one frame would show an order is in the rows.
"""

from __future__ import annotations

import json
import warnings
from functools import lru_cache
from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from ...captures.hide import hide_truth
from ...estimators import run_estimator
from ...generator.effect import GenerationWarning
from ...generator.generate import generate
from ...scenes.load import load_scene
from ...scenes.medium_index import group_index
from ...scenes.rigs.wavefront import wavefront_rig
from ...scenes.rigs.wavefront_geometry import echo_delay_s
from ..report.pictures import png
from .phase_surface import beside, phase_svg

__all__ = ["CHAIN", "SETTINGS", "flow_capture", "read_phase", "turbulence_pictures"]

Float = NDArray[np.float64]

CHAIN = "spot-ml+slope-cell+zernike-ls"
#: Items: (flow in L/min, range in m) of their four parts.
SETTINGS = {
    "13": tuple((40.0, float(r)) for r in (1, 2, 3, 4)),
    "15": tuple((float(flow), 4.0) for flow in (10, 20, 30, 40)),
}
#: Width of the gate [s], its middle on the echo.
_GATE_S = 10e-9
#: Pixels of the part of a spot field that is shown: 8 lenslets.
_SHOWN = 68


def flow_capture(
    flow_l_per_min: float, range_m: float, *, frames: int = 1, seed: int = 13, **changes: Any
) -> xr.Dataset:
    """Frames of a mirror at `range_m` behind our table's turbulence; `changes`: further overrides of the scene."""
    place = {"kind": "rectangle", "center_m": [0.0, 0.0, range_m], "width_m": 0.1, "height_m": 0.1,
             "tilt_x_deg": 0.0, "tilt_y_deg": 0.0}  # fmt: skip
    wanted: dict[str, Any] = {
        "target": [{"name": "mirror", "shape": place, "material": {"kind": "lambert", "albedo": 0.25}}],
        "rig.turbulence": {"kind": "flow", "flow_l_per_min": flow_l_per_min}, "rig.frames.count": frames,
        "rig.gate.width_s": _GATE_S, "rig.propagation": "phase-screens", **changes,
    }  # fmt: skip
    scene = load_scene("gated-turbulence", wanted)
    rig = wavefront_rig(scene)
    echo = echo_delay_s(rig, range_m, group_index(scene.medium, rig.wavelength_m))
    scene = load_scene("gated-turbulence", wanted | {"rig.frames.start_s": echo - 0.5 * _GATE_S})
    with warnings.catch_warnings():
        # That scintillation is left out stands in the captions.
        warnings.simplefilter("ignore", GenerationWarning)
        return generate(scene, seed=seed, fidelity="geometric")


def read_phase(capture: xr.Dataset) -> Float:
    """The reconstructed phase (frame, row, col) [rad] by the estimators; NaN outside the pupil."""
    return np.asarray(run_estimator(CHAIN, hide_truth(capture))["phase"].values, np.float64)


@lru_cache(maxsize=8)
def _read(flow: float, range_m: float, seed: int) -> tuple[Float, Float]:
    """Counts above the offset of one frame, and its phase, every fourth sample."""
    capture = flow_capture(flow, range_m, seed=seed)
    offset = float(json.loads(capture.attrs["rig"])["detector"]["offset_dn"])
    return np.asarray(capture["counts"].values[0], np.float64) - offset, read_phase(capture)[0][2::4, 2::4]


def turbulence_pictures() -> dict[str, tuple[str, bytes]]:
    """name -> (caption, PNG) of Figures 13 to 16."""
    import vl_convert as vlc

    pictures = {}
    said = ("1, 2, 3 and 4 m, 40 L/min", "10, 20, 30 and 40 L/min, 4 m")
    for (number, settings), what in zip(SETTINGS.items(), said, strict=True):
        read = [_read(flow, far, 13 + n) for n, (flow, far) in enumerate(settings)]
        middle = (read[0][0].shape[0] - _SHOWN) // 2
        part = slice(middle, middle + _SHOWN)
        top = max(float(np.percentile(spots[part, part], 99.8)) for spots, _ in read)
        shown = np.full((2 * _SHOWN + 2,) * 2, np.nan)
        for n, (spots, _) in enumerate(read):
            down, along = ((_SHOWN + 2) * (n // 2), (_SHOWN + 2) * (n % 2))
            shown[down : down + _SHOWN, along : along + _SHOWN] = np.sqrt(np.maximum(spots[part, part], 0.0))
        image = png(np.kron(shown, np.ones((2, 2))), 0.0, top**0.5, ("#000000", "#ffffff"))
        pictures[f"figure-{number}"] = (
            f"Figure {number}: spots at {what} (rows first); root of the light, 8 × 8 lenslets, one frame each, without "
            "scintillation",
            image,
        )
        height = max(float(np.nanmax(np.abs(phase))) for _, phase in read)
        surfaces = [
            phase_svg(phase, height, f"{flow:g} L/min, {far:g} m")
            for (_, phase), (flow, far) in zip(read, settings, strict=True)
        ]
        after = int(number) + 1
        pictures[f"figure-{after}"] = (
            f"Figure {after}: reconstructed wavefronts at {what}, one frame each; the ends of the scale are ±{height:.0f} rad",
            vlc.svg_to_png(beside(surfaces, 2), scale=1.0),
        )
    return pictures
