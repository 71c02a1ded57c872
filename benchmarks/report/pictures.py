"""Pictures of estimates: colour maps, a small palette PNG writer, and the picture files of a run."""

from __future__ import annotations

import base64
import math
import struct
import zlib
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...scenes.errors import InputError, reason
from ...scenes.npz import read_npz

__all__ = [
    "DIVERGING",
    "MAX_SIDE",
    "SEQUENTIAL",
    "Picture",
    "css_gradient",
    "data_uri",
    "error_limit",
    "png",
    "read_pictures",
    "value_limits",
]

#: Anchors of viridis (Smith and van der Walt 2015, CC0): perceptually uniform, also for the colour-blind and in grey.
SEQUENTIAL = (
    "#440154",
    "#482878",
    "#3e4989",
    "#31688e",
    "#26828e",
    "#1f9e89",
    "#35b779",
    "#6ece58",
    "#b5de2b",
    "#fde725",
)
#: Anchors of RdBu (Brewer 2002), blue = negative: safe for red-green colour blindness.
DIVERGING = (
    "#053061",
    "#2166ac",
    "#4393c3",
    "#92c5de",
    "#d1e5f0",
    "#f7f7f7",
    "#fddbc7",
    "#f4a582",
    "#d6604d",
    "#b2182b",
    "#67001f",
)
#: Colour of elements without an answer.
INVALID = "#3a3a3a"

_STEPS = 128  # colour steps: finer than visible, and noisy pictures compress to half the size of 254 steps
MAX_SIDE = 320  # longest side of a picture in the page, pixels
_MAX_ELEMENTS = 64 * 2**20
_WORDS = ("scene", "estimator", "condition", "quantity", "unit")


@dataclass(frozen=True)
class Picture:
    """Estimate of one capture by one estimator: arrays (row, col); `value`, `truth`, `error` of `quantity` in `unit`, NaN
    where there is none. `shown`: factor and unit in which errors are displayed."""

    scene: str
    estimator: str
    condition: str
    value: NDArray[np.float32]
    truth: NDArray[np.float32]
    error: NDArray[np.float32]
    valid: NDArray[np.bool_]
    quantity: str = "range"
    unit: str = "m"
    shown: tuple[float, str] = (1e3, "mm")


def read_pictures(folder: Path) -> list[Picture]:
    """Read every .npz of the `pictures` folder of a run, ordered by name.

    Raises:
        InputError: a file is not such a picture.
    """
    return [_read(path) for path in sorted(folder.glob("*.npz"))]


def _read(path: Path) -> Picture:
    scene, _, estimator = path.stem.partition("__")
    try:
        data = read_npz(path, "A picture file")
        first = "value" if "value" in data else "range"  # files of older runs hold ranges
        arrays = {name: data[name] for name in (first, "truth", "error", "valid")}
        words = {name: str(data[name]) for name in _WORDS if name in data}
        shown = tuple(map(str, data["shown"])) if "shown" in data else ("1e3", "mm")
        scale = float(shown[0]), shown[1]
    except (ValueError, KeyError, IndexError, TypeError) as error:
        raise InputError("A picture file cannot be read.", where=str(path), value=reason(error)) from error
    shape = arrays[first].shape
    if len(shape) != 2 or not 0 < arrays[first].size <= _MAX_ELEMENTS or any(a.shape != shape for a in arrays.values()):
        raise InputError(
            "A picture file contains arrays of the wrong shape.",
            where=str(path),
            value={k: a.shape for k, a in arrays.items()},
            allowed="value, truth, error and valid, all of one shape (row, col)",
        )
    return Picture(
        scene=words.get("scene", scene),
        estimator=words.get("estimator", estimator),
        condition=words.get("condition", ""),
        value=arrays[first].astype(np.float32),
        truth=arrays["truth"].astype(np.float32),
        error=arrays["error"].astype(np.float32),
        valid=arrays["valid"].astype(bool),
        quantity=words.get("quantity", "range"),
        unit=words.get("unit", "m"),
        shown=scale,
    )


