"""Triangulations by themselves: true columns with stated Gaussian noise in, errors of points out.

    python -m beambench.benchmarks.checks.triangulation_alone

No finder takes part, so that the errors are those of the model of refraction and of the declared rig. Expected of an exact model:
rms(ΔX) = σ_c rms(∂X/∂c) per coordinate, and nothing without noise.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from ...captures.hide import hide_truth
from ...estimators.registry import get_estimator
from ...estimators.result import stage_result
from ...estimators.rig import read_rig
from ...generator.generate import generate
from ...scenes.load import load_scene
from ...scenes.scene import Scene

__all__ = ["SIGMAS_PX", "TRIANGULATIONS", "point_errors"]

TRIANGULATIONS = ("triangulate-refractive", "triangulate-pinhole-port", "triangulate-air")
SIGMAS_PX = (0.0, 0.01, 0.1, 0.5)
_SCENES = ("spotscan-wall", "spotscan-deep")
#: σ [px] stated where the columns are exact.
_EXACT_PX = 1e-9
#: Draws of the noise of every column.
_DRAWS = 8


def point_errors(name: str, scene: Scene, sigma_px: float, *, seed: int = 1) -> dict[str, float]:
    """{rms_m: error per coordinate; z_rms: depth error over the stated one; valid: share} of a triangulation.

    Main arguments:
        name: of an estimator that reads lines. scene: source of the true columns. sigma_px: their noise [px], as stated.
    """
    capture = generate(scene, seed=seed, fidelity="direct")
    rig = read_rig(hide_truth(capture))
    column = np.asarray(capture["truth_column"].values, np.float64)
    seen = np.isfinite(column)
    spread = np.full(column.shape, max(sigma_px, _EXACT_PX))
    rng = np.random.default_rng(seed)
    function: Any = get_estimator(name).function
    errors, over, kept = [], [], 0
    for _ in range(_DRAWS):
        drawn = np.where(seen, column + sigma_px * rng.standard_normal(column.shape), 0.0)
        found = function(stage_result("line", column=drawn, sigma=spread, valid=seen), rig)
        valid = found["valid"].values
        error = (found["point"] - capture["truth_point"]).values.astype(float)[valid]
        errors.append(error)
        over.append(error[:, 2] / found["sigma"].values[valid][:, 2])
        kept += int(valid.sum())
    # The three coordinates err together: the depth, which errs most, stands for all.
    return {
        "rms_m": float(np.sqrt((np.concatenate(errors) ** 2).mean())),
        "z_rms": float(np.sqrt((np.concatenate(over) ** 2).mean())), "valid": kept / (_DRAWS * int(seen.sum())),
    }  # fmt: skip


def main() -> None:
    """Print a table per scene: mm rms per coordinate, and z, over the noise of the columns."""
    for scene in _SCENES:
        print(f"{scene}: mm rms per coordinate (z rms)")
        print(" " * 26 + "".join(f"{f'{sigma:g} px':>20s}" for sigma in SIGMAS_PX))
        for name in TRIANGULATIONS:
            got = [point_errors(name, load_scene(scene), sigma) for sigma in SIGMAS_PX]
            print(f"{name:26s}" + "".join(f"{1e3 * one['rms_m']:11.3g} ({one['z_rms']:.3g})" for one in got))


if __name__ == "__main__":
    main()
