"""Captures of spot fields from closed forms: a pixel-integrated sinc² of any slope and light behind every used lenslet."""

from __future__ import annotations

from typing import Any

import numpy as np
import xarray as xr

from ...captures.build import make_capture
from ...scenes.declared import declared_rig
from ...scenes.rigs.camera_noise import camera_noise
from ...scenes.rigs.wavefront import wavefront_rig
from ...scenes.rigs.wavefront_geometry import flat_spots, lattice_of
from ...scenes.scene import Scene
from .draw import drawn_counts, generator, truth_attributes

__all__ = ["written_capture"]


def written_capture(scene: Scene, flux: Any, background: float, slope: Any, *, seed: int = 1) -> xr.Dataset:
    """A capture with its truth, for the rig of `scene`: spots of used lenslets alone, each where its slope puts it.

    Main arguments:
        flux [photoelectrons of a spot]: (frame, lenslet) or what is repeated to it. background: photoelectrons of a pixel, dark
            ones included. slope [rad]: (frame, lenslet, axis) or what is repeated to it.
    Other arguments:
        seed: of the noise of frames and reference.

    `truth_phase` and `truth_zernike` are NaN, `truth_field` is 0: the slopes need not be those of a surface.
    Raises InputError for a scene of another modality.
    """
    rig = wavefront_rig(scene)
    lattice, noise = lattice_of(rig), camera_noise(rig.detector)
    frames, lenslets, side = rig.frames.count, lattice.row.size, len(lattice.grid_m)
    s = np.broadcast_to(np.asarray(slope, np.float64), (frames, lenslets, 2)).copy()
    a = np.broadcast_to(np.asarray(flux, np.float64), (frames, lenslets)).copy()
    place, per_rad = (
        np.stack([lattice.col_px, lattice.row_px], axis=1),
        rig.lenslets.focal_length_m / rig.camera.pixel_pitch_m,
    )

    def image(moved: Any, light: Any) -> Any:
        at = place + per_rad * moved
        return background + flat_spots(rig, at[:, 0], at[:, 1], light)

    mean = np.stack([image(moved, light) for moved, light in zip(s, a, strict=True)])
    flat = np.repeat(image(np.zeros((lenslets, 2)), a[0])[None], rig.frames.reference_exposures, axis=0)
    rng = generator(seed)
    return make_capture(
        "wavefront",
        data={
            "counts": drawn_counts(mean, noise, rng),
            "reference": drawn_counts(flat, noise, rng).mean(axis=0).astype(np.float32),
        },
        coords={
            "delay": rig.frames.delays_s(),
            "time": rig.frames.interval_s * np.arange(frames), "valid": True,
        },
        truth={
            "truth_field": np.zeros((frames, side, side), np.complex64), "truth_slope": s, "truth_flux": a,
            "truth_phase": np.full((frames, side, side), np.nan), "truth_background": np.full(frames, float(background)),
            "truth_zernike": np.full((frames, rig.pupil.modes - 1), np.nan),
        },
        attrs=truth_attributes(scene, declared_rig(scene)),
    )  # fmt: skip
