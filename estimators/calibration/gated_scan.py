"""A scan of delays as a calibration reads it: repeats of each delay, apart, and the frames without laser light."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import numpy.typing as npt
import xarray as xr

from ...scenes.errors import InputError
from ..rig import DeclaredRig, read_rig

__all__ = ["DelayScan", "read_scan", "scan_half"]

Float = npt.NDArray[np.float64]

#: Fewest repeats of a delay, and fewest frames without laser light, in each half of a recording.
LEAST_REPEATS = 3
LEAST_DARK = 2


@dataclass(frozen=True, eq=False)
class DelayScan:
    """Counts of one gate, DN.

    Main arguments:
        counts: (delay, repeat, pixel). dark: (frame, pixel), laser off. delay_s: (delay), as the capture states them, rising.
        shape: (rows, cols). rig: as declared.
    """

    counts: npt.NDArray[Any]
    dark: npt.NDArray[Any]
    delay_s: Float
    shape: tuple[int, int]
    rig: DeclaredRig

    @property
    def repeats(self) -> int:
        """Repeats of every delay."""
        return int(self.counts.shape[1])


def read_scan(capture: xr.Dataset) -> DelayScan:
    """The scan of a gated capture: delays sorted, their sound slices in the order of time, as many for every delay.

    Raises:
        InputError: several gates, averaged counts, samples marked as unsound, fewer than 3 repeats of a delay, or fewer than 2
            sound slices with the laser off.
    """
    rig = read_rig(capture, "gated")
    counts = np.asarray(capture["counts"].values)
    if counts.ndim != 3 or float(capture.attrs.get("averaged", 1) or 1) != 1:
        raise InputError(
            "The noise of averaged or coloured counts is not that of a frame.", where="counts", value=counts.shape,
            allowed="frames one by one, (slice, row, col)", next_step="record every repeat as a slice of its own",
        )  # fmt: skip
    if "valid_sample" in capture and not bool(capture["valid_sample"].values.all()):
        raise InputError(
            "Some samples are marked as unsound.", where="valid_sample", allowed="True throughout",
            next_step="cut the capture to the pixels that are sound",
        )  # fmt: skip
    sound, lit = (np.asarray(capture[name].values, bool) for name in ("valid", "laser_on"))
    gates = np.unique(np.asarray(capture["gate"].values)[sound & lit])
    if gates.size != 1:
        raise InputError(
            "A scan is calibrated for one gate at a time.", where="gate", value=gates.tolist(), allowed="one gate",
            next_step="select the slices of one gate: capture.isel(slice=capture.gate == 0)",
        )  # fmt: skip
    order = np.argsort(np.asarray(capture["time"].values, np.float64), kind="stable")
    delay = np.asarray(capture["delay"].values, np.float64)
    shown = [k for k in order if sound[k] and lit[k]]
    values = np.unique(delay[shown])
    groups = [[k for k in shown if delay[k] == value] for value in values]
    fewest = min(map(len, groups))
    off = [k for k in order if sound[k] and not lit[k]]
    if fewest < LEAST_REPEATS or len(off) < LEAST_DARK:
        raise InputError(
            "So few frames do not give the noise of the rig.", where="slice",
            value=f"{fewest} repeats of a delay, {len(off)} frames with the laser off",
            allowed=f"{LEAST_REPEATS} repeats of every delay and {LEAST_DARK} frames with the laser off, or more",
            next_step="record more repeats and laser-off frames",
        )  # fmt: skip
    flat = counts.reshape(len(counts), -1)
    stack = flat[np.array([group[:fewest] for group in groups])]
    return DelayScan(stack, flat[off], values, (counts.shape[1], counts.shape[2]), rig)


def scan_half(scan: DelayScan, number: int) -> DelayScan:
    """Half `number` (0 or 1) of a scan: every other repeat and laser-off frame, so that both halves span the same time.

    Raises:
        InputError: too few repeats or laser-off frames for two halves.
    """
    if scan.repeats < 2 * LEAST_REPEATS or len(scan.dark) < 2 * LEAST_DARK:
        raise InputError(
            "The recording is too short to be split into two halves.", where="slice",
            value=f"{scan.repeats} repeats of every delay, {len(scan.dark)} frames with the laser off",
            allowed=f"{2 * LEAST_REPEATS} repeats and {2 * LEAST_DARK} laser-off frames, or more",
            next_step="record more repeats: one half calibrates, the other is judged",
        )  # fmt: skip
    even = scan.repeats // 2 * 2
    dark = len(scan.dark) // 2 * 2
    return replace(scan, counts=scan.counts[:, number:even:2], dark=scan.dark[number:dark:2])
