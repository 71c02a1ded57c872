"""Estimators against the exact bound where it can be attained: efficiency, bias and stated errors, 20,000 echoes per cell.

    python -m beambench.benchmarks.checks.efficiency [FILE.csv]

A cell is a response, the photoelectrons N of an echo summed over the stack, the background of all slices as a share of N,
the delay step in units of σ_R, and the read noise. Echoes lie anywhere inside the window, with all of R. Captures are
written from closed forms (`written`); the bound is that of the scores (`judges.bound.bound_of`).

Columns: bound_kind ("exact": the cell is regular); threshold, the least N at which 99 % of the delays are regular;
coverage; efficiency = bound²/mean square error with its 95 % interval (4 % wide for this number of echoes); z_rms; bias:
mean error over rms error; wander: rms over delays (within a step, and across the window, 25 bins each) of the mean error,
with the contribution of noise subtracted, in bounds: it reveals a bias that makes an error smaller than the bound.
"""

from __future__ import annotations

import math
import sys
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from ...scenes.load import load_scene
from ...scenes.rigs.gated import gated_rig
from ...scenes.scene import Scene
from ..judges.bound import bound_of
from ..scores.truth import Bound
from ..written.gated import response_area_s, written_capture

__all__ = [
    "CELLS", "COLUMNS", "ECHOES", "LIKELIHOOD", "REGISTRY", "Cell",
    "around_threshold", "cell_levels", "cell_scene", "efficiency_rows", "measured",
    "threshold_photons",
]  # fmt: skip

Float = npt.NDArray[np.float64]

COLUMNS = (
    "response", "photons", "background", "step", "read_noise_e", "estimator", "bound_kind", "threshold", "n", "coverage",
    "efficiency", "efficiency_lo", "efficiency_hi", "z_rms", "bias", "wander",
)  # fmt: skip

#: Estimators whose sigma comes from the likelihood.
LIKELIHOOD = ("poisson-ml", "poisson-ml-backscatter", "poisson-ml-two-returns")
#: All estimators for any gated stack; `range-intensity-correlation` needs two slices, `learned` its training.
REGISTRY = (
    "radiometric-average", "chua-2017", "chua-2017-orthogonal", "constant-fraction", "gaussian-least-squares", "log-gaussian",
    "matched-filter", "parabola", "peak", *LIKELIHOOD, "threshold", "weighted-average",
    "weighted-average[background=outside]",
)  # fmt: skip

_PULSES: dict[str, tuple[dict[str, Any], dict[str, Any]]] = {
    "gaussian": ({"kind": "gaussian", "fwhm_s": 0.7e-9}, {"kind": "gaussian", "fwhm_s": 0.9e-9, "transmission": 1.0}),
    "exponential": (
        {"kind": "exponential", "fwhm_s": 0.5e-9, "tail_s": 0.4e-9},
        {"kind": "rectangular", "width_s": 0.8e-9, "transmission": 1.0},
    ),
    "rectangular": (
        {"kind": "rectangular", "width_s": 0.5e-9},
        {"kind": "rectangular", "width_s": 1.5e-9, "transmission": 1.0},
    ),
}


@dataclass(frozen=True)
class Cell:
    """Conditions of one line; `step` in σ_R, `background` over the stack as a share of the echo's `photons`."""

    response: str
    photons: float
    background: float
    step: float
    read_noise_e: float = 0.0


#: The claim for maximum likelihood: Gaussian and exponentially smoothed responses, 10³ photoelectrons and more.
CELLS = tuple(
    Cell(response, photons, background, step, read)
    for response in ("gaussian", "exponential")
    for photons in (1e3, 1e4, 1e5)
    for background, step, read in (
        (0.01, 0.25, 0.0), (0.01, 0.8, 0.0), (0.1, 0.4, 0.0), (1.0, 0.4, 0.0), (1.0, 0.25, 1.0),
    )
)  # fmt: skip

