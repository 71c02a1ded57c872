"""The procedure "lenslets": where an array of lenslets lies on the chip, from the spot field of a flat wavefront (the reference).

The spots of the reference lie on the lattice of the declared lenslets, moved, turned and scaled: with (u, v) a lenslet's centre in
pitches about the array's centre,

    x = c_x + a u − b v,   y = c_y + b u + a v,   q = √(a² + b²) [px],   θ = atan2(b, a),

by weighted least squares of the spots' places: the declared spot fitted to the pixels, all spots jointly, those of lenslets beside
the declared ones too. q is the pitch in pixels, θ the array's turn, and (c_x, c_y) from the chip's middle its offset. The
covariance is that of the least squares, times χ² per degree of freedom where that is above 1: lenslets that do not stand evenly.

What a lattice cannot show: a step by whole pitches along its axes, and a turn by 90° (hexagons: 60°). Of all such answers the one
nearest to the declared values is given. A reference of radius R has a pitch larger by f/R, f the focal length of the lenslets.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import numpy.typing as npt
import xarray as xr
from scipy.optimize import minimize_scalar
from scipy.spatial import cKDTree
from scipy.special import ndtr

from ...scenes.errors import InputError
from ..rig import DeclaredRig
from ..wavefront.cells import Scale, cells_of, check_frames, sought
from ..wavefront.field_search import spots_in
from ..wavefront.fits import joint_positions
from ..wavefront.geometry import Geometry, declared_geometry, declared_spot
from .procedure import Calibrated, Figure, Procedure

__all__ = ["LENSLETS", "Lattice", "fitted_lattice"]

Float = npt.NDArray[np.float64]

_KIND = "wavefront"
#: Height of a spot over the noise of its pixels.
_SIGMAS = 5.0
#: Share of the declared lenslets whose spots must be found, and their least number.
_HALF, _LEAST = 0.5, 8
#: Relative error of the pitch beyond which the array is another: at first sight, of whole pixels, and fitted.
_COARSE, _OFF_SCALE = 0.2, 0.05
#: rms distance of spots from their lattice, as a share of the pitch, beyond which they are on none.
_OFF_LATTICE = 0.1
#: Spots this many median residuals beside the lattice are left out: dust, and spots of other light.
_OUTLIER = 6.0
#: Distance [pitches] up to which lenslets beside the declared ones are fitted with them.
_AROUND = 2.6
#: Parts of the spots that are left out in turn for the error of their width.
_PARTS = 8
_STEP = "told but for whole pitches along the array's axes: the nearest to the declared one"


@dataclass(frozen=True, eq=False)
class Lattice:
    """A lattice: middle_px (x, y), pitch_px, turn_rad, and `covariance` (4, 4) of them in this order. rms_px: of the spots about
    it, per axis; chi2: per degree of freedom; used (spot): which counted."""

    middle_px: Float
    pitch_px: float
    turn_rad: float
    covariance: Float
    rms_px: float
    chi2: float
    used: npt.NDArray[np.bool_]


def fitted_lattice(place_px: Float, variance: Float, steps: Float) -> Lattice:
    """The lattice of the module's equations.

    Main arguments:
        place_px, variance (spot, axis) [px, px²]: places and their variances. steps (spot, axis): centres in pitches.

    Raises InputError for fewer than three spots, or spots that stand on one point.
    """
    used = np.ones(len(place_px), bool)
    for _ in range(3):
        value, inverse, rest, weight = _solved(place_px[used], variance[used], steps[used])
        away = np.abs(place_px - _on(value, steps)).max(axis=1)
        limit = _OUTLIER * 1.4826 * float(np.median(np.abs(rest)))
        kept = away <= max(limit, 1e-9)
        if (kept == used).all() or kept.sum() < _LEAST:
            break
        used = kept
    free = max(rest.size - 4, 1)
    chi2 = float((weight * rest**2).sum()) / free
    a, b = value[2:]
    q = math.hypot(a, b)
    turn = np.eye(4)
    turn[2:, 2:] = np.array([[a / q, b / q], [-b / q**2, a / q**2]])
    covariance = turn @ inverse @ turn.T * max(chi2, 1.0)
    return Lattice(value[:2], q, math.atan2(b, a), covariance, float(np.sqrt((rest**2).mean())), chi2, used)


def _on(value: Float, steps: Float) -> Float:
    """Places (spot, axis) of a lattice (c_x, c_y, a, b)."""
    x, y, a, b = value
    return np.stack([x + a * steps[:, 0] - b * steps[:, 1], y + b * steps[:, 0] + a * steps[:, 1]], axis=1)


def _solved(place: Float, variance: Float, steps: Float) -> tuple[Float, Float, Float, Float]:
    """(c_x, c_y, a, b), (JᵀWJ)⁻¹, residuals and weights (2 spots)."""
    one, none = np.ones(len(steps)), np.zeros(len(steps))
    u, v = steps.T
    design = np.concatenate([np.stack([one, none, u, -v], axis=1), np.stack([none, one, v, u], axis=1)])
    weight = 1.0 / np.maximum(variance.T.ravel(), 1e-18)
    normal = design.T @ (weight[:, None] * design)
    if len(place) < 3 or np.linalg.matrix_rank(design) < 4:
        raise InputError("Too few spots for a lattice.", where="reference", value=len(place), allowed="3 spots or more")
    inverse = np.linalg.inv(normal)
    value = inverse @ (design.T @ (weight * place.T.ravel()))
    return value, inverse, place.T.ravel() - design @ value, weight


def _lacking(captures: Sequence[xr.Dataset]) -> str:
    if any(str(one.attrs.get("modality")) != _KIND for one in captures):
        return "frames of a lenslet camera"
    return "" if all("reference" in one for one in captures) else "a reference: the spot field of a flat wavefront"


def _run(captures: Sequence[xr.Dataset]) -> Calibrated:
    """The lattice of all references together. Raises InputError for a rig that declares no array, and spots that are on none."""
    first: Geometry | None = None
    seen: dict[bytes, tuple[Float, Float]] = {}
    last: Any = None
    for capture in captures:
        rig, _, reference = check_frames(capture)
        geometry = declared_geometry(rig)
        _check_array(geometry, first)
        first = first or geometry
        key = np.ascontiguousarray(reference).tobytes()
        if key not in seen:
            seen[key] = _places(np.asarray(reference, np.float64), rig, geometry)
            last = rig, np.asarray(reference, np.float64)
    assert first is not None
    place, variance = _mean(list(seen.values()))
    known = np.asarray(np.isfinite(variance).all(axis=1))
    _refuse_few(int(known.sum()), first)
    steps = first.centre_m / first.pitch_m
    found = fitted_lattice(place[known], variance[known], steps[known])
    _check_lattice(found, first)
    rig, reference = last
    moved = replace(first, place_px=np.rint(_on(_value(found), steps)))
    return _calibrated(found, rig, _widths(reference, rig, moved, place), len(known), len(seen))


def _value(found: Lattice) -> Float:
    turn = found.turn_rad
    return np.array([*found.middle_px, found.pitch_px * math.cos(turn), found.pitch_px * math.sin(turn)])


def _check_array(geometry: Geometry, first: Geometry | None) -> None:
    """Refuse lenslets that were found in a recording and stand on no array, and captures of several arrays."""
    height = math.sqrt(0.75) if geometry.hexagonal else 1.0
    off = geometry.centre_m[:, 1] / (height * geometry.pitch_m) - geometry.site[:, 0]
    if off.size < 2 or float(np.ptp(off)) > 0.1:
        raise InputError(
            "The declared lenslets do not stand on an array.", where="attribute rig: lenslets.row, lenslets.y_m",
            value="rows and centres disagree", allowed="places of one array, as a scene's rig declares them",
            next_step="import the recording with [rig] scene = ..., without register",
        )  # fmt: skip
    if first is not None and not (
        first.centre_m.shape == geometry.centre_m.shape and np.allclose(first.centre_m, geometry.centre_m)
        and np.allclose(first.place_px, geometry.place_px)
    ):  # fmt: skip
        raise InputError(
            "The captures declare several arrays.", where="attribute rig: lenslets", value="different places", allowed="one array",
            next_step="calibrate the captures of each array alone",
        )  # fmt: skip


def _places(reference: Float, rig: DeclaredRig, geometry: Geometry) -> tuple[Float, Float]:
    """Places and variances (lenslet, axis) [px] of a reference's spots; infinite variance where none is found."""
    scale = Scale.of(rig)
    light = np.where(scale.good(reference), scale.electrons(reference), np.nan)
    spots = spots_in(light, geometry.pitch_px, declared_spot(rig).sigma_px, _SIGMAS)
    if len(spots) >= _LEAST:
        distance = np.asarray(cKDTree(spots).query(spots, 2)[0])[:, 1]
        apart = float(np.median(distance)) / geometry.pitch_px
        if abs(apart - 1.0) > _COARSE:
            raise _other_pitch(apart * geometry.pitch_px, geometry)
    found = sought(reference, rig, joint_positions, _SIGMAS, exposures=rig.whole("reference.exposures"))
    good = found.good & (found.variance > 0).all(axis=1)
    _refuse_few(int(good.sum()), geometry)
    steps = geometry.centre_m / geometry.pitch_m
    lattice = fitted_lattice((geometry.place_px + found.position)[good], found.variance[good], steps[good])
    _check_lattice(lattice, geometry, few=False)
    wider = _with_neighbours(geometry, lattice, reference.shape)
    cells = cells_of(
        reference[None], rig, exposures=rig.whole("reference.exposures"), least_sigmas=_SIGMAS, moved=wider
    )
    joint = joint_positions(cells)
    good = joint.good & cells.sound & wider.within(joint.position) & (joint.variance > 0).all(axis=1)
    many = len(geometry.place_px)
    return (wider.place_px + joint.position)[:many], np.where(good[:, None], joint.variance, np.inf)[:many]


