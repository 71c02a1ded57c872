"""The spot field behind the lenslets, photoelectrons per pixel, at each rung.

`geometric`: the spot of a flat wavefront, moved by the lenslet's mean slope. `isolated`: diffraction of each lenslet's own field,
intensities added. `coherent`: fields added on one detector. A hexagon is a square about it whose cells are lit in part.
"""

from __future__ import annotations

from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from ...optics.lenslets.coherent import Detector, Lenslet
from ...optics.lenslets.hexagons import hexagon_coverage
from ...scenes.rigs.wavefront_geometry import Lattice, clear_area_m2, flat_spots
from ...scenes.rigs.wavefront_spec import WavefrontRig
from .fields import coarser, lenslet_light
from .truth import irradiances, slopes

__all__ = ["HEXAGON_CELLS", "spot_image"]

Float = NDArray[np.float64]
Complex = NDArray[np.complex128]

#: Height between the corners of a hexagon over its width between the flats.
_CORNERS = 2.0 / np.sqrt(3.0)
#: Cells of a side of the square about a hexagon: its spot errs by .3 % of its brightest pixel, .7 % rms over rms.
HEXAGON_CELLS = 32


def spot_image(
    rig: WavefrontRig, lattice: Lattice, field: Complex, flux: float, rung: str, *, cells: int | None = None
) -> Float:
    """Photoelectrons (rows, cols) of a field (side + 2, side + 2) of unit mean power that gives each lenslet `flux` photoelectrons
    for |u| = 1. `cells` of a side of a lenslet: of a square a divisor of the pupil's samples, all of them if not given."""
    tilt = slopes(field, lattice, rig.wavelength_m)
    tilt = np.where(np.isfinite(tilt), tilt, 0.0)
    if rung == "geometric":
        per_rad = rig.lenslets.focal_length_m / rig.camera.pixel_pitch_m
        at = np.stack([lattice.col_px, lattice.row_px], axis=1) + per_rad * tilt
        return flat_spots(rig, at[:, 0], at[:, 1], flux * irradiances(field, lattice))
    side = rig.lenslets.fill * rig.lenslets.pitch_m
    if rig.lenslets.hexagonal:
        side *= _CORNERS
        samples = _in_hexagons(rig, lattice, field, tilt, cells or HEXAGON_CELLS)
    else:
        samples = coarser(_residual(rig, lattice, field, tilt), cells or rig.pupil.samples)
    lenslet = Lenslet(side, rig.lenslets.focal_length_m, rig.wavelength_m)
    camera, pitch = rig.camera, rig.lenslets.pitch_m
    middle = 0.5 * (np.array([camera.cols, camera.rows]) - 1.0)
    centre = (np.stack([lattice.col_px, lattice.row_px], axis=1) - middle) * camera.pixel_pitch_m
    origin = (-float(middle[0]) * camera.pixel_pitch_m, -float(middle[1]) * camera.pixel_pitch_m)
    detector = Detector((camera.rows, camera.cols), camera.pixel_pitch_m, origin)
    light = lenslet_light(samples, tilt, centre, pitch, lenslet, detector, apart=rung != "coherent")
    # The sum over fields is a light to its tabulated accuracy: rounding of some 1e-6 of the brightest pixel may lie below zero.
    return np.asarray(np.maximum(light, 0.0) * (flux / clear_area_m2(rig)))


def _residual(rig: WavefrontRig, lattice: Lattice, field: Complex, tilt: Float) -> Complex:
    """Field (lenslet, samples, samples) at the cells of each clear square, its plane wave of slope `tilt` divided out."""
    per, fill = rig.pupil.samples, rig.lenslets.fill
    offset = (np.arange(per) - 0.5 * (per - 1)) * fill
    if fill == 1.0:
        across = len(lattice.grid_m) // per
        tiles = field[1:-1, 1:-1].reshape(across, per, across, per).transpose(0, 2, 1, 3)
        u = tiles[lattice.row, lattice.col]
    else:
        first = 1.0 + 0.5 * (per - 1)
        u = _between(field, *(first + per * site[:, None] + offset for site in (lattice.row, lattice.col)))
    return _level(u, tilt, np.asarray(offset * lattice.step_m, np.float64), rig.wavelength_m)


def _in_hexagons(rig: WavefrontRig, lattice: Lattice, field: Complex, tilt: Float, cells: int) -> Complex:
    """As `_residual` (lenslet, cells, cells), of the square about each clear hexagon: 0 where a cell lies outside it."""
    width = rig.lenslets.fill * rig.lenslets.pitch_m
    offset = (np.arange(cells) - 0.5 * (cells - 1)) * (_CORNERS * width / cells)
    middle = 0.5 * (len(field) - 1)
    u = _between(field, *(middle + (one[:, None] + offset) / lattice.step_m for one in (lattice.y_m, lattice.x_m)))
    return np.asarray(_level(u, tilt, offset, rig.wavelength_m) * _coverage(width, cells))


@lru_cache(maxsize=8)
def _coverage(width_m: float, cells: int) -> Float:
    sample, share = hexagon_coverage(np.zeros((1, 2)), width_m, _CORNERS * width_m / cells, cells)
    lit = np.bincount(sample[0], share[0], minlength=cells**2)
    return np.asarray(lit.reshape(cells, cells), np.float64)


def _between(field: Complex, down: Float, along: Float) -> Complex:
    """The field (lenslet, samples, samples) at rows `down` and columns `along` (lenslet, samples), linear between its samples."""
    from scipy.ndimage import map_coordinates

    shape = (len(down), down.shape[1], along.shape[1])
    at = [np.broadcast_to(down[:, :, None], shape), np.broadcast_to(along[:, None, :], shape)]
    return np.asarray(
        map_coordinates(field.real, at, order=1, mode="nearest")
        + 1j * map_coordinates(field.imag, at, order=1, mode="nearest")
    )


def _level(u: Complex, tilt: Float, x: Float, wavelength_m: float) -> Complex:
    """A field (lenslet, samples, samples) at places x (samples) [m] of both axes, its plane wave of slope `tilt` divided out."""
    k = 2.0 * np.pi / wavelength_m
    turn = np.exp(-1j * k * (tilt[:, 1, None, None] * x[:, None] + tilt[:, 0, None, None] * x))
    return np.asarray(u * turn)