_SLICES = 64
#: Rows and columns of a cell's capture: 20,000 echoes.
ECHOES = (100, 200)


def cell_scene(cell: Cell, rows: int = 100, cols: int = 200) -> Scene:
    """The rig of a cell: 64 slices in air of index 1, an ADC of negligible step, no electronic noise but read noise."""
    pulse, gate = _PULSES[cell.response]
    changes: dict[str, Any] = {
        "rig.camera.rows": rows, "rig.camera.cols": cols, "rig.laser.pulse": pulse, "rig.gates": [gate],
        "rig.ambient_e_per_s": 0.0, "rig.detector.dark_current_e_per_s": 0.0,
        "rig.detector.read_noise_e": cell.read_noise_e, "rig.detector.adc_bits": 16, "rig.detector.offset_dn": 100.0,
        "medium.index": {"kind": "explicit", "phase": 1.0, "group": 1.0},
    }  # fmt: skip
    width = response_area_s(load_scene("flat-wall", changes))[1]
    step = cell.step * width
    brightest = cell.photons * (cell.step * 0.5 + cell.background / _SLICES)
    changes["rig.detector.gain_dn_per_e"] = min(8.0, 4e4 / brightest)
    changes["rig.detector.full_well_e"] = 1e7
    changes["rig.delays"] = {"start_s": 30e-9, "step_s": step, "count": _SLICES, "repeats": 1, "laser_off": 0}
    return load_scene("flat-wall", changes)


def cell_levels(cell: Cell, scene: Scene) -> tuple[float, float]:
    """Amplitude, and background per slice, both in photoelectrons."""
    area, width = response_area_s(scene)
    return cell.photons * cell.step * width / area, cell.background * cell.photons / _SLICES


def _ranges(scene: Scene, width_s: float, rng: np.random.Generator) -> Float:
    """Ranges whose echoes lie completely inside the window: five widths from its ends, two more for offset and tail of R."""
    from ...optics.constants import C_M_PER_S

    rig = gated_rig(scene)
    low = rig.delays.start_s + 7.0 * width_s
    high = rig.delays.start_s + rig.delays.step_s * (rig.delays.count - 1) - 5.0 * width_s
    return np.asarray(C_M_PER_S / 2.0 * rng.uniform(low, high, (rig.camera.rows, rig.camera.cols)))


def threshold_photons(cell: Cell) -> float:
    """The least N, at the cell's ratio of background per slice to N, at which 99 % of the inner delays are regular."""
    from ..judges.bound import threshold_table

    scene = cell_scene(cell, 1, 1)
    capture = written_capture(scene, 1.0, 1.0, 5.0)
    table = threshold_table(capture)
    width = table.scan.width_s
    low, high = table.scan.window_s
    delay = np.linspace(low + 6.0 * width, high - 6.0 * width, 400)
    for photons in np.geomspace(3.0, 1e5, 128):
        amplitude, background = cell_levels(Cell(cell.response, photons, cell.background, cell.step), scene)
        if table.regular(delay, amplitude, background).mean() >= 0.99:
            return float(photons)
    return math.inf


def around_threshold() -> list[Cell]:
    """Cells from half of the predicted threshold to twenty times it."""
    cells = []
    for response in ("gaussian", "exponential"):
        for background in (0.1, 1.0):
            start = threshold_photons(Cell(response, 1e3, background, 0.4))
            cells += [
                Cell(response, round(share * start), background, 0.4) for share in (0.5, 1.0, 2.0, 5.0, 10.0, 20.0)
            ]
    return cells


