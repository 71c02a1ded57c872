"""Reading spot fields: a window of photoelectrons around the declared place of every spot, frame by frame.

`measured` runs one method over the frames and over the reference, and gives the positions relative to the reference: the place
that the rig declares, plus how far the spot of the frame lies from that of the reference. What is wrong with the declared place,
with the array's tilt and with the lenslets is the same in both and drops out; the noise of both counts.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import lru_cache, partial
from typing import Any, Literal

import numpy as np
import numpy.typing as npt
import xarray as xr
from scipy.spatial import cKDTree

from ...scenes.errors import InputError
from ..result import stage_result
from ..rig import DeclaredRig, read_rig
from .field_search import assigned_spots, spots_in
from .geometry import Geometry, Spot, declared_geometry, declared_spot
from .options import in_range
from .reference import check_reference

__all__ = [
    "Cells",
    "Found",
    "Method",
    "Reader",
    "Scale",
    "Search",
    "cells_of",
    "check_frames",
    "corner_px",
    "first_guess",
    "measured",
    "relative",
    "sought",
    "whole_cells",
]

Float = npt.NDArray[np.float64]
Bool = npt.NDArray[np.bool_]

#: Where the spot of a lenslet is looked for: in its cell, or anywhere in the frame.
Search = Literal["cell", "field"]

#: A pixel of a cell whose distance from the middle is above this share of the pitch, in both axes, shows the background.
_CORNER = 0.35
#: Places of a spot within a pixel, per axis, and its photoelectrons, from which a method's error without noise is computed.
_PHASES, _BRIGHT = 8, 1e6
#: Cells that a method gets together: some MB.
_AT_ONCE = 4096


@dataclass(frozen=True, eq=False)
class Found:
    """What a method finds: position [px] (lenslet, axis) from the declared place, its variance [px²] without that of the
    reference, and whether it found a spot (lenslet)."""

    position: Float
    variance: Float
    good: Bool


@dataclass(frozen=True, eq=False)
class Cells:
    """The cells of one image or several, w pixels wide; "lenslet" counts those of all images, one after the other.

    z (lenslet, w, w): photoelectrons above the background, 0 outside the cell. variance: of each pixel. x (lenslet, w), y: columns
    and rows of the pixels from the declared place. inside (lenslet, w, w): the cell. level (lenslet): background, photoelectrons.
    sound (lenslet): cells without bad pixels that show a spot. floor_e2: variance of a pixel without light; excess: F², both over
    the number of exposures. alone: whether the cells hold one spot each and no image lies behind them.
    """

    z: Float
    variance: Float
    x: Float
    y: Float
    inside: Bool
    level: Float
    sound: Bool
    floor_e2: float
    excess: float
    geometry: Geometry
    spot: Spot
    alone: bool = False


Method = Callable[[Cells], Found]
#: images (image, rows, cols) [DN], declared rig, exposures of each, least height of a spot -> what is found, sound cells only.
Reader = Callable[[npt.NDArray[Any], DeclaredRig, int, float], Found]


@dataclass(frozen=True)
class Scale:
    """From counts to photoelectrons, and which counts are data."""

    offset_dn: float
    dn_per_e: float
    top_dn: float
    dead_dn: float
    floor_e2: float
    excess: float

    @staticmethod
    def of(rig: DeclaredRig) -> Scale:
        """The scale of a declared detector."""
        converter, (gain, excess) = rig.converter("detector"), rig.amplifier("detector.intensifier")
        return Scale(
            converter.offset_dn, converter.gain_dn_per_e * gain, converter.saturation_dn, converter.dead_dn,
            converter.floor_e2 / gain**2, excess,
        )  # fmt: skip

    def electrons(self, counts: npt.NDArray[Any]) -> Float:
        """Photoelectrons of counts."""
        with np.errstate(invalid="ignore"):
            return np.asarray((np.asarray(counts, np.float64) - self.offset_dn) / self.dn_per_e)

    def good(self, counts: npt.NDArray[Any]) -> Bool:
        """Whether pixels are finite, neither clipped nor dead."""
        values = np.asarray(counts, np.float64)
        with np.errstate(invalid="ignore"):
            return np.asarray(np.isfinite(values) & (values < self.top_dn) & (values > self.dead_dn))


@dataclass(frozen=True, eq=False)
class _Gather:
    """Indices of the pixels of every cell."""

    row: npt.NDArray[np.int64]
    col: npt.NDArray[np.int64]
    x: Float
    y: Float
    inside: Bool
    corner: Bool
    whole: Bool


@lru_cache(maxsize=8)
def _declared_gather(rig: DeclaredRig, rows: int, cols: int) -> _Gather:
    return _gather(declared_geometry(rig), rows, cols)


def _gather(geometry: Geometry, rows: int, cols: int) -> _Gather:
    half = 0.5 * geometry.pitch_px
    reach = int(np.floor(half)) + 1
    step = np.arange(-reach, reach + 1)
    middle = np.rint(geometry.place_px).astype(np.int64)
    col, row = middle[:, :1] + step, middle[:, 1:] + step
    x, y = col - geometry.place_px[:, :1], row - geometry.place_px[:, 1:]
    inside = (np.abs(y) <= half)[:, :, None] & (np.abs(x) <= half)[:, None, :]
    far = corner_px(geometry)
    corner = inside & (np.abs(y) > far)[:, :, None] & (np.abs(x) > far)[:, None, :]
    there = ((row >= 0) & (row < rows))[:, :, None] & ((col >= 0) & (col < cols))[:, None, :]
    whole = np.asarray((there | ~inside).all(axis=(1, 2)))
    return _Gather(np.clip(row, 0, rows - 1), np.clip(col, 0, cols - 1), x, y, inside & there, corner & there, whole)


def corner_px(geometry: Geometry) -> float:
    """Distance [px] from the middle of a cell, in both axes, beyond which a pixel shows the background."""
    return min(_CORNER * geometry.pitch_px, 0.5 * geometry.pitch_px - 0.51)


def whole_cells(rig: DeclaredRig, rows: int, cols: int) -> Bool:
    """Which cells lie within an image of this size (lenslet)."""
    return _declared_gather(rig, rows, cols).whole


def cells_of(
    images: npt.NDArray[Any], rig: DeclaredRig, *, exposures: int = 1, least_sigmas: float = 5.0, moved: Geometry | None = None
) -> Cells:  # fmt: skip
    """The cells of images (image, rows, cols) [DN].

    Other arguments:
        exposures: that the image is the mean of. least_sigmas: height of a spot's brightest pixel over the background, in
            standard deviations of a pixel without light. moved: places of the spots where they are not the declared ones.

    The background of an image is the mean of the corners of a cell, the median over all of them.
    """
    geometry, scale = moved or declared_geometry(rig), Scale.of(rig)
    at = _gather(geometry, *images.shape[1:]) if moved else _declared_gather(rig, *images.shape[1:])
    counts = images[:, at.row[:, :, None], at.col[:, None, :]]
    good = scale.good(counts)
    z = scale.electrons(counts)
    level = _levels(z, at.corner & good)[:, None, None, None]
    z = np.where(at.inside & good, z - level, 0.0)
    floor, excess = scale.floor_e2 / exposures, scale.excess / exposures
    variance = excess * np.maximum(z + level, 0.0) + floor
    sound = at.whole & (good | ~at.inside).all(axis=(2, 3)) & np.isfinite(level[:, :, 0, 0])
    with np.errstate(invalid="ignore"):
        sound &= z.max(axis=(2, 3)) > least_sigmas * np.sqrt(floor + excess * np.maximum(level[:, :, 0, 0], 0.0))
    flat = (-1, *z.shape[2:])
    every = np.tile(np.arange(z.shape[1]), len(z))
    held = np.nan_to_num(np.repeat(level.ravel(), z.shape[1]))
    return Cells(
        np.nan_to_num(z).reshape(flat), np.nan_to_num(variance).reshape(flat), at.x[every], at.y[every], at.inside[every], held,
        sound.ravel(), floor, excess, geometry, declared_spot(rig),
    )  # fmt: skip


def _levels(z: Float, clear: Bool) -> Float:
    """Background [photoelectrons] (image): the median over the cells of the means of their corners; NaN where none is clear."""
    number = clear.sum(axis=(2, 3))
    with np.errstate(invalid="ignore", divide="ignore"):
        corners = np.where(clear, z, 0.0).sum(axis=(2, 3)) / number
    known = (number > 0).any(axis=1)
    level = np.full(len(z), np.nan)
    if known.any():
        level[known] = np.nanmedian(corners[known], axis=1)
    return level


def first_guess(cells: Cells) -> Float:
    """Place of the brightest pixel, moved by the balance of its neighbours, and the light of the cell."""
    lenslets, width, _ = cells.z.shape
    every = np.arange(lenslets)
    peak = np.where(cells.inside, cells.z, -np.inf).reshape(lenslets, -1).argmax(axis=1)
    row, col = np.clip(peak // width, 1, width - 2), np.clip(peak % width, 1, width - 2)
    top = np.maximum(cells.z[every, row, col], 1e-12)
    x = cells.x[every, col] + np.clip(
        0.5 * (cells.z[every, row, col + 1] - cells.z[every, row, col - 1]) / top, -0.5, 0.5
    )
    y = cells.y[every, row] + np.clip(
        0.5 * (cells.z[every, row + 1, col] - cells.z[every, row - 1, col]) / top, -0.5, 0.5
    )
    return np.stack([x, y, np.maximum(cells.z.sum(axis=(1, 2)), 1e-6)], axis=1)


def check_frames(capture: xr.Dataset) -> tuple[DeclaredRig, npt.NDArray[Any], npt.NDArray[Any]]:
    """(declared rig, counts, reference). Raises InputError for a rig that lacks a value, a capture without reference, frames of
    several channels, and images of another size than the rig's."""
    rig = read_rig(capture, "wavefront")
    declared_geometry(rig)
    if "reference" not in capture:
        raise InputError(
            "The capture has no reference: slopes have no zero.", where="reference", value=sorted(map(str, capture.data_vars)),
            allowed="reference (row, col), the spot field of a flat wavefront", next_step="record a flat wavefront",
        )  # fmt: skip
    counts, reference = np.asarray(capture["counts"].values), np.asarray(capture["reference"].values)
    if counts.ndim != 3:
        raise InputError(
            "Centroids read frames of one channel.", where="counts", value=capture["counts"].dims, allowed="frame, row, col",
            next_step="select a channel, or average over them",
        )  # fmt: skip
    size = (rig.whole("camera.rows"), rig.whole("camera.cols"))
    if counts.shape[1:] != size:
        raise InputError(
            "The frames have another size than the declared camera.",
            where="counts",
            value=counts.shape[1:],
            allowed=str(size),
        )
    return rig, counts, reference


