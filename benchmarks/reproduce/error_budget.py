"""Error sources that the prediction of Kusters 1992 leaves out: what each, of an assumed size, does to the range. None is fitted.

Geometry: a point of the sheet straight ahead of the laser is seen by the true camera, and its column is triangulated with one value
that is off; the change of range has a sign. Reading: the rms over the phases of a pixel of what a centre of mass above a threshold
errs, times the range of a column.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...optics.pinhole import Pinhole
from ...optics.rotation import rotation_matrix
from ...optics.sheet import Sheet, gaussian_mean, meeting
from ...scenes.load import load_scene
from ...scenes.medium_index import phase_index
from ...scenes.rigs.laser_line import laser_line_rig
from ...scenes.rigs.laser_line_geometry import line_camera, line_sheet

__all__ = ["RANGES_M", "Source", "budget", "centre_of_mass", "locking_px", "per_column_m"]

Float = NDArray[np.float64]

RANGES_M = (1.0, 2.0, 3.0, 4.0)
#: The instrument's threshold as a share of the peak, and phases of the pixel: ours.
_THRESHOLD, _PHASES = 0.3, 256


@dataclass(frozen=True)
class Source:
    """One source: what is off by how much, whether range errors are a change ("shift") or an rms ("spread"), and these [m]."""

    name: str
    assumed: str
    kind: str
    error_m: tuple[float, ...]


def _rig() -> tuple[Pinhole, Sheet, float, Any]:
    scene = load_scene("spotscan-wall")
    rig = laser_line_rig(scene)
    index = phase_index(scene.medium, rig.wavelength_m)
    return line_camera(rig, index), line_sheet(rig, index), index, rig


def _ahead(sheet: Sheet, range_m: float) -> Float:
    return np.asarray(sheet.source + range_m * sheet.frame[:, 2])


def _read(camera: Pinhole, sheet: Sheet, row: float, col: float) -> float:
    """Range [m] from the laser that a column means."""
    origin, direction = camera.rays(row, col)
    return float(np.linalg.norm(meeting(origin, direction, sheet.normal, sheet.source) - sheet.source))


def per_column_m(range_m: float) -> float:
    """Range [m] per column straight ahead: about R²/(n F b)."""
    camera, sheet, _, _ = _rig()
    row, col = (float(v) for v in camera.project(_ahead(sheet, range_m)))
    return abs(_read(camera, sheet, row, col + 0.01) - _read(camera, sheet, row, col - 0.01)) / 0.02


def _shifts(change: Callable[[Any, float], tuple[Pinhole, Sheet]]) -> tuple[float, ...]:
    """Range by the changed camera and sheet less the true one, at each range."""
    camera, sheet, index, rig = _rig()
    assumed_camera, assumed_sheet = change(rig, index)
    made = []
    for range_m in RANGES_M:
        row, col = (float(v) for v in camera.project(_ahead(sheet, range_m)))
        made.append(_read(assumed_camera, assumed_sheet, row, col) - range_m)
    return tuple(made)


def _no_stand_off(rig: Any, index: float) -> tuple[Pinhole, Sheet]:
    port = rig.port.model_copy(update={"stand_off_m": 0.0, "thickness_m": 0.0})
    return line_camera(rig.model_copy(update={"port": port}), index), line_sheet(rig, index)


def _other_index(rig: Any, index: float) -> tuple[Pinhole, Sheet]:
    return line_camera(rig, index + 0.01), line_sheet(rig, index)


def _other_laser(shift_m: float, turn_deg: float) -> Callable[[Any, float], tuple[Pinhole, Sheet]]:
    def change(rig: Any, index: float) -> tuple[Pinhole, Sheet]:
        laser = rig.laser
        aside = rotation_matrix(laser.rotation_deg)[:, 0] * shift_m
        moved = laser.model_copy(
            update={
                "position_m": tuple(float(v) for v in np.asarray(laser.position_m) + aside),
                "rotation_deg": (laser.rotation_deg[0], laser.rotation_deg[1] + turn_deg, laser.rotation_deg[2]),
            }
        )
        return line_camera(rig, index), line_sheet(rig.model_copy(update={"laser": moved}), index)

    return change


def centre_of_mass(profile: Float, threshold: float) -> Float:
    """Σ x z/Σ z (n) from the middle pixel of profiles (n, 2h + 1), over the pixels of at least `threshold` of the greatest."""
    x = np.arange(profile.shape[1]) - profile.shape[1] // 2
    weight = np.where(profile >= threshold * profile.max(axis=1, keepdims=True), profile, 0.0)
    return np.asarray((weight * x).sum(axis=1) / weight.sum(axis=1))


def locking_px(sigma_px: float, threshold: float = _THRESHOLD, overexposed: float = 0.0) -> float:
    """rms [px] over the phases of a pixel of the centre of mass of a line of σ = `sigma_px`. `overexposed`: the brightest phase's
    peak over the converter's top; what is above is cut, 0 for nothing."""
    phase = (np.arange(_PHASES) + 0.5) / _PHASES - 0.5
    x = np.arange(-20.0, 21.0)
    profile = gaussian_mean(x - 0.5 - phase[:, None], x + 0.5 - phase[:, None], sigma_px)
    if overexposed > 0:
        profile = np.minimum(profile, profile.max() / overexposed)
    return float(np.sqrt(((centre_of_mass(profile, threshold) - phase) ** 2).mean()))


