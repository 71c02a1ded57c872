"""Captures of laser lines from closed forms: a pixel-integrated Gaussian of any column and light in every row."""

from __future__ import annotations

from typing import Any

import numpy as np
import xarray as xr
from scipy.special import ndtr

from ...captures.build import make_capture
from ...scenes.declared import declared_rig
from ...scenes.rigs.laser_line import laser_line_rig
from ...scenes.scene import Scene
from ..bounds.laser_line import line_noise
from .draw import drawn_counts, generator, truth_attributes

__all__ = ["written_capture"]


def written_capture(
    scene: Scene, amplitude: Any, width: Any, background: float, column: Any, *, seed: int | None = None,
    averaged: bool = False,
) -> xr.Dataset:  # fmt: skip
    """A capture with its truth, for the rig of `scene`: row i of every frame holds a line at `column`.

    Main arguments:
        amplitude [photoelectrons of the row], width [px, 1 σ], column [px]: (frame, row) or what is repeated to it.
        background: photoelectrons of a pixel, dark ones included.
    Other arguments:
        seed: of the noise; None gives the mean itself, rounded, or as it is where `averaged`.

    `truth_point` is NaN: no surface is behind these lines. Raises InputError for a scene of another modality.
    """
    rig = laser_line_rig(scene)
    frames, rows, cols = rig.frames.lit + rig.frames.laser_off, rig.camera.rows, rig.camera.cols
    a, s, c = (np.broadcast_to(np.asarray(v, np.float64), (frames, rows)).copy() for v in (amplitude, width, column))
    on = np.arange(frames) < rig.frames.lit
    edge = np.arange(cols + 1) - 0.5
    mean = background + a[..., None] * np.diff(ndtr((edge - c[..., None]) / s[..., None]), axis=-1)
    mean[~on] = background
    noise = line_noise(rig)
    counts: Any = mean * noise.gain_dn_per_e + noise.offset_dn
    if seed is not None:
        counts = drawn_counts(mean, noise, generator(seed))
    elif averaged:
        counts = counts.astype(np.float32)
    else:
        counts = np.clip(np.floor(counts + 0.5), 0, noise.adc_max_dn).astype(np.uint16)
    held = {"column": c, "amplitude": a, "width": s}
    truth = {f"truth_{name}": np.where(on[:, None], v, np.nan)[..., None] for name, v in held.items()}
    return make_capture(
        "laser_line",
        data={"counts": counts},
        coords={
            "time": rig.frames.interval_s * np.arange(frames), "laser_on": on, "valid": True, "pose": np.zeros((frames, 6)),
        },
        truth=truth | {
            "truth_point": np.full((frames, rows, 1, 3), np.nan), "truth_background": np.full(frames, float(background)),
        },
        attrs=truth_attributes(scene, declared_rig(scene)) | ({"averaged": True} if averaged else {}),
    )  # fmt: skip
