"""The spot field behind the lenslets, photoelectrons per pixel, at each rung.

`geometric`: the spot of a flat wavefront, moved by the lenslet's mean slope. `isolated`: diffraction of each lenslet's own field,
intensities added. `coherent`: fields added on one detector.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ...optics.lenslets.coherent import Detector, Lenslet, coherent_image
from ...optics.lenslets.coherent import spot_field as lenslet_field
from ...optics.lenslets.spots import isolated_image
from ...scenes.rigs.wavefront_geometry import Lattice, spot_px
from ...scenes.rigs.wavefront_spec import WavefrontRig
from .truth import slopes

__all__ = ["REACH_PITCHES", "spot_image"]

Float = NDArray[np.float64]
Complex = NDArray[np.complex128]

#: Half side [pitches] of the square about a lenslet within which its field is kept: 98.7 % of the light of each axis.
REACH_PITCHES = 2.5
#: Gauss-Legendre nodes per pixel and axis, and lenslets that are computed at once.
_NODES, _CHUNK = 4, 64


def spot_image(rig: WavefrontRig, lattice: Lattice, field: Complex, flux: float, rung: str) -> Float:
    """Photoelectrons (rows, cols) of a field (side + 2, side + 2) of unit mean power that gives each lenslet `flux` photoelectrons
    for |u| = 1."""
    tilt = slopes(field, lattice, rig.pupil.samples, rig.wavelength_m)
    tilt = np.where(np.isfinite(tilt), tilt, 0.0)
    if rung == "geometric":
        per_rad = rig.lenslets.focal_length_m / rig.camera.pixel_pitch_m
        at = np.stack([lattice.col_px, lattice.row_px], axis=1) + per_rad * tilt
        shape = (rig.camera.rows, rig.camera.cols)
        return isolated_image(at[:, 0], at[:, 1], np.full(len(at), flux), spot_px(rig), shape)
    lenslet = Lenslet(rig.lenslets.fill * rig.lenslets.pitch_m, rig.lenslets.focal_length_m, rig.wavelength_m)
    samples = _residual(rig, lattice, field, tilt)
    camera, pitch = rig.camera, rig.lenslets.pitch_m
    middle = 0.5 * (np.array([camera.cols, camera.rows]) - 1.0)
    centre = (np.stack([lattice.col_px, lattice.row_px], axis=1) - middle) * camera.pixel_pitch_m
    origin = (-float(middle[0]) * camera.pixel_pitch_m, -float(middle[1]) * camera.pixel_pitch_m)
    detector = Detector((camera.rows, camera.cols), camera.pixel_pitch_m, origin, _NODES)
    reach = REACH_PITCHES * pitch
    if rung == "coherent":
        light = coherent_image(samples, tilt, centre, lenslet, detector, reach_m=reach)
    else:
        light = _each_alone(samples, tilt, centre, lenslet, detector, reach)
    return np.asarray(light * (flux / lenslet.side_m**2))


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


def _each_alone(
    samples: Complex, tilt: Float, centre: Float, lenslet: Lenslet, detector: Detector, reach_m: float
) -> Float:
    """Σ |U_m|² over each pixel, as `coherent_image` without interference."""
    node, weight = np.polynomial.legendre.leggauss(detector.nodes)
    rows, cols = detector.shape
    image = np.zeros(detector.shape)
    pixel = detector.pixel_m
    half = int(np.ceil(reach_m / pixel))
    middle = np.rint((centre - np.asarray(detector.origin_m)) / pixel).astype(np.int64)
    step = np.arange(-half, half + 1)
    for begin in range(0, len(samples), _CHUNK):
        part = slice(begin, begin + _CHUNK)
        index = middle[part, :, None] + step
        place = [detector.origin_m[a] + pixel * index[:, a] - centre[part, a, None] for a in (0, 1)]
        points = [(at[:, :, None] + 0.5 * pixel * node).reshape(len(at), -1) for at in place]
        field = lenslet_field(samples[part], tilt[part], points[0], points[1], lenslet)
        light = (field.real**2 + field.imag**2).reshape(len(field), step.size, node.size, step.size, node.size)
        own = 0.25 * pixel**2 * np.einsum("lrgch,g,h->lrc", light, weight, weight, optimize=True)
        for number, one in enumerate(own):
            row, col = index[number, 1], index[number, 0]
            down, along = (row >= 0) & (row < rows), (col >= 0) & (col < cols)
            if down.any() and along.any():
                image[row[down][0] : row[down][-1] + 1, col[along][0] : col[along][-1] + 1] += one[np.ix_(down, along)]
    return image
