"""A data set of N captures against one of fewer: processor time of a capture, peak memory, and how far the plan was off.

    python -m beambench.benchmarks.checks.data_set_scale --dataset gated-1k --few 100 --many 1000 --pairs 2
    python -m beambench.benchmarks.checks.data_set_scale --shots 16 --few 100 --many 10000

Both sizes are made by the command in turn, all of its processes counted. Printed for each: CPU s a capture with and without what a
start costs (that of a data set of two captures of the same kind), most resident memory of a process, and size and CPU time by
`--plan` against what they were. `--shots N` takes small captures of a detector's pulses instead of a data set of the library.
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


@dataclass(frozen=True)
class _Cost:
    """What a command took, all processes counted: processor time, s, and most resident memory of one, bytes; size of its store."""

    cpu_s: float
    peak_bytes: int
    bytes: int


def main(arguments: Sequence[str] | None = None) -> int:
    """Measure and print. Returns 1 where cost differs by over 5 %, memory by over 10 %, or a plan is over 20 % off."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--dataset", default="gated-1k")
    parser.add_argument("--shots", type=int, default=0)
    parser.add_argument("--repeats", type=int, default=1)
    parser.add_argument("--few", type=int, default=100)
    parser.add_argument("--many", type=int, default=1000)
    parser.add_argument("--pairs", type=int, default=1)
    given = parser.parse_args(arguments)
    with tempfile.TemporaryDirectory(prefix="beambench-scale-") as place:
        base = Path(place)
        source = _small(base, given.shots) if given.shots else given.dataset
        words = [source, "--set", f"repeats={given.repeats}", "--set", "split=null"]
        start = _made(words, 2, base).cpu_s
        costs: dict[int, list[_Cost]] = {given.few: [], given.many: []}
        for number in range(given.pairs):
            for count in (given.few, given.many) if number % 2 == 0 else (given.many, given.few):
                costs[count].append(_made(words, count, base))
        plan = json.loads(
            _beambench("generate", *words, "--set", f"captures={given.many}", "--plan", "--workers", "1", "--json")
        )
    return _told(costs, start, plan["outline"], given.few, given.many)


def _told(costs: dict[int, list[_Cost]], start: float, plan: dict[str, float], few: int, many: int) -> int:
    each = {}
    for count, found in costs.items():
        cpu_s = statistics.median(one.cpu_s for one in found)
        each[count] = (cpu_s - start) / count
        print(
            f"{count} captures: {cpu_s / count:.4f} CPU s each, {each[count]:.4f} without the start of {start:.1f} s; "
            f"most memory {max(one.peak_bytes for one in found) / 2**20:.0f} MiB; {found[0].bytes / count:.0f} bytes each"
        )
    cost = each[many] / each[few]
    memory = max(one.peak_bytes for one in costs[many]) / max(one.peak_bytes for one in costs[few])
    size, cpu = (
        plan["bytes"] / costs[many][0].bytes,
        plan["cpu_s"] / statistics.median(one.cpu_s for one in costs[many]),
    )
    print(
        f"cost of {many} against {few}: {cost:.3f}; memory {memory:.3f}; the plan's size {size:.3f}, its CPU time {cpu:.3f}"
    )
    good = abs(cost - 1.0) <= 0.05 and memory <= 1.1 and abs(size - 1.0) <= 0.2 and abs(cpu - 1.0) <= 0.2
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
