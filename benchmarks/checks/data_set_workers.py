"""Two workers against one on a data set: wall time of both, in interleaved pairs, and how busy the machine was beside them.

    python -m beambench.benchmarks.checks.data_set_workers --captures 600 --pairs 3

Needs a machine with two free processors. Wall time is told with and without what a start costs (that of a data set of two captures,
with as many workers). What other processes used meanwhile is told for each pair: above a twentieth of the processors the figure
says little, and the exit code is 3.
"""

from __future__ import annotations

import argparse
import os
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

__all__ = ["main"]

#: Least gain of `--workers` workers for each of them, and most share of the processors that others may use.
_GAIN, _OTHERS = 0.9, 0.05


@dataclass(frozen=True)
class _Time:
    """Of a command: wall time and processor time of all its processes, s, and processor time of all others meanwhile."""

    wall_s: float
    cpu_s: float
    others_s: float


def main(arguments: Sequence[str] | None = None) -> int:
    """Measure, and print the gain. Returns 1 where it is below .9 for each worker, 3 where the machine was busy."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--dataset", default="gated-1k")
    parser.add_argument("--captures", type=int, default=600)
    parser.add_argument("--workers", type=int, default=2)
    parser.add_argument("--pairs", type=int, default=3)
    given = parser.parse_args(arguments)
    gains, busy = [], 0.0
    with tempfile.TemporaryDirectory(prefix="beambench-workers-") as place:
        out = Path(place) / "out"
        _made(given.dataset, 2, 1, out)  # compiles what is not compiled yet
        starts = {count: _made(given.dataset, 2, count, out).wall_s for count in (1, given.workers)}
        for number in range(given.pairs):
            order = (1, given.workers) if number % 2 == 0 else (given.workers, 1)
            times = {count: _made(given.dataset, given.captures, count, out) for count in order}
            one, many = times[1], times[given.workers]
            gains.append((one.wall_s - starts[1]) / (many.wall_s - starts[given.workers]))
            share = max(time.others_s / (time.wall_s * (os.cpu_count() or 1)) for time in times.values())
            busy = max(busy, share)
            whole = one.wall_s / many.wall_s
            print(
                f"pair {number}: one {one.wall_s:.1f} s, {given.workers} workers {many.wall_s:.1f} s: {whole:.2f} times as "
                f"fast, {gains[-1]:.2f} without the start; CPU {one.cpu_s:.0f} and {many.cpu_s:.0f} s; others used "
                f"{100 * share:.0f} % of the processors",
                flush=True,
            )
    gain = statistics.median(gains)
    print(
        f"{given.workers} workers: {gain:.2f} times as fast as one, median of {given.pairs} pairs of {given.captures} captures"
    )
    if busy > _OTHERS:
        print(f"Others used up to {100 * busy:.0f} % of the processors: measure again on an idle machine.")
        return 3
    return int(gain < _GAIN * given.workers)


def _made(dataset: str, captures: int, workers: int, out: Path) -> _Time:
    """Make a data set of so many captures. Raises RuntimeError where that fails."""
    words = [sys.executable, "-m", "beambench", "generate", dataset, "--set", f"captures={captures}", "--set", "split=null",
             "-o", str(out), "--workers", str(workers), "--overwrite"]  # fmt: skip
    before, all_before, began = os.times(), _used_s(), time.monotonic()
    done = subprocess.run(words, capture_output=True, text=True, check=False)
    wall_s, all_s, after = time.monotonic() - began, _used_s() - all_before, os.times()
    if done.returncode:
        raise RuntimeError(done.stderr[-500:])
    own_s = after.children_user + after.children_system - before.children_user - before.children_system
    return _Time(wall_s, own_s, max(0.0, all_s - own_s))


def _used_s() -> float:
    """Processor time that all processes of the machine have used since it began, s."""
    import psutil

    times = psutil.cpu_times()
    return float(times.user + times.nice + times.system)


if __name__ == "__main__":
    sys.exit(main())
