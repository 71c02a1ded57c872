"""The spot field behind the lenslets, photoelectrons per pixel, at each rung.

`geometric`: the spot of a flat wavefront, moved by the lenslet's mean slope. `isolated`: diffraction of each lenslet's own field,
intensities added. `coherent`: fields added on one detector.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ...optics.lenslets.coherent import Detector, Lenslet
from ...optics.lenslets.spots import isolated_image
from ...scenes.rigs.wavefront_geometry import Lattice, spot_px
from ...scenes.rigs.wavefront_spec import WavefrontRig
from .fields import coarser, lenslet_light
from .truth import irradiances, slopes

__all__ = ["spot_image"]

Float = NDArray[np.float64]
Complex = NDArray[np.complex128]


def spot_image(
    rig: WavefrontRig, lattice: Lattice, field: Complex, flux: float, rung: str, *, cells: int | None = None
) -> Float:
    """Photoelectrons (rows, cols) of a field (side + 2, side + 2) of unit mean power that gives each lenslet `flux` photoelectrons
    for |u| = 1. `cells` of a side of a lenslet, a divisor of the pupil's samples: all of them if not given."""
    tilt = slopes(field, lattice, rig.pupil.samples, rig.wavelength_m)
    tilt = np.where(np.isfinite(tilt), tilt, 0.0)
    if rung == "geometric":
        per_rad = rig.lenslets.focal_length_m / rig.camera.pixel_pitch_m
        at = np.stack([lattice.col_px, lattice.row_px], axis=1) + per_rad * tilt
        shape = (rig.camera.rows, rig.camera.cols)
        light = flux * irradiances(field, lattice, rig.pupil.samples)
        return isolated_image(at[:, 0], at[:, 1], light, spot_px(rig), shape)
    lenslet = Lenslet(rig.lenslets.fill * rig.lenslets.pitch_m, rig.lenslets.focal_length_m, rig.wavelength_m)
    samples = coarser(_residual(rig, lattice, field, tilt), cells or rig.pupil.samples)
    camera, pitch = rig.camera, rig.lenslets.pitch_m
    middle = 0.5 * (np.array([camera.cols, camera.rows]) - 1.0)
    centre = (np.stack([lattice.col_px, lattice.row_px], axis=1) - middle) * camera.pixel_pitch_m
    origin = (-float(middle[0]) * camera.pixel_pitch_m, -float(middle[1]) * camera.pixel_pitch_m)
    detector = Detector((camera.rows, camera.cols), camera.pixel_pitch_m, origin)
    light = lenslet_light(samples, tilt, centre, pitch, lenslet, detector, apart=rung != "coherent")
    # The sum over fields is a light to its tabulated accuracy: rounding of some 1e-6 of the brightest pixel may lie below zero.
    return np.asarray(np.maximum(light, 0.0) * (flux / lenslet.side_m**2))


def _residual(rig: WavefrontRig, lattice: Lattice, field: Complex, tilt: Float) -> Complex:
    """Field (lenslet, samples, samples) at the cells of each clear square, its plane wave of slope `tilt` divided out."""
    per, fill = rig.pupil.samples, rig.lenslets.fill
    offset = (np.arange(per) - 0.5 * (per - 1)) * fill
    if fill == 1.0:
        across = len(lattice.grid_m) // per
        tiles = field[1:-1, 1:-1].reshape(across, per, across, per).transpose(0, 2, 1, 3)
        u = tiles[lattice.row, lattice.col]
    else:
        from scipy.ndimage import map_coordinates

        first = 1.0 + 0.5 * (per - 1)
        down, along = (first + per * site[:, None] + offset for site in (lattice.row, lattice.col))
        shape = (len(down), per, per)
        at = [np.broadcast_to(down[:, :, None], shape), np.broadcast_to(along[:, None, :], shape)]
        u = map_coordinates(field.real, at, order=1) + 1j * map_coordinates(field.imag, at, order=1)
    k = 2.0 * np.pi / rig.wavelength_m
    x = offset * lattice.step_m
    turn = np.exp(-1j * k * (tilt[:, 1, None, None] * x[:, None] + tilt[:, 0, None, None] * x))
    return np.asarray(u * turn)