def value_limits(truth: NDArray[Any], least: float) -> tuple[float, float]:
    """Limits of the scale of values: the extremes of the truth, widened to at least `least` so that a flat wall looks flat."""
    finite = truth[np.isfinite(truth)]
    if not finite.size:
        return 0.0, 1.0
    lo, hi = float(finite.min()), float(finite.max())
    middle, half = (lo + hi) / 2, max((hi - lo) / 2, 0.5 * least)
    return middle - half, middle + half


def error_limit(pictures: list[Picture]) -> float:
    """Half width of the shared error scale, in the quantity's unit: 3 × the lower quartile over estimators of their median
    |error|·1.4826.

    Rounded up to 1, 2 or 5 times a power of ten. With the quartile, bad estimators do not hide differences of good ones.
    """
    spreads = []
    for picture in pictures:
        finite = np.abs(picture.error[np.isfinite(picture.error)])
        if finite.size:
            spreads.append(float(np.median(finite)) * 1.4826)
    want = 3 * float(np.quantile(spreads, 0.25)) if spreads else 1e-3
    if not want > 0:
        want = 1e-6
    power = 10.0 ** math.floor(math.log10(want))
    return next(step * power for step in (1, 2, 5, 10) if step * power >= want * (1 - 1e-9))


def png(
    values: NDArray[Any],
    lo: float,
    hi: float,
    anchors: tuple[str, ...],
    *,
    answered: NDArray[np.bool_] | None = None,
    side: int = MAX_SIDE,
) -> bytes:
    """A palette PNG of a (row, col) array on the linear scale lo..hi.

    Values beyond the scale take its end colours. NaN is transparent, except where `answered` is given and False: there
    the colour `INVALID` marks a missing answer. Larger arrays are reduced to `side` by leaving out samples.
    """
    step = max(1, math.ceil(max(values.shape) / side))
    values = np.asarray(values, dtype=np.float64)[::step, ::step]
    finite = np.isfinite(values)
    scaled = (np.where(finite, values, lo) - lo) / (hi - lo)
    index = np.clip(np.rint(scaled * (_STEPS - 1)), 0, _STEPS - 1).astype(np.uint8)
    index[~finite] = _STEPS
    if answered is not None:
        index[~answered[::step, ::step]] = _STEPS + 1
    palette = np.vstack([lut(anchors, _STEPS), [[0, 0, 0]], [_rgb(INVALID)]]).astype(np.uint8)
    alpha = bytes([255] * _STEPS + [0, 255])
    rows, cols = index.shape
    # Each row starts with filter type 0 (none): filters do not help with palette indices.
    raw = np.hstack([np.zeros((rows, 1), np.uint8), index]).tobytes()
    return b"".join(
        [
            b"\x89PNG\r\n\x1a\n",
            _chunk(b"IHDR", struct.pack(">IIBBBBB", cols, rows, 8, 3, 0, 0, 0)),
            _chunk(b"PLTE", palette.tobytes()),
            _chunk(b"tRNS", alpha),
            _chunk(b"IDAT", zlib.compress(raw, 9)),
            _chunk(b"IEND", b""),
        ]
    )


def lut(anchors: tuple[str, ...], steps: int) -> NDArray[np.uint8]:
    """Colours (steps, 3) between evenly spaced anchors, linear in sRGB."""
    knots = np.array([_rgb(anchor) for anchor in anchors], dtype=float)
    at = np.linspace(0, len(knots) - 1, steps)
    return np.rint([np.interp(at, np.arange(len(knots)), knots[:, c]) for c in range(3)]).T.astype(np.uint8)


def css_gradient(anchors: tuple[str, ...]) -> str:
    """The same colour map as a CSS gradient, for the colour bar."""
    return f"linear-gradient(to right, {', '.join(anchors)})"


def data_uri(image: bytes) -> str:
    """A PNG as a data URI."""
    return "data:image/png;base64," + base64.b64encode(image).decode("ascii")


def _rgb(colour: str) -> tuple[int, int, int]:
    return int(colour[1:3], 16), int(colour[3:5], 16), int(colour[5:7], 16)


def _chunk(kind: bytes, data: bytes) -> bytes:
    return struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))
