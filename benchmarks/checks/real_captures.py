"""Every estimator on every folder of real captures: errors against what is known of the truth, or the reason of the refusal.

    python -m beambench.benchmarks.checks.real_captures FOLDER [PART…]

FOLDER holds the folders of docs/real-captures.md; PART: frames, lecroy, spad, sensors, lines (all by default; the last two take
minutes). The captures are those of `beambench import`, by the shipped mappings. No figure here says more than the caution below
its table allows.
"""

from __future__ import annotations

import inspect
import sys
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path

import numpy as np
import xarray as xr

from ...captures.hide import hide_truth
from ...estimators.registry import get_estimator, list_estimators, run_estimator
from ...scenes.errors import InputError
from ..datasets.imported import imported_captures, mappings_of
from .laser_stereo15 import LINES, WALLS, on_plane, planes_of, read_image, wall_of
from .sh_mmtwfs import BOGUS, PAIRS, compared

__all__ = ["PARTS", "Row", "frames", "lecroy", "lines", "main", "sensors", "spad"]

#: capture, estimator, what came of it.
Row = tuple[str, str, str]

_CELL_ONLY = "not run: it looks in a spot's own cell only; they lie up to a pitch and a half away"
#: 150 mm of range are 1 ns of a round trip.
_PS_PER_M = 2.0 / 299792458.0 * 1e12
#: Range [m] of the trigger, or of the peak, that the mappings set.
_LECROY_M, _SPAD_M = 0.5 * 299792458.0 * 1e-7, 0.5 * 299792458.0 * 1e-8


def _captures(folder: Path, mapping: str) -> Iterator[tuple[str, xr.Dataset]]:
    for name, one in mappings_of(mapping).items():
        for number, capture in enumerate(imported_captures(one, [folder], name)):
            label = one.capture[number].name if one.capture else name.partition("-")[2] or name
            yield label, hide_truth(capture)


def _answer(label: str, capture: xr.Dataset, figure: Callable[[xr.Dataset], str]) -> str:
    """What came of an estimator: a figure, or why it refuses."""
    try:
        return figure(run_estimator(label, capture))
    except InputError as error:
        place = error.where.rpartition("rig: ")[2]
        return f"refused: {error.what.rstrip('.')}" + (f" ({place[:60]})" if place else "")


def _reads(modality: str) -> list[str]:
    return [name for name in list_estimators(modality) if get_estimator(name).reads_captures]


def frames(folder: Path) -> Iterator[Row]:
    """Frames of a gated camera without gate profiles: their statistics, and that each estimator refuses."""
    for mapping in mappings_of("gated_g2d").values():
        for number, capture in enumerate(imported_captures(mapping, [folder / "gated_g2d"])):
            name, counts, depth = mapping.capture[number].name, capture["counts"].values, capture["truth_depth"].values
            for k, frame in enumerate(counts):
                # Second differences along a row: of white noise, 6 times its variance.
                noise = 1.4826 * np.median(np.abs(np.diff(frame[:120].astype(float), n=2, axis=1))) / np.sqrt(6.0)
                text = (f"median {np.median(frame):.0f} DN, {100 * (frame == 1023).mean():.2f} % at the top, noise of the upper "
                        f"rows {noise:.1f} DN")  # fmt: skip
                yield f"{name}, slice {k}", "(statistics)", text
            seen = depth[np.isfinite(depth)]
            yield name, "(lidar)", f"{seen.size} pixels, {seen.min():.1f} to {seen.max():.1f} m"
            hidden = hide_truth(capture)
            for label in _reads(mapping.modality):
                yield name, label, _answer(label, hidden, _range_of)


def _range_of(found: xr.Dataset) -> str:
    valid = found["valid"].values
    return f"{valid.sum()} of {valid.size} valid"


def lecroy(folder: Path) -> Iterator[Row]:
    """Segments of an oscilloscope: how equal pulses scatter, in time, and how far from the trigger their mean lies."""
    for name, capture in _captures(folder / "wf_lecroy", "wf_lecroy"):
        for label in _reads(str(capture.attrs["modality"])):
            yield name, label, _answer(label, capture, lambda found: _times(found, _LECROY_M))


def spad(folder: Path) -> Iterator[Row]:
    """Measured responses: how far each answer lies from the peak, which the files put at 0."""
    for name, capture in _captures(folder / "wf_spad_irf", "wf_spad_irf"):
        for label in _reads(str(capture.attrs["modality"])):
            yield name, label, _answer(label, capture, lambda found: _times(found, _SPAD_M))


