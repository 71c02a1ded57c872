"""A data set of N captures against one of fewer: processor time of a capture, peak memory, and how far the plan was off.

    python -m beambench.benchmarks.checks.data_set_scale --dataset gated-1k --few 100 --many 10000 --times 10
    python -m beambench.benchmarks.checks.data_set_scale --shots 16 --few 2000 --many 10000

Both sizes are made by the command in turn, all of its processes counted. Printed for each: CPU s a capture, of all and beyond the
first twenty (data sets of twenty are made before and after, as often as those of few), most resident memory of a process, and size
and CPU time by `--plan` against what they were. `--shots N` takes small captures of a detector's pulses instead of a data set of
the library: thousands of them cost what a start does, so that few show little.
"""

from __future__ import annotations

import argparse
import json
import os
import statistics
import subprocess
import sys
import tempfile
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

__all__ = ["main"]

#: Captures whose cost is taken for that of a start: among them are all scenes of a data set, whose first ones load kernels.
_START = 20
#: Largest standard error of the ratio of costs that tells 5 %.
_LARGEST_ERROR = 0.025


@dataclass(frozen=True)
class _Cost:
    """What a command took, all processes counted: processor time, s, and most resident memory of one, bytes; size of its store."""

    cpu_s: float
    peak_bytes: int
    bytes: int


def main(arguments: Sequence[str] | None = None) -> int:
    """Measure and print. Returns 1 where cost differs by over 5 %, memory by over 10 %, or a plan is over 20 % off; 3 where the
    cost is not known well enough."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--dataset", default="gated-1k")
    parser.add_argument("--shots", type=int, default=0)
    parser.add_argument("--repeats", type=int, default=1)
    parser.add_argument("--few", type=int, default=100)
    parser.add_argument("--many", type=int, default=1000)
    parser.add_argument("--pairs", type=int, default=1)
    parser.add_argument("--times", type=int, default=5, help="starts, and data sets of few captures, of each pair")
    given = parser.parse_args(arguments)
    with tempfile.TemporaryDirectory(prefix="beambench-scale-") as place:
        base = Path(place)
        source = _small(base, given.shots) if given.shots else given.dataset
        words = [source, "--set", f"repeats={given.repeats}", "--set", "split=null"]
        _made(words, 2, base)  # compiles what is not compiled yet
        costs: dict[int, list[_Cost]] = {_START: [], given.few: [], given.many: []}
        for _ in range(given.pairs):
            for count in (
                *[_START, given.few] * (given.times // 2),
                given.many,
                *[given.few, _START] * -(-given.times // 2),
            ):
                costs[count].append(_made(words, count, base))
        plan = json.loads(
            _beambench("generate", *words, "--set", f"captures={given.many}", "--plan", "--workers", "1", "--json")
        )
    return _told(costs, plan["outline"], given.few, given.many)


def _told(costs: dict[int, list[_Cost]], plan: dict[str, float], few: int, many: int) -> int:
    mean = {count: statistics.fmean(one.cpu_s for one in found) for count, found in costs.items()}
    # The start is taken off both; of many captures it is a small part, and its error counts for the few.
    scatter = statistics.pstdev([one.cpu_s - mean[count] for count in (_START, few) for one in costs[count]])
    error = scatter * (1.0 / len(costs[_START]) + 1.0 / len(costs[few])) ** 0.5 / (few - _START)
    each = {}
    for count in (few, many):
        each[count] = (mean[count] - mean[_START]) / (count - _START)
        print(
            f"{count} captures: {mean[count] / count:.4f} CPU s each, {each[count]:.4f} beyond the first {_START}, "
            f"which took {mean[_START]:.1f} s; most memory {max(one.peak_bytes for one in costs[count]) / 2**20:.0f} MiB; "
            f"{costs[count][0].bytes / count:.0f} bytes each"
        )
    cost = each[many] / each[few]
    sigma = cost * error / each[few]
    memory = max(one.peak_bytes for one in costs[many]) / max(one.peak_bytes for one in costs[few])
    size, cpu = plan["bytes"] / costs[many][0].bytes, plan["cpu_s"] / mean[many]
    print(
        f"cost of {many} against {few}: {cost:.3f} ± {sigma:.3f} (1 σ); memory {memory:.3f}; the plan's size {size:.3f}, its "
        f"CPU time {cpu:.3f}"
    )
    good = abs(cost - 1.0) <= 0.05 and memory <= 1.1 and abs(size - 1.0) <= 0.2 and abs(cpu - 1.0) <= 0.2
    if sigma > _LARGEST_ERROR and not good:
        print("The error is too large to tell 5 %: take more --times, or captures that cost more.")
        return 3
    return int(not good)


def _small(base: Path, shots: int) -> str:
    albedo = {"kind": "uniform", "low": 0.05, "high": 0.9, "paths": ["target.0.material.albedo"]}
    data = {
        "schema_version": 1, "dataset": "small", "captures": 2, "seed": 1, "fidelity": "direct", "rtol": 0.1,
        "scenes": [{"scene": "counter", "overrides": {"rig.record.shots": shots}}], "parameters": {"albedo": albedo},
    }  # fmt: skip
    file = base / "small.json"
    file.write_text(json.dumps(data))
    return str(file)


def _made(words: list[str], count: int, base: Path) -> _Cost:
    out = base / "out"
    command = ["generate", *words, "--set", f"captures={count}", "-o", str(out), "--workers", "1", "--overwrite"]
    # A process of its own, whose children's times and memory are those of this command alone.
    told = subprocess.run(
        [sys.executable, "-c", _MEASURE, *command], capture_output=True, text=True, check=True
    ).stdout.split()
    size = sum(os.lstat(Path(place) / name).st_size for place, _, names in os.walk(out) for name in names)
    return _Cost(float(told[-2]), int(told[-1]), size)


_MEASURE = """
import resource, subprocess, sys
subprocess.run([sys.executable, "-m", "beambench", *sys.argv[1:]], check=True, stdout=subprocess.DEVNULL)
used = resource.getrusage(resource.RUSAGE_CHILDREN)
print(used.ru_utime + used.ru_stime, used.ru_maxrss * 1024)
"""


def _beambench(*words: str) -> str:
    command = [sys.executable, "-m", "beambench", *words]
    return subprocess.run(command, capture_output=True, text=True, check=True).stdout


if __name__ == "__main__":
    sys.exit(main())
