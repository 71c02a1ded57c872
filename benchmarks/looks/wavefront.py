"""The look of a wavefront capture: spots with slopes, and the true phase."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
import xarray as xr

from ...estimators.rig import DeclaredRig, read_rig
from ...scenes.errors import InputError
from .panel import GREY, TRUE, Array, Curve, Curves, Image, chosen, image, mean_channel, signed, unit_of

__all__ = ["slope_lines", "spots", "wavefront_look"]

#: Lenslets of the part of the spot field that is shown: with more, spots are smaller than pixels of a picture.
LENSLETS = 10


def wavefront_look(capture: xr.Dataset, element: int | None) -> list[Image | Curves]:
    """Spots of the frame with most light, or of the asked one, by the root of their light, with the true slopes; the phase."""
    counts = mean_channel(capture["counts"]).transpose("frame", "row", "col").values
    frame = chosen(element, counts, "frame")
    slope = capture["truth_slope"].values[frame] if "truth_slope" in capture.variables else None
    found: list[Image | Curves] = [spots(capture, frame, slope)]
    if "truth_phase" in capture.variables and np.isfinite(capture["truth_phase"].values[frame]).any():
        phase = capture["truth_phase"].values[frame].astype(np.float64)
        found.append(signed("true phase", phase - np.nanmean(phase), "rad"))
    return found


def spots(
    capture: xr.Dataset, frame: int, slope_rad: npt.ArrayLike | None, lenslets: int = LENSLETS, name: str = "true slope"
) -> Image:
    """The middle of a frame by the root of its light, with slopes (lenslet, axis), drawn longer; NaN ones are left out."""
    counts = mean_channel(capture["counts"]).values[frame]
    light = np.sqrt(np.maximum(counts - np.median(counts), 0.0))
    try:
        rig = read_rig(capture)
        pitch = rig.number("lenslets.pitch_m") / rig.number("camera.pixel_pitch_m")
    except InputError:
        return image(f"frame {frame}", light, f"root of {unit_of(capture['counts'])}", anchors=GREY)
    first = [max((size - round(lenslets * pitch)) // 2, 0) for size in counts.shape]
    last = [start + round(lenslets * pitch) for start in first]
    part = light[first[0] : last[0], first[1] : last[1]]
    lines: list[Curve] = []
    longer = 1.0
    if slope_rad is not None:
        lines, longer = slope_lines(rig, np.asarray(slope_rad, np.float64), pitch, name)
        lines = [_within(line, first, part.shape) for line in lines]
    told = f", slopes × {longer:g}" if lines else ""
    return image(f"frame {frame}{told}", part, f"root of {unit_of(capture['counts'])}", lines=lines, anchors=GREY)


def slope_lines(rig: DeclaredRig, slope_rad: Array, pitch_px: float, name: str) -> tuple[list[Curve], float]:
    """A stroke from each lenslet's centre along its slope, and how many times longer than the spot moved: a round
    number, so that nine of ten end within half of a lenslet."""
    col, row = (rig.numbers(f"lenslets.{axis}_px") for axis in ("col", "row"))
    moved = slope_rad * rig.number("lenslets.focal_length_m") / rig.number("camera.pixel_pitch_m")
    length = np.hypot(moved[:, 0], moved[:, 1])
    known = length[np.isfinite(length)]
    if not known.size or not float(np.quantile(known, 0.9)) > 0:
        return [], 1.0
    want = 0.5 * pitch_px / float(np.quantile(known, 0.9))
    power = 10.0 ** np.floor(np.log10(want))
    longer = float(max(step * power for step in (1.0, 1.5, 2.0, 3.0, 5.0, 7.0) if step * power <= want * (1 + 1e-9)))
    gap = np.full(len(col), np.nan)
    x = np.stack([col, col + longer * moved[:, 0], gap], axis=1).reshape(-1)
    y = np.stack([row, row + longer * moved[:, 1], gap], axis=1).reshape(-1)
    return [Curve(name, x, y, TRUE)], longer


def _within(line: Curve, first: list[int], shape: tuple[int, ...]) -> Curve:
    """The strokes that begin in the part that is shown, on its columns and rows."""
    x, y = (line.x - first[1]).reshape(-1, 3), (line.y - first[0]).reshape(-1, 3)
    inside = (x[:, 0] >= 0) & (x[:, 0] < shape[1]) & (y[:, 0] >= 0) & (y[:, 0] < shape[0])
    return Curve(line.name, x[inside].reshape(-1), y[inside].reshape(-1), line.colour)
