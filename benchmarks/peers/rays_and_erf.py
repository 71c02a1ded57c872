"""Cost of the `direct` rung against its two unavoidable parts: ray hits, and one pair of error functions per pixel and gate.

    python -m beambench.benchmarks.peers.rays_and_erf [MESH] [--size 512] [--rtol 0.003]

The floor traces the same number of rays and calls `scipy.special.erf` twice per pixel and slice into a preallocated array
(rows divided over threads, as in ours); loading and compilation are excluded; runs alternate.
"""

from __future__ import annotations

import argparse
import json
import os
import sys
import time
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import numpy as np
from scipy.special import erf

from ...generator.gated.direct import render_direct
from ...generator.rays.trace import Tracer, pixel_directions
from ...scenes.rigs.gated import gated_rig
from .mitransient_direct import bunny_scene, ours

__all__ = ["compare"]


def compare(mesh: str | None, size: int, rtol: float, repeats: int = 7) -> dict[str, Any]:
    """Ratio of our wall time to that of the floor, run by run."""
    scene = bunny_scene(mesh, size)
    tracer = Tracer(scene)
    rays = render_direct(scene, rtol, tracer).rays
    camera = gated_rig(scene).camera
    pixels = camera.rows * camera.cols
    rng = np.random.default_rng(0)
    row, col = rng.uniform(0, camera.rows - 1, rays), rng.uniform(0, camera.cols - 1, rays)
    direction = pixel_directions(camera, np.sort(row), col)
    slices = gated_rig(scene).delays.count
    u = rng.uniform(-3, 3, pixels).astype(np.float64)
    out = np.empty((slices, pixels), dtype=np.float32)
    threads = len(os.sched_getaffinity(0))

    def gate(k: int) -> None:
        out[k] = 0.5 * (erf(u + 0.1 * k) - erf(u - 0.1 * k))

    def floor() -> float:
        start = time.perf_counter()
        tracer.trace((0.0, 0.0, 0.0), direction)
        with ThreadPoolExecutor(threads) as pool:
            list(pool.map(gate, range(slices)))
        return time.perf_counter() - start

    ours(scene, tracer, rtol)
    floor()
    ratios = []
    for _ in range(repeats):
        _, seconds = ours(scene, tracer, rtol)
        ratios.append(seconds / floor())
    return {
        "scene": scene.name, "size": size, "slices": slices, "rtol": rtol, "rays_per_pixel": rays / pixels,
        "ratio_median": float(np.median(ratios)), "ratio_min": min(ratios), "ratio_max": max(ratios), "goal": 2.0,
    }  # fmt: skip


def main() -> int:
    """Command line of the comparison."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("mesh", nargs="?", default=None)
    parser.add_argument("--size", type=int, default=512)
    parser.add_argument("--rtol", type=float, default=3e-3)
    options = parser.parse_args()
    print(json.dumps(compare(options.mesh, options.size, options.rtol), indent=1))
    return 0


if __name__ == "__main__":
    sys.exit(main())
