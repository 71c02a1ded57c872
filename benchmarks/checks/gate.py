"""How often the gate's speed test is wrong: planted slowdowns, and the same code against itself, in real processes.

    python -m beambench.benchmarks.checks.gate --minutes 60 --load 2 --pool starts.jsonl

Two targets are timed as the gate times them (`gate.sides`): a single-threaded kernel (`line-ml`) and the renderer (a small
gated scene). Every start of the three processes is recorded with two measurements of B: with as many calls as A (the
same code: any alarm is false) and with one call more in 34 or in 10 (a slowdown of 2.94 % or 10 % that is true by
construction: more of the same work). `--load` starts processes that keep the cores busy.

The starts are then dealt out to gates of 8, each of which may retry with 8 more. `real` gates share no start. `resampled`
gates draw their starts with replacement from all: more of them, but not independent. A gate has both targets, and is a false
alarm if either is red. `--judge` reads the pool and measures nothing. The pool may be continued.
"""

from __future__ import annotations

import json
import math
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from ..gate.check import ABSTAINS, PASS, REGRESSION, decided
from ..gate.sides import Paired, Side
from ..gate.speed import with_retry

__all__ = ["Start", "judged", "main"]

#: {target: (calls of A, more calls of B when planted, effect of interest, rounds)}.
TARGETS = {"kernel": (34, 1, 0.03, 7), "render": (10, 1, 0.10, 3)}
_STARTS, _RESAMPLED = 8, 1000
_LABEL, _SCENE, _RENDERED, _SIDE, _SEED = "line-ml", "spotscan-wall", "object1", 32, 1
_BUSY = "while True: sum(i * i for i in range(10000))"

#: {target: {"same", "null", "planted"}}: medians of logarithms over the rounds of one start.
Start = Mapping[str, Mapping[str, float]]


def _targets(scratch: Path) -> dict[str, dict[str, Any]]:
    """What the workers open."""
    from ...captures.hide import hide_truth
    from ...generator.generate import generate
    from ...scenes.load import load_scene
    from ...scenes.rigs import rig_kind
    from ..runner.protocol import write_capture, write_meta

    scene = load_scene(_SCENE)
    hidden = hide_truth(generate(scene, seed=_SEED))
    write_capture(scratch / "capture", hidden)
    write_meta(scratch / "capture", hidden, "matched")
    small = load_scene(_RENDERED)
    small = load_scene(_RENDERED, rig_kind(small.modality).resize(_SIDE))
    return {
        "kernel": {"kind": "estimate", "label": _LABEL, "folder": str(scratch / "capture"), "condition": "matched"},
        "render": {
            "kind": "render", "scene": small.model_dump(mode="json"), "seed": _SEED, "fidelity": "direct", "rtol": 1e-3,
        },
    }  # fmt: skip


def _start(targets: Mapping[str, Mapping[str, Any]], rng: np.random.Generator) -> dict[str, dict[str, float]]:
    """One start of A, A' and B, and the medians over its rounds."""
    found = {}
    sides = [Side(), Side(), Side()]
    try:
        for number, (name, target) in enumerate(targets.items()):
            count, more, _, rounds = TARGETS[name]
            for side in sides:
                side.open(number, target)
            turns = [(0, count), (1, count), (2, count), (2, count + more)]
            logs = np.zeros((rounds, len(turns)))
            for turn in range(rounds):
                for which in rng.permutation(len(turns)):
                    side_number, calls = turns[which]
                    logs[turn, which] = math.log(sides[side_number].time(number, calls))
            middle = 0.5 * (logs[:, 0] + logs[:, 1])
            found[name] = {
                "same": float(np.median(logs[:, 1] - logs[:, 0])),
                "null": float(np.median(logs[:, 2] - middle)),
                "planted": float(np.median(logs[:, 3] - middle)),
                "cpu_s": float(np.exp(np.median(middle))) / count,
            }
    finally:
        for side in sides:
            side.close()
    return found


