"""Lenslets from a recorded reference: where they lie, how wide their spots are, and what the camera's noise is.

A recording states pitch, focal length and pixel, and not where the array lies on the chip. The reference shows it: each of its
spots is a lenslet. Frames are freed of their background (the median about each pixel over two pitches, taken every fourth pixel)
and of pixels that stand out of the eight around them, and get a common pedestal of a hundred times their noise.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt
from scipy.ndimage import map_coordinates, median_filter

from ...scenes.errors import InputError
from .field_search import spots_in

__all__ = ["cleaned", "lenslets_of_reference"]

Float = npt.NDArray[np.float64]

#: Least height of a spot over the noise of the smoothed frame.
_SIGMAS = 8.0
#: Share of the pupil's lenslets with a spot below which a frame is refused.
_HALF = 0.5
#: Height of a hot pixel over those around it, in standard deviations.
_HOT = 6.0
#: Every so many pixels in both directions give the background.
_COARSE = 4
#: Samples of the spot per pixel, and its half width in pitches.
_PER_PX, _REACH = 16, 16
_PEDESTAL = 100.0


def lenslets_of_reference(
    data: dict[str, Any], coords: dict[str, Any], rig: dict[str, Any], parameters: dict[str, Any]
) -> tuple[dict[str, Any], dict[str, Any]]:
    """(data, rig) with frames and reference cleaned, and the lenslets, spot, camera, pupil and detector of the rig filled in.

    Main arguments:
        data: counts (frame, row, col), reference (row, col). rig: with lenslets.pitch_m, lenslets.focal_length_m,
            camera.pixel_pitch_m and laser.wavelength_m.
        parameters: pupil_px, diameter of the pupil [px].

    The gain is taken as 1 DN per electron: the recording does not tell it.

    Raises:
        InputError: values of the rig that are missing, or a reference without a lattice of spots.
    """
    pitch = _number(rig, "lenslets", "pitch_m") / _number(rig, "camera", "pixel_pitch_m")
    pupil = float(parameters["pupil_px"]) if isinstance(parameters.get("pupil_px"), int | float) else 0.0
    if not (pitch >= 3.0 and pupil > pitch):
        raise InputError(
            "The reference cannot be searched for lenslets of these sizes.", where="rig.parameters.pupil_px",
            value=f"a pitch of {pitch:.3g} px, a pupil of {pupil:g} px", allowed="a pitch of 3 px or more, and a wider pupil",
        )  # fmt: skip
    frames = np.asarray(data["counts"], np.float64)
    clean = [cleaned(frame, pitch) for frame in frames]
    _refuse_few(clean, pitch, pupil, parameters)
    noise = clean[0][1]
    reference, flat_noise = cleaned(np.asarray(data["reference"], np.float64), pitch)
    # Frames and reference share one pedestal.
    counts = np.stack([frame for frame, _ in clean]) + _PEDESTAL * noise
    reference = reference * noise / flat_noise + _PEDESTAL * noise
    place = spots_in(reference, pitch, 1.5, _SIGMAS)
    if len(place) < 4:
        raise InputError(
            "The reference shows no lattice of spots.", where="reference", value=len(place), allowed="4 spots or more"
        )
    width = _spot_px(reference - _PEDESTAL * noise, place)
    pixel = _number(rig, "camera", "pixel_pitch_m")
    u = np.arange(-int(_REACH * pitch), int(_REACH * pitch) + 1) / _PER_PX
    diameter = pupil * pixel
    found = {
        **rig,
        "lenslets": {
            **rig["lenslets"], "rotation_rad": 0.0, "row": list(range(len(place))), "col": list(range(len(place))),
            "row_px": place[:, 1].tolist(), "col_px": place[:, 0].tolist(),
            "x_m": ((place[:, 0] - place[:, 0].mean()) * pixel).tolist(),
            "y_m": ((place[:, 1] - place[:, 1].mean()) * pixel).tolist(),
        },
        "pupil": {"shape": "disc", "diameter_m": diameter, "samples": 4, "step_m": diameter / 4, "modes": 21},
        "camera": {"rows": counts.shape[1], "cols": counts.shape[2], "pixel_pitch_m": pixel},
        "spot": {"start_px": float(u[0]), "step_px": 1.0 / _PER_PX, "value": np.exp(-0.5 * (u / width) ** 2).tolist()},
        "detector": {
            "gain_dn_per_e": 1.0, "offset_dn": _PEDESTAL * noise, "read_noise_e": noise, "full_well_e": 1e9, "adc_bits": 31,
            "dark_current_e_per_s": 0.0, "exposure_s": 1.0, "prnu": 0.0, "dsnu_e": 0.0, "intensifier": None,
        },
        "reference": {"exposures": 1},
    }  # fmt: skip
    return {**data, "counts": counts.astype(np.float32), "reference": reference.astype(np.float32)}, found


def _refuse_few(clean: list[tuple[Float, float]], pitch: float, pupil_px: float, parameters: dict[str, Any]) -> None:
    """Refuse a frame that shows fewer spots than half of the pupil's lenslets."""
    inner = parameters.get("pupil_inner_px", 0.0)
    lenslets = np.pi / 4 * (pupil_px / pitch) ** 2 - np.pi * (float(inner) / pitch) ** 2
    for number, (frame, _) in enumerate(clean):
        found = len(spots_in(frame, pitch, 1.5, _SIGMAS))
        if found < _HALF * lenslets:
            raise InputError(
                "The frame shows too few spots for a wavefront.", where=f"counts: frame {number}", value=found,
                allowed=f"half of the {lenslets:.0f} lenslets of the pupil", next_step="focus the sensor, and record again",
            )  # fmt: skip


def _number(rig: dict[str, Any], part: str, name: str) -> float:
    node = rig.get(part)
    value = node.get(name) if isinstance(node, dict) else None
    if not isinstance(value, int | float) or not value > 0:
        raise InputError(
            "The registration of lenslets needs a value of the rig.", where=f"rig.declared.{part}.{name}", value=value,
            allowed="a number above 0, m",
        )  # fmt: skip
    return float(value)


def cleaned(image: Float, pitch: float) -> tuple[Float, float]:
    """The image without its background, the median about each pixel over two pitches, and without pixels that stand out of the
    eight around them (particles, hot pixels); and its noise, 1.4826 times the median absolute deviation."""
    coarse = median_filter(image[::_COARSE, ::_COARSE], 2 * int(pitch / _COARSE) + 1)
    row, col = (np.arange(n, dtype=float) / _COARSE for n in image.shape)
    image = image - map_coordinates(coarse, np.meshgrid(row, col, indexing="ij"), order=1, mode="nearest")
    noise = max(1.4826 * float(np.median(np.abs(image - np.median(image)))), 1e-9)
    around = median_filter(image, 3)
    return np.where(image - around > _HOT * noise + 2.0 * np.maximum(around, 0.0), around, image), noise


def _spot_px(light: Float, place: Float) -> float:
    """σ [px] of the reference's spots: that of the Gaussian through the middle pixel and its neighbours of the mean spot."""
    at = place.astype(int)
    inside = ((at > 3) & (at < np.array(light.shape[::-1]) - 4)).all(axis=1)
    mean = np.mean([light[y - 1 : y + 2, x - 1 : x + 2] for x, y in at[inside]], axis=0)
    beside = np.clip((mean[1, 0] + mean[1, 2] + mean[0, 1] + mean[2, 1]) / 4.0 / mean[1, 1], 1e-3, 0.97)
    return float(np.sqrt(-0.5 / np.log(beside)))