def _with_neighbours(geometry: Geometry, lattice: Lattice, shape: tuple[int, ...]) -> Geometry:
    """The lenslets where the lattice has them, to the pixel, and after them those of the array around them that the image holds:
    their light lies in the outer cells, and draws spots there outward."""
    steps = geometry.centre_m / geometry.pitch_m
    second = np.array([0.5, math.sqrt(0.75)]) if geometry.hexagonal else np.array([0.0, 1.0])
    number = np.arange(-4, 5)
    near = (number[:, None, None] * np.array([1.0, 0.0]) + number[None, :, None] * second).reshape(-1, 2)
    near = near[(np.hypot(*near.T) > 0.5) & (np.hypot(*near.T) <= _AROUND)]
    tried = (steps[:, None] + near).reshape(-1, 2)
    tried = tried[np.unique(np.round(tried, 3), axis=0, return_index=True)[1]]
    new = tried[np.asarray(cKDTree(steps).query(tried)[0]) > 0.5]
    place, half = _on(_value(lattice), new), 0.5 * lattice.pitch_px + 1.0
    new = new[((place > half) & (place < np.array(shape[::-1]) - 1.0 - half)).all(axis=1)]
    every = np.concatenate([steps, new])
    site = np.concatenate([geometry.site, np.full((len(new), 2), -1)])
    return replace(
        geometry, place_px=np.rint(_on(_value(lattice), every)), centre_m=every * geometry.pitch_m, site=site
    )


