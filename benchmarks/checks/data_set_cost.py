"""What a data set costs against the loop that a user would write: processor time of both, in interleaved pairs.

    python -m beambench.benchmarks.checks.data_set_cost --captures 200 --pairs 3

The loop calls `beambench.generate` with other overrides each time, in one process; the data set `gated-1k` is made by the command,
all of its processes counted. Prints a line for each pair and the medians, start-up included in both.
"""

from __future__ import annotations

import argparse
import json
import os
import shutil
import statistics
import subprocess
import sys
import tempfile
from collections.abc import Sequence
from pathlib import Path

__all__ = ["main", "pair"]

_LOOP = """
import json, sys, warnings
warnings.simplefilter("ignore")
import beambench
changes, out = json.load(open(sys.argv[1])), sys.argv[2]
for number, (scene, overrides) in enumerate(changes):
    beambench.generate(scene, overrides=overrides, seeds=[number], out=f"{out}/{number}.zarr")
"""


def main(arguments: Sequence[str] | None = None) -> int:
    """Measure, and print the ratio. Returns 1 where a data set costs more than half of the loop."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--captures", type=int, default=200)
    parser.add_argument("--pairs", type=int, default=3)
    parser.add_argument("--workers", type=int, default=1)
    given = parser.parse_args(arguments)
    ratios = []
    for number in range(given.pairs):
        loop, ours, files = pair(given.captures, given.workers, first_loop=number % 2 == 0)
        ratios.append(ours / loop)
        print(
            f"pair {number}: loop {loop / given.captures:.4f} s a capture, data set {ours / given.captures:.4f} s, "
            f"ratio {ratios[-1]:.3f}, {files / given.captures:.2f} files a capture",
            flush=True,
        )
    print(f"median ratio {statistics.median(ratios):.3f} of {given.pairs} pairs, {given.captures} captures each")
    return int(statistics.median(ratios) > 0.5)


def pair(captures: int, workers: int, *, first_loop: bool) -> tuple[float, float, int]:
    """(processor time of the loop, of the data set, s; files of the data set)."""
    from ...scenes.datasets.load import load_dataset

    draws = load_dataset("gated-1k", {"captures": captures})
    base = {one.label: one.overrides for one in draws.data.scenes}
    drawn = [draws.drawn(number) for number in range(captures)]
    with tempfile.TemporaryDirectory(prefix="beambench-cost-") as place:
        file, out = Path(place) / "changes.json", Path(place) / "set"
        file.write_text(json.dumps([[one.base, {**base[one.base], **one.changes}] for one in drawn]))
        loop = [sys.executable, "-c", _LOOP, str(file), str(Path(place) / "loop")]
        ours = [sys.executable, "-m", "beambench", "generate", "gated-1k", "--set", f"captures={captures}", "-o", str(out),
                "--workers", str(workers)]  # fmt: skip
        times = {}
        for name in ("loop", "ours") if first_loop else ("ours", "loop"):
            times[name] = _cpu_s(loop if name == "loop" else ours)
        files = sum(len(names) for _, _, names in os.walk(out))
        shutil.rmtree(Path(place) / "loop")
    return times["loop"], times["ours"], files


def _cpu_s(words: list[str]) -> float:
    """Processor time of a command and all that it started, s. Raises RuntimeError where it fails."""
    before = os.times()
    done = subprocess.run(words, capture_output=True, text=True, check=False)
    if done.returncode:
        raise RuntimeError(done.stderr[-500:])
    after = os.times()
    return after.children_user + after.children_system - before.children_user - before.children_system


if __name__ == "__main__":
    sys.exit(main())
