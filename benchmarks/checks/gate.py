"""How often the gate's speed test is wrong: planted slowdowns, and the same code against itself, in real processes.

    python -m beambench.benchmarks.checks.gate --minutes 60 --load 2 --pool starts.jsonl

Two targets are timed as the gate times them (`gate.sides`): a single-threaded kernel (`line-ml`, one fit per row) and the
renderer (ten small gated scenes as one call). Every start of the three processes is recorded with two measurements of B: with
the same work as A (any alarm is false) and with more of the same work: 264 rows in place of 256 (+3.1 %), eleven scenes in
place of ten (+10 %). `--load` starts processes that keep the cores busy.

The starts are then dealt out to gates of 8, each of which may retry with 8 more. `real` gates share no start. `first` gates share
none either and do not retry: twice as many, and a false alarm is no rarer among them, as a retry can only take one back.
`resampled` gates draw their starts with replacement from all: more of them, but not independent. A gate without a planted
slowdown has both targets. `--judge` reads the pool and measures nothing. The pool may be continued.
`--simulate` needs no pool: it draws the starts' and the cells' logarithms from normal laws of given scatter, and passes them
through the same decision.
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

from ..gate.check import ABSTAINS, PASS, REGRESSION, decided, measured
from ..gate.sides import Paired, Side, any_core, typical
from ..gate.speed import speed_check, with_retry

__all__ = ["Start", "judged", "main"]

#: {target: (calls per turn, rounds, effect of interest)}.
TARGETS = {"kernel": (30, 9, 0.03), "render": (1, 3, 0.10)}
_STARTS, _RESAMPLED = 8, 1000
_LABEL, _SCENE, _ROWS, _MORE_ROWS = "line-ml", "spotscan-wall", 256, 264
_RENDERED, _SIDE, _SCENES, _MORE_SCENES, _SEED = "object1", 32, 10, 11, 1
_BUSY = "while True: sum(i * i for i in range(10000))"

#: {target: {"same", "null", "planted"}}: medians of logarithms over the rounds of one start.
Start = Mapping[str, Mapping[str, float]]


def _targets(scratch: Path) -> dict[str, tuple[dict[str, Any], dict[str, Any]]]:
    """What the workers open: {target: (as it is, with more work)}."""
    from ...captures.hide import hide_truth
    from ...generator.generate import generate
    from ...scenes.load import load_scene
    from ...scenes.rigs import rig_kind
    from ..runner.protocol import write_capture, write_meta

    kernels = []
    for rows in (_ROWS, _MORE_ROWS):
        folder = scratch / f"{rows}-rows"
        hidden = hide_truth(generate(load_scene(_SCENE, {"rig.camera.rows": rows}), seed=_SEED))
        write_capture(folder, hidden)
        write_meta(folder, hidden, "matched")
        kernels.append({"kind": "estimate", "label": _LABEL, "folder": str(folder), "condition": "matched"})
    small = load_scene(_RENDERED)
    small = load_scene(_RENDERED, rig_kind(small.modality).resize(_SIDE))
    scene = {"scene": small.model_dump(mode="json"), "seed": _SEED, "fidelity": "direct", "rtol": 1e-3}
    renders = [{"kind": "render", **scene, "repeat": count} for count in (_SCENES, _MORE_SCENES)]
    return {"kernel": (kernels[0], kernels[1]), "render": (renders[0], renders[1])}


def _start(
    targets: Mapping[str, tuple[Mapping[str, Any], Mapping[str, Any]]], rng: np.random.Generator
) -> dict[str, dict[str, float]]:
    """One start of A, A' and B, and the medians over its rounds."""
    found = {}
    core = any_core(rng)
    sides = [Side(core=core), Side(core=core), Side(core=core)]
    turns = [(0, 0), (1, 0), (2, 0), (2, 1)]  # (side, more work or not)
    try:
        for number, (name, pair) in enumerate(targets.items()):
            calls, rounds, _ = TARGETS[name]
            for side, more in turns:
                sides[side].open(2 * number + more, pair[more])
            logs = np.zeros((rounds, len(turns)))
            for turn in range(rounds):
                for which in rng.permutation(len(turns)):
                    side, more = turns[which]
                    logs[turn, which] = typical(sides[side].time(2 * number + more, calls))
            middle = 0.5 * (logs[:, 0] + logs[:, 1])
            found[name] = {
                "same": float(np.median(logs[:, 1] - logs[:, 0])),
                "null": float(np.median(logs[:, 2] - middle)),
                "planted": float(np.median(logs[:, 3] - middle)),
                "cpu_s": float(np.exp(np.median(middle))),
            }
    finally:
        for one in sides:
            one.close()
    return found


