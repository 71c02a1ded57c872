"""`weighted-average` against `numpy.copyto` of the same array: its cost relative to copying the stack once.

python -m beambench.benchmarks.peers.copyto
"""

from __future__ import annotations

import os
import time
from typing import Any

import numpy as np

from ..written.gated_stack import GaussianRig, stack_capture

__all__ = ["compare"]


def compare(*, rows: int = 512, cols: int = 512, slices: int = 64, rounds: int = 15, seed: int = 1) -> dict[str, Any]:
    """Interleaved wall and CPU times of both, one thread, C-ordered uint16 counts (slice, row, col).

    Returns sizes, the median times [s], the ratio of the medians, the median of the ratios of single rounds, and their
    spread. The whole estimator is timed: reading the rig, moments, sigma, conversion to range, the checked Dataset.
    """
    from ...estimators import run_estimator

    rig = GaussianRig(slices=slices)
    rng = np.random.default_rng(seed)
    tau = rig.start_s + rig.centre_s + rig.step_s * slices * (0.3 + 0.4 * rng.random((rows, cols)))
    counts = np.empty((slices, rows, cols), dtype=np.uint16)
    for row in range(rows):
        counts[:, row] = rng.poisson(rig.electrons(tau[row], 1e4, 1.0))
    capture = stack_capture(rig, counts)
    target = np.empty_like(counts)
    run_estimator("weighted-average", capture)
    np.copyto(target, counts)
    times: list[tuple[float, float]] = []
    for _ in range(rounds):
        t0 = time.process_time()
        np.copyto(target, counts)
        t1 = time.process_time()
        run_estimator("weighted-average", capture)
        times.append((t1 - t0, time.process_time() - t1))
    copy, average = np.median(np.array(times), axis=0)
    ratios = np.array([b / a for a, b in times])
    return {
        "rows": rows, "cols": cols, "slices": slices, "megabytes": counts.nbytes / 1e6, "rounds": rounds,
        "copyto_cpu_s": float(copy), "weighted_average_cpu_s": float(average), "ratio": float(np.median(ratios)),
        "ratio_p10": float(np.quantile(ratios, 0.1)), "ratio_p90": float(np.quantile(ratios, 0.9)),
    }  # fmt: skip


def main() -> None:
    """Print the comparison. The caller must pin the threads of numerical libraries to one before numpy is imported."""
    found = compare()
    print(
        f"stack {found['slices']} x {found['rows']} x {found['cols']} uint16, {found['megabytes']:.1f} MB, CPU seconds"
    )
    print(f"np.copyto          {found['copyto_cpu_s'] * 1e3:8.2f} ms")
    print(f"weighted-average   {found['weighted_average_cpu_s'] * 1e3:8.2f} ms")
    print(
        f"ratio              {found['ratio']:8.2f}    (10-90 %: {found['ratio_p10']:.2f} to {found['ratio_p90']:.2f})"
    )


if __name__ == "__main__":
    os.environ.setdefault("NUMBA_NUM_THREADS", "1")
    main()
