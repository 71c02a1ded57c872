"""The registration of a wavefront sensor as a laboratory does it, for the condition "calibrated": the lattice of a noisy reference.

A flat wavefront is recorded with the true instrument's lenslets and detector: a spot of every lenslet that the beam lights, of
as many photoelectrons in all as the suite states, in the fewest exposures that stay below half of the detector's range. A joint fit
of the spots gives their places, and least squares with their stated errors the lattice

    (col, row)_i = o + s R(θ) (k_i, l_i),    k, l the lenslet's place in the array, in pitches,

of four parameters: offset o [px], pitch s [px] and rotation θ. These replace what the rig declares: the places, the rotation, and
the size of a pixel p = D/s, D the lenslets' pitch, which is a mask's and known. The size of a pixel then scales all slopes by its
error. Focal length, wavelength and the shape of a spot stay as declared, and so does where the pupil lies on the array.
"""

from __future__ import annotations

import json
from typing import Any

import numpy as np
import numpy.typing as npt

from ...estimators.rig import DeclaredRig
from ...estimators.wavefront.cells import cells_of
from ...estimators.wavefront.fits import joint_positions
from ...estimators.wavefront.geometry import declared_geometry
from ...scenes.errors import InputError
from ...scenes.rigs.camera_noise import camera_noise
from ...scenes.rigs.wavefront import WavefrontRig, wavefront_rig
from ...scenes.rigs.wavefront_geometry import flat_spots, lattice_of
from ...scenes.scene import Scene
from ..suites.spec import Calibration
from ..written.draw import drawn_counts
from .judge import Draw

__all__ = ["reference_calibration"]

Float = npt.NDArray[np.float64]

#: Kind of the random stream of this record; those of other kinds of instruments differ.
_REFERENCE = 121
#: Part of the detector's range, from offset to its top, that the brightest pixel of an exposure fills at most.
_FILL = 0.5
#: Least number of spots, and the greatest rms distance [px] of spots from a lattice that is one.
_SPOTS, _OFF_PX = 6, 1.0


def reference_calibration(scene: Scene, rig: dict[str, Any], calibration: Calibration, draw: Draw) -> dict[str, Any]:
    """The declared rig after a registration by a reference; its error is a draw of the suite's photoelectrons.

    Raises InputError where the reference shows no lattice near the declared one.
    """
    true = wavefront_rig(scene)
    image, exposures = _recorded(true, calibration.of("spot_photoelectrons"), draw(_REFERENCE, 0))
    declared = DeclaredRig(json.dumps(rig), rig)
    geometry = declared_geometry(declared)
    cells = cells_of(image[None], declared, exposures=exposures)
    found = joint_positions(cells)
    good = found.good & cells.sound & geometry.within(np.nan_to_num(found.position))
    if good.sum() < _SPOTS:
        raise _refused(f"{int(good.sum())} spots in their cells", f"{_SPOTS} spots or more")
    place = geometry.place_px[good] + found.position[good]
    steps = geometry.steps()
    offset, turned, rest = _lattice(steps[good], place, found.variance[good])
    if rest > _OFF_PX:
        raise _refused(f"spots {rest:.3g} px rms from any lattice", f"{_OFF_PX:g} px or less")
    return _with(rig, steps, offset, turned)


def _refused(value: str, allowed: str) -> InputError:
    return InputError(
        "The reference does not show the declared lattice: the instrument cannot be registered in this way.",
        where="calibration", value=value, allowed=allowed,
        next_step='raise calibration.spot_photoelectrons, declare lenslets nearer to the true ones, or leave out "calibrated"',
    )  # fmt: skip


def _recorded(rig: WavefrontRig, photoelectrons: float, rng: np.random.Generator) -> tuple[Float, int]:
    """(mean counts of the exposures (rows, cols) [DN], their number) of a flat wavefront."""
    lit, noise = lattice_of(rig, every=True), camera_noise(rig.detector)
    whole = flat_spots(rig, lit.col_px, lit.row_px, np.full(lit.row.size, photoelectrons))
    gain = noise.intensifier_gain if noise.intensified else 1.0
    top = min((noise.adc_max_dn - noise.offset_dn) / noise.gain_dn_per_e, noise.full_well_e) / gain
    exposures = max(int(np.ceil(float(whole.max()) / (_FILL * top))), 1)
    total = np.zeros(whole.shape)
    for _ in range(exposures):
        total += drawn_counts(whole / exposures, noise, rng)
    return total / exposures, exposures


def _lattice(steps: Float, place: Float, variance: Float) -> tuple[Float, complex, float]:
    """(offset [px] (2), s e^{iθ} [px], rms rest [px]) by weighted least squares of four parameters.

    steps (spot, 2): along x and y in the array, in pitches. place (spot, 2): column and row on the camera.
    """
    col, row = steps.T
    one, none = np.ones(len(steps)), np.zeros(len(steps))
    design = np.concatenate([np.stack([one, none, col, -row], axis=1), np.stack([none, one, row, col], axis=1)])
    seen, weight = (
        np.concatenate([place[:, 0], place[:, 1]]),
        1.0 / np.sqrt(np.concatenate([variance[:, 0], variance[:, 1]])),
    )
    p = np.linalg.lstsq(design * weight[:, None], seen * weight, rcond=None)[0]
    return p[:2], complex(p[2], p[3]), float(np.sqrt(((design @ p - seen) ** 2).mean()))


def _with(rig: dict[str, Any], steps: Float, offset: Float, turned: complex) -> dict[str, Any]:
    """The declared rig with a registered lattice."""
    made: dict[str, Any] = json.loads(json.dumps(rig))
    place = complex(*offset) + turned * (steps[:, 0] + 1j * steps[:, 1])
    made["lenslets"] |= {
        "col_px": [float(value) for value in place.real],
        "row_px": [float(value) for value in place.imag],
        "rotation_rad": float(np.angle(turned)),
    }
    made["camera"]["pixel_pitch_m"] = float(made["lenslets"]["pitch_m"] / abs(turned))
    return made