def _measure(pool: Path, minutes: float, load: int) -> None:
    """Add starts to the pool until the time is over."""
    end = time.monotonic() + 60.0 * minutes
    busy = [subprocess.Popen([sys.executable, "-c", _BUSY]) for _ in range(load)]
    try:
        with tempfile.TemporaryDirectory(prefix="beambench-gate-check-") as scratch:
            targets = _targets(Path(scratch))
            rng = np.random.default_rng()
            _start(targets, rng)  # compiles; not recorded
            while time.monotonic() < end:
                record = {"load": os.getloadavg()[0], **_start(targets, rng)}
                with open(pool, "a", encoding="utf-8") as file:
                    file.write(json.dumps(record) + "\n")
    finally:
        for process in busy:
            process.kill()
            process.wait()


def _paired(starts: Sequence[Start], name: str, kind: str) -> Paired:
    return Paired(
        np.array([one[name][kind] for one in starts]),
        np.array([one[name]["same"] for one in starts]),
        starts[0][name]["cpu_s"],
    )


def _measures(
    first: Sequence[Start], draw: Callable[[], Sequence[Start]], name: str, kind: str
) -> Callable[[Sequence[int]], dict[int, Paired]]:
    """What `with_retry` measures one target by: the first starts at first, and others when it is repeated."""
    held = iter([first])

    def measure(numbers: Sequence[int]) -> dict[int, Paired]:
        starts = next(held, None) or draw()
        return {number: _paired(starts, name, kind) for number in numbers}

    return measure


def _gate(draw: Callable[[], Sequence[Start]], kind: str, retry: bool) -> dict[str, str]:
    """The states of both targets in one gate whose starts come from `draw`: once for all targets, and anew for a repeated one."""
    names = list(TARGETS)
    states: dict[str, str] = {}
    common = draw()
    for only in [names] if kind == "null" else [[name] for name in names]:
        found = {}
        for name in only:  # each target has its own effect; the correction is for all
            effect = TARGETS[name][2]
            if retry:
                measure = _measures(common, draw, name, kind)
                found[name] = with_retry({0: name}, effect, measure)[0].check
            else:
                found[name] = speed_check(name, _paired(common, name, kind), effect).check
        for name, check in zip(found, decided(list(found.values())), strict=True):
            states[name] = check.state
    return states