def _mean(each: Sequence[tuple[Float, Float]]) -> tuple[Float, Float]:
    """Weighted mean of places, and its variance."""
    weight = np.stack([1.0 / variance for _, variance in each])
    total = weight.sum(axis=0)
    with np.errstate(divide="ignore", invalid="ignore"):
        place = (weight * np.stack([place for place, _ in each])).sum(axis=0) / total
        return place, 1.0 / total


def _refuse_few(found: int, geometry: Geometry) -> None:
    lenslets = len(geometry.place_px)
    least = max(_LEAST, math.ceil(_HALF * lenslets))
    if found < least:
        raise InputError(
            "The reference shows too few spots of the declared lenslets.", where="reference", value=f"{found} of {lenslets}",
            allowed=f"{least} or more, neither full nor dead",
            next_step="record the flat wavefront with more light, or check pitch, rotation and pixel pitch of the declared rig",
        )  # fmt: skip


def _other_pitch(pitch_px: float, geometry: Geometry) -> InputError:
    return InputError(
        "The spots of the reference have another pitch than the declared lenslets.", where="attribute rig: lenslets.pitch_m",
        value=f"{pitch_px:.4g} px", allowed=f"{geometry.pitch_px:.4g} px ± {100.0 * _OFF_SCALE:g} %",
        next_step="check the declared pitch of lenslets and pixels",
    )  # fmt: skip


def _check_lattice(found: Lattice, geometry: Geometry, *, few: bool = True) -> None:
    if abs(found.pitch_px / geometry.pitch_px - 1.0) > _OFF_SCALE:
        raise _other_pitch(found.pitch_px, geometry)
    if few:
        _refuse_few(int(found.used.sum()), geometry)
    if found.rms_px > _OFF_LATTICE * geometry.pitch_px:
        raise InputError(
            "The spots of the reference lie on no lattice.", where="reference", value=f"{found.rms_px:.3g} px rms beside it",
            allowed=f"{_OFF_LATTICE * geometry.pitch_px:.3g} px", next_step="record a flat wavefront",
        )  # fmt: skip


