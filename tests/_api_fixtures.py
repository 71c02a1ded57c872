"""A synthetic output folder of `beambench run`, with which its readers are tested without generator and estimators."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from beambench.benchmarks.scores.tables import COLUMNS

#: Estimators with (error factor over the bound, coverage, CPU seconds per element).
ESTIMATORS = {
    "peak": (6.0, 1.0, 4e-9),
    "weighted-average": (1.6, 1.0, 9e-9),
    "parabola": (1.5, 0.97, 30e-9),
    "chua-2017": (4.0, 1.0, 14e-9),
    "chua-2017-orthogonal": (3.8, 1.0, 14.5e-9),
    "poisson-ml": (1.02, 0.999, 900e-9),
}
SCENES = ("flat-wall", "step", "tank-relief")


def score_row(**changes: Any) -> dict[str, Any]:
    """One row of scores.csv with all of its columns."""
    row: dict[str, Any] = dict.fromkeys(COLUMNS, "")
    row |= {
        "suite": "made-up",
        "scene": "flat-wall",
        "stress": "none",
        "seed": 0,
        "condition": "matched",
        "stage": "range",
        "estimator": "peak",
        "modality": "gated",
        "quantity": "range",
        "unit": "m",
        "n": 65000,
        "coverage": 1.0,
        "failure_rate": 0.0,
        "failure_at": 0.05,
        "bias": 1e-5,
        "rmse": 1e-3,
        "rmse_full": 1e-3,
        "mae": 8e-4,
        "p95": 2e-3,
        "bound": 6e-4,
        "bound_kind": "exact",
        "efficiency": 0.36,
        "efficiency_lo": 0.34,
        "efficiency_hi": 0.38,
        "z_rms": 1.01,
        "cover95": 0.949,
        "cpu_s": 1e-3,
        "wall_s": 1.1e-3,
        "throughput": 65536 / 1.1e-3,
        "peak_bytes": 2**26,
        "status": "ok",
    }
    unknown = set(changes) - set(row)
    assert not unknown, unknown
    return row | changes


def score_rows() -> list[dict[str, Any]]:
    """Three scenes, two conditions, two seeds, six estimators; one of them crashes on one scene."""
    rows = []
    for s, scene in enumerate(SCENES):
        bound = 6e-4 * (1 + s)
        for condition, worse in (("matched", 1.0), ("calibrated", 1.12)):
            for seed in (0, 1):
                for name, (factor, coverage, per_element) in ESTIMATORS.items():
                    crashed = name == "parabola" and scene == "step"
                    error = factor * bound * worse * (1 + 0.01 * seed)
                    wall = per_element * 65536 * 1.05
                    changes: dict[str, Any] = {
                        "scene": scene,
                        "condition": condition,
                        "seed": seed,
                        "estimator": name,
                        "bound": bound,
                        "rmse": error,
                        "rmse_full": error + (1 - coverage) * 0.02,
                        "coverage": coverage,
                        "wall_s": wall,
                        "cpu_s": per_element * 65536,
                        "throughput": 65536 / wall,
                        "efficiency": 1 / factor**2,
                        "failure_rate": 0.22 if name == "chua-2017" and scene == "tank-relief" else 1 - coverage,
                    }
                    if crashed:
                        changes |= dict.fromkeys(
                            ("coverage", "failure_rate", "bias", "rmse", "rmse_full", "mae", "p95", "bound"), np.nan
                        )
                        changes |= dict.fromkeys(
                            ("efficiency", "z_rms", "cover95", "cpu_s", "wall_s", "throughput"), np.nan
                        )
                        changes |= {"status": "crash"}
                    rows.append(score_row(**changes))
    return rows


def stress_rows() -> list[dict[str, Any]]:
    """Failures against the level of one stress."""
    return [
        score_row(stress="background", level=level, estimator=name, failure_rate=min(1.0, level * slope))
        for level in (0.1, 0.2, 0.5, 1.0)
        for name, slope in (("peak", 0.2), ("weighted-average", 0.9), ("poisson-ml", 0.05))
    ]


def make_run(folder: Path, *, stress: bool = False, pictures: bool = True, side: int = 96) -> Path:
    """Write scores.csv, run.json and pictures into `folder` and return it."""
    folder.mkdir(parents=True, exist_ok=True)
    pd.DataFrame(score_rows() + (stress_rows() if stress else [])).to_csv(folder / "scores.csv", index=False)
    record = {
        "suite": "made-up",
        "version": "0.1.0",
        "command": ["/somewhere/bin/beambench", "run", "made-up", "--set", "seeds=[0, 1]"],
        "started": "2026-01-02T03:04:05+00:00",
        "wall_s": 12.5,
        "seeds": [0, 1],
        "overrides": {},
        "machine": {"cpu": "A processor", "cores": 2, "memory_gib": 8},
        "versions": {"numpy": "2.1.0", "beambench": "0.1.0"},
        "failures": [
            {
                "estimator": "parabola",
                "scene": "step",
                "status": "crash",
                "message": "IndexError: <b>index</b> 64 is out of bounds",
            }
        ],
    }
    (folder / "run.json").write_text(json.dumps(record), encoding="utf-8")
    if pictures:
        (folder / "pictures").mkdir(exist_ok=True)
        rng = np.random.default_rng(7)
        y, x = np.mgrid[-1 : 1 : side * 1j, -1 : 1 : side * 1j]
        for scene in SCENES:
            truth = {"flat-wall": np.sqrt(25 + x**2 + y**2), "step": 5 - 0.2 * (x > 0)}.get(scene)
            if truth is None:
                truth = 5 - 0.3 * np.exp(-3 * (x**2 + y**2)) + 0.04 * np.sin(9 * x) * np.cos(7 * y)
                truth[x**2 + y**2 > 1.3] = np.nan
            for name, (factor, coverage, _) in ESTIMATORS.items():
                error = rng.normal(0, 1e-3 * factor, truth.shape) + (2e-3 * x if "chua" in name else 0)
                valid = (rng.random(truth.shape) < coverage) & np.isfinite(truth)
                error = np.where(valid, error, np.nan).astype(np.float32)
                np.savez_compressed(
                    folder / "pictures" / f"{scene}__{name}.npz",
                    range=(truth + error).astype(np.float32),
                    truth=truth.astype(np.float32),
                    error=error,
                    valid=valid,
                    scene=scene,
                    estimator=name,
                    condition="matched",
                )
    return folder
