"""The clauses of a lenslet camera: noise, the spots' width, place and light, and how far they move from frame to frame."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np
import numpy.typing as npt
import xarray as xr

from ...scenes.errors import InputError
from .clause import Curve, TwinKind
from .rendered import Cells, Frame, Kit, every_other, measure_rendered, noise_bounds, pixel_noise
from .wavefront_clauses import CLAUSES

__all__ = ["TWIN"]

Float = npt.NDArray[np.float64]

#: Half of a spot's window; least distance of a pixel between spots from a lenslet, and its greatest from three of them. In pitches.
_WINDOW, _BETWEEN, _AMONG = 0.4, 0.6, 0.85
#: Fewest lenslets and dark pixels.
_LENSLETS, _PIXELS = 4, 64


def _half(capture: xr.Dataset, number: int) -> xr.Dataset:
    """Every other frame; both halves share the reference."""
    return every_other(capture, "frame", number, least=4)


@dataclass(frozen=True, eq=False)
class _Spots:
    """Windows about the lenslets: frames (frame, lenslet, y, x) and the reference (lenslet, y, x), the dark level taken off;
    `place` (lenslet, 2): x, y from each window's middle to the declared spot, px; `lenslet` (lenslet, 2): declared x, y about their
    mean, px; `dark` (frame, pixel): between the spots, DN."""

    frames: Float
    reference: Float
    place: Float
    lenslet: Float
    dark: Float


def _spots(half: xr.Dataset) -> _Spots:
    rig = json.loads(str(half.attrs["rig"]))
    x, y = (np.asarray(rig["lenslets"][name], np.float64) for name in ("col_px", "row_px"))
    pitch = float(rig["lenslets"]["pitch_m"]) / float(rig["camera"]["pixel_pitch_m"])
    counts = np.asarray(half["counts"].values[np.asarray(half["valid"].values, bool)], np.float64)
    reference = np.asarray(half["reference"].values, np.float64)
    reach = max(int(_WINDOW * pitch), 1)
    rows, cols = reference.shape
    at = np.rint(np.stack([x, y], axis=1)).astype(int)
    inside = ((at >= reach) & (at < np.array([cols, rows]) - reach)).all(axis=1)
    if inside.sum() < _LENSLETS or len(counts) < 2:
        raise InputError(
            "The recording shows too few spots.", where="counts",
            value=f"{int(inside.sum())} lenslets, {len(counts)} sound frames in a half",
            allowed=f"{_LENSLETS} lenslets and 2 frames, or more", next_step="record more frames of the whole pupil",
        )  # fmt: skip
    between = _between(reference.shape, x, y, pitch)
    dark = counts[:, between]
    if dark.shape[1] < _PIXELS:
        raise InputError(
            "The spots lie so close that the level between them is not seen.", where="rig.lenslets.pitch_m",
            value=f"{dark.shape[1]} pixels between spots", allowed=f"{_PIXELS} or more",
        )  # fmt: skip
    step = np.arange(-reach, reach + 1)
    yy, xx = (at[inside, axis][:, None] + step for axis in (1, 0))
    window = (yy[:, :, None], xx[:, None, :])
    declared = np.stack([x, y], axis=1)[inside]
    return _Spots(
        counts[:, *window] - dark.mean(), reference[window] - reference[between].mean(), declared - at[inside],
        declared - declared.mean(axis=0), dark,
    )  # fmt: skip


def _between(shape: tuple[int, ...], x: Float, y: Float, pitch: float) -> npt.NDArray[np.bool_]:
    """Pixels (row, col) at the corners of cells: far from every spot, and among lenslets that are used."""
    from scipy.spatial import cKDTree

    row, col = np.indices(shape, dtype=np.float64)
    found_at = cKDTree(np.stack([x, y], axis=1)).query(np.stack([col.ravel(), row.ravel()], axis=1), k=3)
    distance = np.asarray(found_at[0], np.float64)
    found = (distance[:, 0] > _BETWEEN * pitch) & (distance[:, 2] < _AMONG * pitch)
    return np.asarray(found.reshape(shape))


def _moments(spots: Float) -> tuple[Float, Float, Float]:
    """(light, centroid (…, 2) from the window's middle [px], mean square radius per axis [px²]) of spots (…, y, x)."""
    reach = spots.shape[-1] // 2
    step = np.arange(-reach, reach + 1, dtype=np.float64)
    light = spots.sum(axis=(-2, -1))
    with np.errstate(divide="ignore", invalid="ignore"):
        x = (spots.sum(axis=-2) * step).sum(axis=-1) / light
        y = (spots.sum(axis=-1) * step).sum(axis=-1) / light
        square = ((spots.sum(axis=-2) + spots.sum(axis=-1)) * step**2).sum(axis=-1) / light - x**2 - y**2
    return light, np.stack([x, y], axis=-1), 0.5 * square


def _light(half: xr.Dataset, frame: Frame) -> float:
    return float(_spots(half).frames.mean(axis=0).sum())


def _statistics(half: xr.Dataset, frame: Frame) -> tuple[dict[str, float], Cells]:
    spots = _spots(half)
    offset, rms = pixel_noise(spots.dark)
    light, place, square = _moments(spots.reference)
    moved = place - spots.place
    turn = float((moved * spots.lenslet).sum() / (spots.lenslet**2).sum())
    flux, where, wide = _moments(spots.frames)
    with np.errstate(invalid="ignore"):
        seen = (flux > 0.2 * np.median(flux)).all(axis=0)
    energy = flux[:, seen].sum(axis=1)
    found = {
        "offset": offset, "read-noise": rms,
        "width": math.sqrt(max(float((light * square).sum() / light.sum()), 0.0)),
        "width-frames": math.sqrt(max(float((flux * wide)[:, seen].sum() / flux[:, seen].sum()), 0.0)),
        "place-x": float(moved[:, 0].mean()), "place-y": float(moved[:, 1].mean()), "scale": turn,
        "evenness": float(light.std(ddof=1) / light.mean()), "fluctuation": float(energy.std(ddof=1) / energy.mean()),
        "motion": float(np.sqrt(where[:, seen].var(axis=0, ddof=1).mean())),
    }  # fmt: skip
    return found, Cells(spots.reference.reshape(len(spots.reference), -1), 1)


def _bounds(half: xr.Dataset, frame: Frame) -> dict[str, float]:
    offset, noise = noise_bounds(_spots(half).dark)
    return {"offset": offset, "read-noise": noise}


def _curve(real: Float, twin: Float, sigma: Float) -> Mapping[str, Curve]:
    side = math.isqrt(real.shape[1])
    own, other, error = (values.reshape(-1, side, side).mean(axis=0) for values in (real, twin, sigma**2))
    middle: list[Any] = (np.arange(side) - side // 2).tolist()
    return {
        "width": Curve(
            "Mean spot of the reference, along a row through its middle", "pixels from the middle", "mean above dark [DN]", middle,
            own[side // 2].tolist(), np.sqrt(error[side // 2] / len(real)).tolist(), other[side // 2].tolist(),
        )
    }  # fmt: skip


KIT = Kit(
    main="counts",
    level="rig.laser.pulse_energy_j",
    half=_half,
    light=_light,
    statistics=_statistics,
    bounds=_bounds,
    why_not={"residual": "residuals need four draws or more"},
    curve=_curve,
)

TWIN = TwinKind(CLAUSES, partial(measure_rendered, kit=KIT))