def _widths(reference: Float, rig: DeclaredRig, moved: Geometry, place: Float) -> tuple[float, float, float]:
    """(σ of the Gaussian fitted to the reference's spots, its standard error, σ of that fitted to the declared spot) [px]."""
    cells = cells_of(reference[None], rig, exposures=rig.whole("reference.exposures"), moved=moved)
    at = place - moved.place_px
    good = cells.sound & np.isfinite(at).all(axis=1) & moved.within(np.nan_to_num(at, nan=np.inf))
    x, y = (np.asarray(part[good], np.float64) for part in (cells.x - at[:, :1], cells.y - at[:, 1:]))
    inside = cells.inside[good]
    spot = declared_spot(rig)
    ideal = spot.share(y)[:, :, None] * spot.share(x)[:, None, :] * inside

    def width(z: Float, some: npt.NDArray[np.bool_]) -> float:
        def misfit(log_s: float) -> float:
            s = math.exp(log_s)
            px, py = (ndtr((u[some] + 0.5) / s) - ndtr((u[some] - 0.5) / s) for u in (x, y))
            model = py[:, :, None] * px[:, None, :] * inside[some]
            light = (model * z[some]).sum(axis=(1, 2)) / (model**2).sum(axis=(1, 2))
            return float(((z[some] - light[:, None, None] * model) ** 2).sum())

        ends = (math.log(0.1), math.log(moved.pitch_px))
        return math.exp(float(minimize_scalar(misfit, bounds=ends, method="bounded", options={"xatol": 1e-6}).x))

    number = np.arange(int(good.sum()))
    every = number >= 0
    left = np.array([width(cells.z[good], number % _PARTS != part) for part in range(_PARTS)])
    error = math.sqrt((_PARTS - 1) / _PARTS * float(((left - left.mean()) ** 2).sum()))
    return width(cells.z[good], every), error, width(ideal, every)


def _calibrated(
    found: Lattice, rig: DeclaredRig, widths: tuple[float, float, float], lenslets: int, references: int
) -> Calibrated:
    pixel = rig.number("camera.pixel_pitch_m", above=0)
    middle = 0.5 * (np.array([rig.whole("camera.cols"), rig.whole("camera.rows")]) - 1.0)
    offset = (found.middle_px - middle) * pixel
    x, y, pitch, turn = np.sqrt(np.diag(found.covariance)).tolist()
    flat = "of a flat reference: one of radius R adds f/R"
    per_turn = 60 if "hexagonal" in str(rig.get("lenslets.grid")) else 90
    figures = (
        Figure("array, x from the chip's middle", "m", float(offset[0]), x * pixel, "rig.lenslets.offset_m.0", _STEP),
        Figure("array, y from the chip's middle", "m", float(offset[1]), y * pixel, "rig.lenslets.offset_m.1", _STEP),
        Figure("turn of the array", "degree", math.degrees(found.turn_rad), math.degrees(turn), "rig.lenslets.rotation_deg",
               f"told but for {per_turn} degrees"),
        Figure("pitch", "m", found.pitch_px * pixel, pitch * pixel, "rig.lenslets.pitch_m", "by the declared pitch of pixels"),
        Figure("pitch in pixels", "px", found.pitch_px, pitch, "", flat),
        Figure("width of the spots, 1 σ", "px", widths[0], widths[1], "", "of a Gaussian; a rig holds what it follows from"),
        Figure("the same of the declared spot", "px", widths[2], math.nan),
        Figure("spots about the lattice, rms", "px", found.rms_px, math.nan),
        Figure("χ² per degree of freedom", "1", found.chi2, math.nan, "", "above 1: lenslets that do not stand evenly"),
    )  # fmt: skip
    values = {
        "rig.lenslets.preset": "", "rig.lenslets.focal_length_m": rig.number("lenslets.focal_length_m", above=0),
        "rig.lenslets.offset_m": offset.tolist(),
    }  # fmt: skip
    used = {"lenslets": lenslets, "spots": int(found.used.sum()), "references": references}
    return Calibrated(figures, values, used=used)


LENSLETS = Procedure(
    "lenslets",
    "offset, turn and pitch of a lenslet array on its chip, from the spot field of a flat wavefront",
    _lacking,
    _run,
)