def _width_px(range_m: float) -> float:
    """σ [px] of the line straight ahead at a range."""
    _, sheet, _, rig = _rig()
    across = per_column_m(range_m) * float(np.abs(_baseline(sheet))) / range_m
    return float(np.hypot(sheet.sigma(range_m) / across, rig.lens_sigma_px))


def _baseline(sheet: Sheet) -> float:
    return float(sheet.normal @ sheet.source)


def _spread(reading: Callable[[float], float]) -> tuple[float, ...]:
    """Range [m] of what a reading errs [px], for the line's width at each range."""
    return tuple(reading(_width_px(r)) * per_column_m(r) for r in RANGES_M)


def _more(value: float, plain: float) -> float:
    """What a change adds in squares, with the sign of the change."""
    return float(np.sign(value - plain) * np.sqrt(abs(value**2 - plain**2)))


def budget() -> list[Source]:
    """All sources, at 1, 2, 3 and 4 m."""
    return [
        Source("whole pixels", "rms 1/√12 px", "spread", _spread(lambda s: 12.0**-0.5)),
        Source("centre of mass", "threshold .3 of the peak, no noise", "spread", _spread(locking_px)),
        Source("port", "stand-off of 30 mm and 10 mm of glass left out", "shift", _shifts(_no_stand_off)),
        Source("index", "n too large by .01", "shift", _shifts(_other_index)),
        Source("angle", "camera angle off by .01 degrees", "shift", _shifts(_other_laser(0.0, 0.01))),
        Source("baseline", "too long by .1 mm", "shift", _shifts(_other_laser(1e-4, 0.0))),
        Source("lens aberration", "a quarter of a pixel, as the document adds it", "spread", _spread(lambda s: 0.25 / 12.0**0.5)),
        Source("beam width", "1.5 times as wide: added to the centre of mass", "spread",
               _spread(lambda s: _more(locking_px(1.5 * s), locking_px(s)))),
        Source("threshold", ".15 for .3 of the peak: added to the centre of mass", "spread",
               _spread(lambda s: _more(locking_px(s, 0.15), locking_px(s)))),
        Source("gain", "twice too high, so that peaks are cut: added to the centre of mass", "spread",
               _spread(lambda s: _more(locking_px(s, _THRESHOLD, 2.0), locking_px(s)))),
    ]  # fmt: skip