def _times(found: xr.Dataset, zero_m: float) -> str:
    valid = found["valid"].values
    if not valid.any():
        return f"0 of {valid.size} valid"
    time = (found["range"].values[valid] - zero_m) * _PS_PER_M
    sigma = float(np.median(found["sigma"].values[valid])) * _PS_PER_M
    spread = f", scatter {time.std(ddof=1):.0f} ps" if time.size > 1 else ""
    return f"{valid.sum()} of {valid.size} valid, mean {time.mean():+.0f} ps{spread}, stated {sigma:.1f} ps"


def sensors(folder: Path) -> Iterator[Row]:
    """Four sensors of a telescope: slopes and Zernike coefficients beside those of the authors' package."""
    place = folder / "sh_mmtwfs"
    modality = next(iter(mappings_of("sh_mmtwfs").values())).modality
    for sensor in PAIRS:
        for label in _reads(modality):
            if "search" not in inspect.signature(get_estimator(label).function).parameters:
                yield sensor, label, _CELL_ONLY
                continue
            try:
                one = compared(place, sensor, label)
                text = (f"{one.found} of {one.lenslets} spots, {one.both} in common: slopes differ by {one.slope_rms_px:.3f} px "
                        f"rms of {one.slopes_px:.2f}, Z04 to Z22 by {one.zernike_rms_nm:.0f} nm rms")  # fmt: skip
            except InputError as error:
                text = f"refused: {error.what}"
            yield sensor, label, text
    try:
        compared(place, "mmirs", "spot-gaussian", image=BOGUS)
        yield "bogus", "(import)", "NOT refused"
    except InputError as error:
        yield "bogus", "(import)", f"refused: {error.what} ({error.value} of {error.allowed})"


def lines(folder: Path) -> Iterator[Row]:
    """Fifteen lines on a wall: how far the wall, triangulated by the planes of the other images, lies from the board's plane."""
    place = folder / "laser_stereo15"
    images = [read_image(place / name) for name in WALLS]
    modality = next(iter(mappings_of("laser_stereo15").values())).modality
    for label in _reads(modality):
        if "returns" not in inspect.signature(get_estimator(label).function).parameters:
            yield "wall", label, "not run: it finds one line a row, and there are fifteen"
            continue
        try:
            walls = [wall_of(image, label) for image in images]
            away, flat = [], []
            for number, wall in enumerate(walls):
                rest = planes_of([other for k, other in enumerate(walls) if k != number])
                away += [wall.away(on_plane(*wall.lines[k], rest[k].normal, rest[k].place)) for k in range(LINES)]
                flat += [planes_of(walls)[k].away(wall.points(k)) for k in range(LINES)]
            rms = [1e3 * float(np.sqrt((np.concatenate(part) ** 2).mean())) for part in (away, flat)]
            points = sum(part.size for part in away)
            text = f"{points} points, {rms[0]:.2f} mm rms from the wall, {rms[1]:.3f} mm rms from planes through all images"
        except InputError as error:
            text = f"refused: {error.what}"
        yield "wall", label, text


#: Part -> (rows, what its figures do not say).
PARTS: dict[str, tuple[Callable[[Path], Iterator[Row]], str]] = {
    "frames": (frames, "the gate profiles are not part of the recording: no range can be had, and the lidar's depth judges none"),
    "lecroy": (lecroy, "the response is the mean record itself and the source is unknown: scatter is meaningful, the mean is not"),
    "spad": (spad, "the response is the mean of the records themselves; their zero, the peak, is by construction"),
    "sensors": (sensors, "the authors' package is a reference algorithm, whose releases differ by 80 nm in Z10"),
    "lines": (lines, "the board's plane is the truth, with errors of some tenths of a mm; the author's planes are 4 mm off"),
}  # fmt: skip


def main(argv: Sequence[str] | None = None) -> int:
    """Print the tables; 0 where every part could be read."""
    arguments = sys.argv[1:] if argv is None else list(argv)
    if not arguments or any(part not in PARTS for part in arguments[1:]):
        print(__doc__)
        return 2
    for part in arguments[1:] or PARTS:
        rows, caution = PARTS[part]
        print(f"\n## {part}\n\n| capture | estimator | result |\n|---|---|---|")
        for row in rows(Path(arguments[0])):
            print("| " + " | ".join(row) + " |", flush=True)
        print(f"\nCaution: {caution}.")
    return 0


if __name__ == "__main__":
    sys.exit(main())
