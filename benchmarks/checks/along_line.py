"""How far along a line a finder smooths: its answer to a step of the line between two rows.

A finder that joins rows errs less than the bound of one row, by resolution that it gives away. The step response says how much:
the rows over which the mean answer to a step rises from 10 to 90 % of it. A finder that reads each row alone takes .8 rows:
straight from 0 to 1 within one row.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from ...captures.hide import hide_truth
from ...estimators import run_estimator
from ...scenes.load import load_scene
from ..written.laser_line import written_capture

__all__ = ["rise_rows", "step_answer"]

Float = npt.NDArray[np.float64]

_ROWS, _COLS = 96, 64
_ELECTRONS, _BACKGROUND = 4e4, 20.0


def step_answer(label: str, *, step_px: float = 0.5, width_px: float = 0.75, phases: int = 24) -> Float:
    """Mean answer (row) of a finder to a step after the middle row, as a share of the step; NaN in rows that it refuses.

    Main arguments:
        label: of a finder of the stage `line`.
    Other arguments:
        step_px: height of the step. width_px: 1 σ of the line. phases: places of the line within a pixel, one frame each.

    Frames hold no noise. What the finder errs without a step, row by row far from it, is no part of the answer: shares are those
    of its own levels above and below.
    """
    scene = load_scene(
        "spotscan-wall",
        {
            "rig.camera.rows": _ROWS, "rig.camera.cols": _COLS, "rig.lens_sigma_px": float(np.sqrt(width_px**2 - 0.14**2)),
            "rig.detector.adc_bits": 12, "rig.detector.gain_dn_per_e": 0.05, "rig.detector.offset_dn": 100.0,
            "rig.detector.read_noise_e": 10.0, "rig.frames.lit": phases,
        },
    )  # fmt: skip
    begin = _COLS / 2 + (np.arange(phases) + 0.5) / phases
    column = begin[:, None] + step_px * (np.arange(_ROWS) >= _ROWS // 2)
    capture = written_capture(scene, _ELECTRONS, width_px, _BACKGROUND, column, averaged=True)
    found = run_estimator(label, hide_truth(capture))
    column = np.where(found["valid"].values[:, :, 0], found["column"].values[:, :, 0], np.nan)
    mean = column.mean(axis=0)
    low, high = (np.nanmedian(part) for part in (mean[: _ROWS // 4], mean[-_ROWS // 4 :]))
    return np.asarray((mean - low) / (high - low))


def rise_rows(label: str) -> float:
    """Rows from 10 to 90 % of a step's answer, between rows by straight lines. NaN where the answer lacks one of the two."""
    answer = step_answer(label)
    row = np.flatnonzero(np.isfinite(answer))
    ends = []
    for share in (0.1, 0.9):
        past = np.flatnonzero(answer[row] >= share)
        if not past.size or past[0] == 0:
            return float("nan")
        k = past[0]
        a, b = answer[row[k - 1]], answer[row[k]]
        ends.append(row[k - 1] + (share - a) / (b - a) * (row[k] - row[k - 1]))
    return float(ends[1] - ends[0])
