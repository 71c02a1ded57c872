"""Maximum likelihood against the Ziv-Zakai bound where the Cramér-Rao bound fails: rectangular pulse and gate.

    python -m beambench.benchmarks.checks.rectangular [FILE.csv]

R is a trapezoid: the information jumps at its corners and is zero on its top, and where the pulse is shorter than the
delay step no slice distinguishes some delays. The 20,000 echoes of a cell lie anywhere within two steps in the middle of
the window, which is also the prior of the bound; the bound knows amplitude and background, the estimator does not.

Columns: photoelectrons of the echo over the stack, background of all slices over that, step in units of σ_R, pulse length
over the step; the bound in units of σ_R; rms errors over the bound of the posterior mean (known amplitude, a fifth of the
echoes), of the maximum of the likelihood on a fine grid (likewise), and of poisson-ml; coverage and z_rms of poisson-ml;
and the rms Cramér-Rao bound over the bound, infinite where a delay carries no information.
"""

from __future__ import annotations

import math
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from ...optics.constants import C_M_PER_S
from ...scenes.rigs.gated import gated_rig
from ..bounds.ziv_zakai import local_bound
from ..judges.bound import scan_of
from ..written.gated import response_area_s, written_capture
from .efficiency import Cell, cell_levels, cell_scene

__all__ = ["COLUMNS", "rectangular_row"]

COLUMNS = (
    "photons", "background", "step", "pulse_over_step", "ziv_zakai", "mean_over", "grid_over", "ml_over", "coverage",
    "z_rms", "crb_over",
)  # fmt: skip
_PULSE_S = 0.5e-9
_PER_WIDTH = 300.0


def rectangular_row(
    photons: float, background: float, step: float, *, rows: int = 100, cols: int = 200, seed: int = 3
) -> dict[str, float]:
    """One line of the table; see above."""
    from ...captures.hide import hide_truth
    from ...estimators import run_estimator

    cell = Cell("rectangular", photons, background, step)
    scene = cell_scene(cell, rows, cols)
    amplitude, level = cell_levels(cell, scene)
    rig = gated_rig(scene)
    spacing, width = rig.delays.step_s, response_area_s(scene)[1]
    middle = rig.delays.start_s + spacing * (rig.delays.count // 2)
    rng = np.random.Generator(np.random.PCG64(seed))
    tau = middle + spacing * rng.uniform(0.0, 2.0, (rows, cols))
    capture = written_capture(scene, amplitude, level, 0.5 * C_M_PER_S * tau, seed=seed + 1)
    # Pairs of delays extend beyond the echoes on both sides, so that the ends of the window give no information.
    reach = 4.0 * max(spacing, width)
    count = math.ceil((2.0 * spacing + 2.0 * reach) / width * _PER_WIDTH) + 1
    theta = np.linspace(middle - reach, middle + 2.0 * spacing + reach, count)
    scan = scan_of(capture)
    r, slope, _ = scan.shapes(theta)
    seen = np.ptp(r, axis=0) > 0  # the others carry no information
    mu = (amplitude * r + level)[:, seen]
    root = np.sqrt((scan.information(mu) * (amplitude * slope[:, seen]) ** 2).sum(axis=1))
    found = local_bound(mu, root, float(theta[1] - theta[0]), width)
    inner = (theta >= middle) & (theta < middle + 2.0 * spacing)
    bound = math.sqrt(float((found.epsilon[inner] ** 2).mean()))

    dn = capture["counts"].values[seen].reshape(int(seen.sum()), -1).T[: rows * cols // 5]
    counts = np.rint((dn - rig.detector.offset_dn) / rig.detector.gain_dn_per_e)
    logs = counts @ np.log(mu).T - mu.sum(axis=1)
    weight = np.exp(logs - logs.max(axis=1, keepdims=True))
    truth = tau.ravel()[: dn.shape[0]]
    mean = (weight @ theta) / weight.sum(axis=1) - truth
    grid = theta[logs.argmax(axis=1)] - truth

    result = run_estimator("poisson-ml", hide_truth(capture))
    valid = result["valid"].values
    error = (2.0 / C_M_PER_S * result["range"].values - tau)[valid]
    sigma = 2.0 / C_M_PER_S * result["sigma"].values[valid]
    with np.errstate(divide="ignore"):
        crb = float(np.sqrt((found.crb[inner] ** 2).mean()))
    return {
        "photons": photons, "background": background, "step": step, "pulse_over_step": _PULSE_S / spacing,
        "ziv_zakai": bound / width, "mean_over": float(np.sqrt((mean**2).mean())) / bound,
        "grid_over": float(np.sqrt((grid**2).mean())) / bound, "ml_over": float(np.sqrt((error**2).mean())) / bound,
        "coverage": float(valid.mean()), "z_rms": float(np.sqrt(((error / sigma) ** 2).mean())), "crb_over": crb / bound,
    }  # fmt: skip


def main(arguments: Sequence[str]) -> int:
    """Print the table for 10³ … 10⁵ photoelectrons, two backgrounds and four steps. With a file name, also write it."""
    from ..scores.tables import to_csv

    rows: list[dict[str, Any]] = []
    print("".join(f"{name:>16}" for name in COLUMNS))
    for photons in (1e3, 1e4, 1e5):
        for background in (0.1, 1.0):
            for step in (0.25, 0.4, 0.8, 1.5):
                rows.append(rectangular_row(photons, background, step))
                print("".join(f"{value:16.4g}" for value in rows[-1].values()), flush=True)
    if arguments:
        Path(arguments[0]).write_text(to_csv(rows, COLUMNS), encoding="utf-8")
    return 0


if __name__ == "__main__":
    raise SystemExit(main(sys.argv[1:]))