def measured(
    capture: xr.Dataset,
    method: Method,
    *,
    least_sigmas: float = 5.0,
    search: Search = "cell",
    reader: Reader | None = None,
) -> xr.Dataset:
    """The result of the stage `centroid`: spots [px] (frame, lenslet, axis), axis 0 along columns.

    Other arguments:
        search: "field": spots are looked for in the whole frame, and a cell is laid about that of each lenslet.
        reader: `method` on whole images, without an array per cell; used where spots are looked for in their cells.

    Raises InputError as `check_frames`, for a reference without spots, and for one whose spots do not lie where the rig declares
    them.
    """
    in_range("least_sigmas", least_sigmas, 0)
    rig, counts, reference = check_frames(capture)
    usable = np.asarray(capture["valid"].values, bool)

    geometry = declared_geometry(rig)

    read = reader or partial(_by_cells, method)

    def found(images: npt.NDArray[Any], exposures: int) -> Found:
        return _within(read(images, rig, exposures, least_sigmas), geometry)

    origin = found(reference[None], rig.whole("reference.exposures"))
    flat = cells_of(reference[None], rig)
    lock = _locking(flat, method)
    lenslets = len(geometry.place_px)
    some = max(_AT_ONCE // lenslets, 1)
    if search == "cell":
        parts = [found(counts[k : k + some], 1) for k in range(0, len(counts), some)]
    else:
        parts = [sought(image, rig, method, least_sigmas) for image in counts]
    shape = (len(counts), lenslets)
    frames = Found(
        np.concatenate([one.position for one in parts]).reshape(*shape, 2),
        np.concatenate([one.variance for one in parts]).reshape(*shape, 2),
        np.concatenate([one.good for one in parts]).reshape(shape),
    )
    check_reference(origin.good, first_guess(flat)[:, :2], geometry)
    return relative(frames, origin, usable, geometry, lock)


def _by_cells(method: Method, images: npt.NDArray[Any], rig: DeclaredRig, exposures: int, least_sigmas: float) -> Found:
    cells = cells_of(images, rig, exposures=exposures, least_sigmas=least_sigmas)
    one = method(cells)
    return Found(one.position, one.variance, one.good & cells.sound)


def _within(found: Found, geometry: Geometry) -> Found:
    """What lies in its cell; a spot that is found outside is another's."""
    return Found(found.position, found.variance, found.good & geometry.within(found.position))


def sought(
    image: npt.NDArray[Any], rig: DeclaredRig, method: Method, least_sigmas: float, *, exposures: int = 1
) -> Found:
    """What a method finds in an image in cells about the spots that `field_search` gives the lenslets; arguments as of `cells_of`.

    Where spots stand closer than lenslets, cells are as wide as the spots are apart.
    """
    geometry, scale, spot = declared_geometry(rig), Scale.of(rig), declared_spot(rig)
    light = np.where(scale.good(image), scale.electrons(image), np.nan)
    spots = spots_in(light, geometry.pitch_px, spot.sigma_px, least_sigmas)
    owner = assigned_spots(geometry.place_px, spots, geometry.pitch_px)
    held = owner >= 0
    shift = np.zeros(geometry.place_px.shape)
    width = geometry.pitch_px
    if held.any():
        own = spots[owner[held]]
        shift[held] = np.rint(own - geometry.place_px[held])
        if len(own) > 1:
            apart: Any = cKDTree(own).query(own, 2)[0]
            width = min(width, float(np.median(apart[:, 1])))
    moved = replace(geometry, place_px=geometry.place_px + shift, pitch_px=width)
    cells = cells_of(image[None], rig, exposures=exposures, least_sigmas=least_sigmas, moved=moved)
    one = _within(method(cells), moved)
    return Found(one.position + shift, one.variance, one.good & cells.sound & held)


def _locking(cells: Cells, method: Method) -> Float:
    """rms error [px] (axis) of a method without noise, of spots of the declared shape anywhere within a pixel about their places.

    A difference of two readings has twice the square of it.
    """
    t = (np.arange(_PHASES) + 0.5) / _PHASES - 0.5
    at = np.stack(np.meshgrid(t, t), axis=-1).reshape(-1, 2)
    some = np.arange(len(at)) % len(cells.z)
    x, y, inside = cells.x[some], cells.y[some], cells.inside[some]
    z = _BRIGHT * cells.spot.share(y - at[:, 1:])[:, :, None] * cells.spot.share(x - at[:, :1])[:, None, :] * inside
    none = np.zeros(len(at))
    ideal = Cells(
        z, z + 1e-6, x, y, inside, none, none == 0, 1e-6, 1.0, cells.geometry, cells.spot, alone=True,
    )  # fmt: skip
    found = method(ideal)
    error = np.where(found.good[:, None], found.position - at, np.nan)
    if not found.good.any():
        return np.full(2, 0.5)
    error = error - np.nanmean(error, axis=0)
    return np.asarray(np.sqrt(np.nanmean(error**2, axis=0)))


def relative(frames: Found, origin: Found, usable: Bool, geometry: Geometry, lock: Float | float = 0.0) -> xr.Dataset:
    """Spots of the frames (frame, lenslet, …), relative to those of the reference, as the result of the stage `centroid`.

    `lock` (axis): rms error [px] of a reading over the places within a pixel. An error that varies as a sine over the pixel makes
    that of a difference of readings Δ apart 2 lock² (1 − cos 2πΔ); beyond a quarter of a pixel its mean, 2 lock², is stated.
    """
    moved = frames.position - origin.position
    position = moved + geometry.place_px
    with np.errstate(invalid="ignore"):
        periodic = 1.0 - np.cos(2.0 * np.pi * np.minimum(np.abs(moved), 0.25))
    variance = frames.variance + origin.variance + 2.0 * np.square(lock) * periodic
    valid = frames.good & origin.good & usable[:, None]
    with np.errstate(invalid="ignore"):
        return stage_result("centroid", spot=position, sigma=np.sqrt(variance), valid=valid)
