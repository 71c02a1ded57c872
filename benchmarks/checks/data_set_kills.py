"""Kills of the making of a data set: SIGKILL at random moments, of the command or of one of its workers, then --resume.

    python -m beambench.benchmarks.checks.data_set_kills --rounds 20 --shards 300

A data set of many shards is made once undisturbed, and once more in rounds: each is started with --resume and killed after a
random time, the command itself or, every third time, one worker first (which is replaced). A last --resume finishes it. A round
holds if what has a receipt after the kill is sound; the campaign, if all captures are there, `verify` finds nothing, and every file
of the store is that of the undisturbed one.
"""

from __future__ import annotations

import argparse
import json
import os
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from .attempts import Attempts, print_attempts

__all__ = ["data_set_kills", "differing", "main", "shards_of", "words_for"]

#: Captures of a shard; a round is killed within this share of an undisturbed run's time after its first word.
_PER_SHARD, _SHARE = 4, 1 / 6


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the campaign and print its table. Returns 1 where an attempt failed."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--rounds", type=int, default=20)
    parser.add_argument("--shards", type=int, default=300)
    parser.add_argument("--workers", type=int, default=1)
    parser.add_argument("--seed", type=int, default=1)
    given = parser.parse_args(arguments)
    return print_attempts([data_set_kills(given.rounds, given.shards, given.workers, given.seed)])


def data_set_kills(rounds: int, shards: int, workers: int = 1, seed: int = 1) -> Attempts:
    """The campaign: an attempt for each round, and a last one for the finished store."""
    part = Attempts(f"kills of a data set of {shards} shards, {workers} workers")
    rng = np.random.default_rng(seed)
    with tempfile.TemporaryDirectory(prefix="beambench-kills-") as place:
        base = Path(place)
        file = base / "set.json"
        file.write_text(json.dumps(shards_of(shards)))
        began = time.monotonic()
        _run(file, base / "whole", workers)
        longest = _SHARE * (time.monotonic() - began)
        kills = 0
        while kills < rounds:
            if (base / "broken").exists():  # complete before all rounds were made: compared, and begun again
                _compare(part, base, shards)
                shutil.rmtree(base / "broken")
            number = kills
            how = _round(file, base / "broken", workers, float(rng.uniform(0.0, longest)), number % 3 == 2, rng)
            problem = _damage(base / "broken")
            kills += bool(how or problem)
            if problem:
                part.failed(f"round {number}: {problem}")
            elif how:
                part.held(how)
        _run(file, base / "broken", workers)
        _compare(part, base, shards)
    return part


def _compare(part: Attempts, base: Path, shards: int) -> None:
    problem = differing(base / "whole", base / "broken", shards)
    part.failed(problem) if problem else part.held("finished")


def shards_of(shards: int) -> dict[str, Any]:
    """A data set of that many shards, of small captures."""
    wall = {"scene": "counter", "overrides": {"rig.record.shots": 4}}
    turn = {"kind": "uniform", "low": 0.05, "high": 0.9, "paths": ["target.0.material.albedo"]}
    return {
        "schema_version": 1, "dataset": "kills", "captures": shards * _PER_SHARD, "per_shard": _PER_SHARD, "seed": 1,
        "scenes": [wall], "fidelity": "direct", "rtol": 0.1, "parameters": {"albedo": turn},
    }  # fmt: skip


def words_for(file: Path, out: Path, *more: str) -> list[str]:
    """The command that makes or continues a data set."""
    return [sys.executable, "-m", "beambench", "generate", str(file), "-o", str(out), "--resume", *more]


def _run(file: Path, out: Path, workers: int) -> None:
    """Make or finish the data set. Raises RuntimeError where that fails."""
    done = subprocess.run(words_for(file, out, "--workers", str(workers)), capture_output=True, text=True, check=False)
    if done.returncode:
        raise RuntimeError(f"exit {done.returncode}: {done.stderr[-500:]}")


def _round(file: Path, out: Path, workers: int, after_s: float, of_worker: bool, rng: np.random.Generator) -> str:
    """Start or continue the data set and kill it; a worker first, where asked. Returns what was killed, or ""."""
    with subprocess.Popen(
        words_for(file, out, "--workers", str(workers)), stdout=subprocess.DEVNULL, stderr=subprocess.PIPE
    ) as process:
        assert process.stderr is not None
        process.stderr.readline()  # its first word: workers are at work
        time.sleep(after_s)
        killed = _kill_worker(process.pid, rng) if of_worker else False
        if killed:
            time.sleep(after_s)
        process.send_signal(signal.SIGKILL)
        process.stderr.close()
        process.wait()
    if process.returncode == 0:
        return ""  # it was finished before
    if process.returncode != -signal.SIGKILL:
        raise RuntimeError(f"exit {process.returncode}")
    return "a worker, then the command" if killed else "the command"


def _kill_worker(parent: int, rng: np.random.Generator) -> bool:
    import psutil

    try:
        children = psutil.Process(parent).children()
        os.kill(children[int(rng.integers(len(children)))].pid, signal.SIGKILL)
    except (psutil.Error, ProcessLookupError, ValueError):
        return False
    return True


def _damage(out: Path) -> str:
    """What is wrong with the shards that have a receipt."""
    from ...captures.store.faces import verify

    for place in (out, out.with_name(out.name + ".partial")):
        if (place / "receipts").is_dir() and (damage := verify(place)):
            return f"{damage[0]}"
    return ""


def differing(whole: Path, broken: Path, shards: int) -> str:
    """How a finished store differs from the undisturbed one, or ""."""
    from ...captures import open_captures, verify

    if found := verify(broken):
        return f"the finished store is damaged: {found[0]}"
    if len(open_captures(broken)) != shards * _PER_SHARD:
        return f"{len(open_captures(broken))} captures, not {shards * _PER_SHARD}"
    trees = [{p.relative_to(root): p.read_bytes() for p in root.rglob("*") if p.is_file()} for root in (whole, broken)]
    names = [str(name) for name in {*trees[0], *trees[1]} if trees[0].get(name) != trees[1].get(name)]
    return f"files differ: {sorted(names)[:3]}" if names else ""


if __name__ == "__main__":
    sys.exit(main())