def judged(
    starts: Sequence[Start], kind: str, *, resampled: int = 0, seed: int = 1, retry: bool = True
) -> list[dict[str, str]]:
    """States {target: state} of many gates, from disjoint starts or, with `resampled`, from draws with replacement."""
    rng = np.random.default_rng(seed)
    if resampled:
        return [
            _gate(lambda: [starts[k] for k in rng.integers(0, len(starts), _STARTS)], kind, retry)
            for _ in range(resampled)
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
            found.append(_gate(draw, kind, retry))
        except StopIteration:
            return found


def _table(starts: Sequence[Start], loads: Sequence[float]) -> None:
    print(f"{len(starts)} starts, load average {np.median(loads):.1f} (median) on {os.cpu_count()} cores")
    for name in TARGETS:
        spread = [np.std([one[name][kind] for one in starts], ddof=1) for kind in ("same", "null")]
        more = [one[name]["planted"] - one[name]["null"] for one in starts]
        error = np.std(more, ddof=1) / math.sqrt(len(more))
        print(
            f"{name:7} planted: {100 * math.expm1(np.mean(more)):+.2f} ± {200 * error:.2f} % (2 se); scatter per start: A/A "
            f"{100 * spread[0]:.2f} %, B/A {100 * spread[1]:.2f} %"
        )
    print(f"{'gates':10} {'kind':8} {'target':8} {'number':>7} {'red':>6} {'passes':>7} {'abstains':>9}")
    for word, number, retry in (("real", 0, True), ("first", 0, False), ("resampled", _RESAMPLED, True)):
        for kind in ("null", "planted"):
            gates = judged(starts, kind, resampled=number, retry=retry)
            for name in TARGETS:
                states = [gate[name] for gate in gates]
                print(
                    f"{word:10} {kind:8} {name:8} {len(states):7} {states.count(REGRESSION):6} {states.count(PASS):7} "
                    f"{states.count(ABSTAINS):9}"
                )


def _simulated_speed(slower: float, effect: float, scatter: float, starts: int, rng: np.random.Generator) -> str:
    """State of a gate whose processes have speeds of their own with the given scatter."""

    def measure(numbers: Sequence[int]) -> dict[int, Paired]:
        found = {}
        for number in numbers:
            a, twin, b = scatter * rng.normal(size=(3, starts))
            found[number] = Paired(math.log1p(slower) + b - 0.5 * (a + twin), twin - a, 0.01)
        return found

    return decided([with_retry({0: "made"}, effect, measure)[0].check])[0].state


def _simulated_error(worse: float, scatter: float, cells: int, rng: np.random.Generator) -> str:
    """State of the accuracy of an estimator whose cells change by the given scatter."""
    logs = math.log1p(worse) + scatter * rng.normal(size=cells)
    error = float(logs.std(ddof=1)) / math.sqrt(cells)
    return decided([measured("accuracy", "made", float(logs.mean()), error, cells - 1, math.log1p(0.05))])[0].state


def _simulate(gates: int) -> None:
    """Print the shares of simulated gates that are red, pass and abstain."""
    rng = np.random.default_rng(0)
    print(f"{gates} simulated gates a line: red / passes / abstains, %")

    def line(words: str, draw: Callable[[float], str], change: float) -> None:
        shares = []
        for true in (0.0, change):
            states = [draw(true) for _ in range(gates)]
            shares.append(" / ".join(f"{100 * states.count(s) / gates:.1f}" for s in (REGRESSION, PASS, ABSTAINS)))
        print(f"{words}: unchanged {shares[0]}, {100 * change:+.0f} % {shares[1]}")

    for effect in (0.03, 0.10):
        for scatter in (0.005, 0.01, 0.02, 0.04):
            for starts in (8, 16):
                line(
                    f"speed, scatter {100 * scatter:g} % per process, {starts} starts",
                    lambda true, e=effect, s=scatter, n=starts: _simulated_speed(true, e, s, n, rng),  # type: ignore[misc]
                    effect,
                )
    for cells in (6, 10, 40):
        for scatter in (0.01, 0.03, 0.10):
            line(
                f"rmse, scatter {100 * scatter:g} % per cell, {cells} cells",
                lambda true, n=cells, s=scatter: _simulated_error(true, s, n, rng),  # type: ignore[misc]
                0.05,
            )


def main(arguments: Sequence[str] | None = None) -> int:
    """Measure, and print the table."""
    import argparse

    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--minutes", type=float, default=60.0)
    parser.add_argument("--load", type=int, default=2, help="busy processes beside the measurement")
    parser.add_argument("--pool", type=Path, default=Path("gate-starts.jsonl"))
    parser.add_argument("--judge", action="store_true", help="only read the pool")
    parser.add_argument("--simulate", type=int, metavar="GATES", help="only simulate so many gates of each kind")
    chosen = parser.parse_args(arguments)
    if chosen.simulate:
        _simulate(chosen.simulate)
        return 0
    if not chosen.judge:
        _measure(chosen.pool, chosen.minutes, chosen.load)
    records = [json.loads(line) for line in chosen.pool.read_text(encoding="utf-8").splitlines()]
    _table(records, [float(one["load"]) for one in records])
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