def measured(error: Float, sigma: Float, bound: Float, place: Sequence[Float]) -> dict[str, float]:
    """efficiency and its interval, z_rms, bias and wander of valid elements' errors (n), stated and least ones.

    Main arguments:
        place: numbers 0 … 1 (n) each, e.g. where in a step and where in the window the echo lies.
    """
    n = error.size
    square = (error / bound) ** 2
    mean, half = float(square.mean()), 1.96 * float(square.std(ddof=1)) / math.sqrt(n)
    wander = []
    for x in place:
        which = np.minimum((25 * x).astype(int), 24)
        number = np.maximum(np.bincount(which, minlength=25), 1)
        average = np.bincount(which, weights=error / bound, minlength=25) / number
        wander.append(math.sqrt(max(float((average**2 - mean / number).mean()), 0.0)))
    return {
        "efficiency": 1.0 / mean, "efficiency_lo": 1.0 / (mean + half), "efficiency_hi": 1.0 / max(mean - half, 1e-300),
        "z_rms": float(np.sqrt(((error / sigma) ** 2).mean())),
        "bias": float(error.mean()) / math.sqrt(float((error**2).mean())), "wander": max(wander),
    }  # fmt: skip


def efficiency_rows(
    cells: Iterable[Cell], estimators: Sequence[str], *, rows: int = ECHOES[0], cols: int = ECHOES[1], seed: int = 11
) -> Iterator[dict[str, Any]]:
    """Lines of the table: every estimator on the same captures."""
    from ...captures.hide import hide_truth
    from ...estimators import run_estimator

    for cell in cells:
        scene = cell_scene(cell, rows, cols)
        amplitude, background = cell_levels(cell, scene)
        ranges = _ranges(scene, response_area_s(scene)[1], np.random.Generator(np.random.PCG64(seed)))
        capture = written_capture(scene, amplitude, background, ranges, seed=seed + 1)
        bound: Bound = bound_of(capture)
        step_m = gated_rig(scene).delays.step_s * 0.149896229e9
        place = ((ranges / step_m) % 1.0, (ranges - ranges.min()) / np.ptp(ranges))
        threshold = threshold_photons(cell)
        hidden = hide_truth(capture)
        for label in estimators:
            result = run_estimator(label, hidden)
            valid = result["valid"].values
            row: dict[str, Any] = {
                "response": cell.response, "photons": cell.photons, "background": cell.background, "step": cell.step,
                "read_noise_e": cell.read_noise_e, "estimator": label, "bound_kind": bound.kind, "threshold": threshold,
                "n": ranges.size, "coverage": float(valid.mean()),
            }  # fmt: skip
            if valid.sum() > 100:
                error = (result["range"].values - ranges)[valid]
                row |= measured(
                    error, result["sigma"].values[valid], bound.sigma[valid], tuple(x[valid] for x in place)
                )
            yield {name: row.get(name, math.nan) for name in COLUMNS}


def main(arguments: Sequence[str]) -> int:
    """Print the table: maximum likelihood in all cells and around the threshold, the whole registry in four cells. With a
    file name, also write it."""
    from ..scores.tables import to_csv

    some = [cell for cell in CELLS if cell.photons in (1e3, 1e4) and cell.step == 0.4 and cell.background == 0.1]
    others = [name for name in REGISTRY if name not in LIKELIHOOD]
    made: list[dict[str, Any]] = []
    print("".join(f"{name[:13]:>14}" for name in COLUMNS))
    size = {"rows": ECHOES[0], "cols": ECHOES[1]}
    parts = (
        efficiency_rows(CELLS, LIKELIHOOD, **size), efficiency_rows(some, others, **size),
        efficiency_rows(around_threshold(), ["poisson-ml", "poisson-ml[min_snr=0]"], **size),
    )  # fmt: skip
    for rows in parts:
        for row in rows:
            made.append(row)
            print("".join(f"{v[-13:]:>14}" if isinstance(v, str) else f"{v:14.4g}" for v in row.values()), flush=True)
    if arguments:
        Path(arguments[0]).write_text(to_csv(made, COLUMNS), encoding="utf-8")
    return 0


if __name__ == "__main__":
    raise SystemExit(main(sys.argv[1:]))