def _measure(pool: Path, minutes: float, load: int) -> None:
    """Add starts to the pool until the time is over."""
    end = time.monotonic() + 60.0 * minutes
    busy = [subprocess.Popen([sys.executable, "-c", _BUSY]) for _ in range(load)]
    try:
        with tempfile.TemporaryDirectory(prefix="beambench-gate-check-") as scratch:
            targets = _targets(Path(scratch))
            rng = np.random.default_rng()
            while time.monotonic() < end:
                record = {"load": os.getloadavg()[0], **_start(targets, rng)}
                with open(pool, "a", encoding="utf-8") as file:
                    file.write(json.dumps(record) + "\n")
    finally:
        for process in busy:
            process.kill()
            process.wait()


def _gate(draw: Callable[[], Sequence[Start]], kind: str) -> dict[str, str]:
    """The states of both targets in one gate whose starts come from `draw`."""
    names = list(TARGETS)
    states: dict[str, str] = {}
    for only in [names] if kind == "null" else [[name] for name in names]:
        effect = {name: TARGETS[name][2] for name in only}

        def measure(numbers: Sequence[int]) -> dict[int, Paired]:
            starts = draw()
            return {
                number: Paired(
                    np.array([one[names[number]][kind] for one in starts]),
                    np.array([one[names[number]]["same"] for one in starts]),
                    starts[0][names[number]]["cpu_s"],
                )
                for number in numbers
            }

        found = {}
        for name in only:  # each target has its own effect; the correction is for all
            number = names.index(name)
            found[name] = with_retry({number: name}, effect[name], measure)[number].check
        for name, check in zip(found, decided(list(found.values())), strict=True):
            states[name] = check.state
    return states


def judged(starts: Sequence[Start], kind: str, *, resampled: int = 0, seed: int = 1) -> list[dict[str, str]]:
    """States {target: state} of many gates, from disjoint starts or, with `resampled`, from draws with replacement."""
    rng = np.random.default_rng(seed)
    if resampled:
        return [
            _gate(lambda: [starts[k] for k in rng.integers(0, len(starts), _STARTS)], kind) for _ in range(resampled)
        ]
    left: Iterator[Start] = iter(starts)

    def draw() -> Sequence[Start]:
        taken = [one for _, one in zip(range(_STARTS), left, strict=False)]
        if len(taken) < _STARTS:
            raise StopIteration
        return taken

    found = []
    while True:
        try:
            found.append(_gate(draw, kind))
        except StopIteration:
            return found


def _table(starts: Sequence[Start], loads: Sequence[float]) -> None:
    print(f"{len(starts)} starts, load average {np.median(loads):.1f} (median) on {os.cpu_count()} cores")
    for name, (count, more, _, _) in TARGETS.items():
        spread = [np.std([one[name][kind] for one in starts], ddof=1) for kind in ("same", "null", "planted")]
        middle = np.mean([one[name]["planted"] - one[name]["null"] for one in starts])
        print(
            f"{name:7} planted {100 * more / count:.2f} %, measured {100 * math.expm1(middle):+.2f} %; per start: A/A sd "
            f"{100 * spread[0]:.2f} %, B/A sd {100 * spread[1]:.2f} %"
        )
    print(f"{'gates':10} {'kind':8} {'target':8} {'number':>7} {'red':>6} {'passes':>7} {'abstains':>9}")
    for word, number in (("real", 0), ("resampled", _RESAMPLED)):
        for kind in ("null", "planted"):
            gates = judged(starts, kind, resampled=number)
            for name in TARGETS:
                states = [gate[name] for gate in gates]
                print(
                    f"{word:10} {kind:8} {name:8} {len(states):7} {states.count(REGRESSION):6} {states.count(PASS):7} "
                    f"{states.count(ABSTAINS):9}"
                )


def main(arguments: Sequence[str] | None = None) -> int:
    """Measure, and print the table."""
    import argparse

    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--minutes", type=float, default=60.0)
    parser.add_argument("--load", type=int, default=2, help="busy processes beside the measurement")
    parser.add_argument("--pool", type=Path, default=Path("gate-starts.jsonl"))
    parser.add_argument("--judge", action="store_true", help="only read the pool")
    chosen = parser.parse_args(arguments)
    if not chosen.judge:
        _measure(chosen.pool, chosen.minutes, chosen.load)
    records = [json.loads(line) for line in chosen.pool.read_text(encoding="utf-8").splitlines()]
    _table(records, [float(one["load"]) for one in records])
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
