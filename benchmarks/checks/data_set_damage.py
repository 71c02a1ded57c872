"""Damage to a data set, and a disk that is full: each flipped bit and cut file is found and mended, and a full disk loses nothing.

    python -m beambench.benchmarks.checks.data_set_damage --tries 200
    python -m beambench.benchmarks.checks.data_set_damage --tries 0 --disk FOLDER    # a small file system, such as a tmpfs

A data set is made by the command. Each try flips one bit of one of its files, or cuts it off, the file by chance: `verify` must
name it, and `repair`, which makes captures again, must give the very bytes that were there. With `--disk` the data set is made
there, and must stop with exit code 2; a file is then removed, and `--resume` must give the same bytes as elsewhere.
"""

from __future__ import annotations

import argparse
import json
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from .attempts import Attempts, print_attempts
from .data_set_kills import shards_of, words_for

__all__ = ["damaged_tries", "full_disk", "main"]


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the campaign and print its table. Returns 1 where an attempt failed."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--tries", type=int, default=200)
    parser.add_argument("--shards", type=int, default=6)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--disk", type=Path, default=None)
    given = parser.parse_args(arguments)
    with tempfile.TemporaryDirectory(prefix="beambench-damage-") as place:
        base = Path(place)
        file = base / "set.json"
        file.write_text(json.dumps(shards_of(given.shards)))
        subprocess.run(words_for(file, base / "whole", "--workers", "1"), check=True, capture_output=True)
        parts = [damaged_tries(base / "whole", base / "work", given.tries, given.seed)] if given.tries else []
        if given.disk is not None:
            parts.append(full_disk(file, base / "whole", given.disk))
    return print_attempts(parts)


def damaged_tries(whole: Path, work: Path, tries: int, seed: int) -> Attempts:
    """An attempt for each flipped bit or cut file of a copy, `work`, of the data set `whole`."""
    part = Attempts("flipped bits and cut files of a data set")
    rng = np.random.default_rng(seed)
    files = sorted(path.relative_to(whole) for path in whole.rglob("*") if path.is_file())
    shutil.copytree(whole, work)
    for _ in range(tries):
        name = files[int(rng.integers(len(files)))]
        content = bytearray((whole / name).read_bytes())
        if rng.random() < 0.5:
            content[int(rng.integers(len(content)))] ^= 1 << int(rng.integers(8))
        else:
            content = content[: int(rng.integers(len(content)))]
        (work / name).write_bytes(content)
        problem = _mended(whole, work, name, files)
        if problem:
            part.failed(f"{name}: {problem}")
            shutil.rmtree(work)
            shutil.copytree(whole, work)
        else:
            part.held("flipped" if len(content) == (whole / name).stat().st_size else "cut")
    return part


def _mended(whole: Path, work: Path, name: Path, files: Sequence[Path]) -> str:
    """Why a damaged file was not found, or not mended; "" where it was both."""
    from ...captures import repair, verify
    from ..datasets.generate import maker_of

    if str(name) not in {one.file for one in verify(work)}:
        return "not found"
    done = repair(work, make=maker_of(work))
    if done.dropped:
        return f"dropped {done.dropped}: {done.not_remade}"
    differ = [str(one) for one in files if (work / one).read_bytes() != (whole / one).read_bytes()]
    return f"mended otherwise: {differ}" if differ else ""


def full_disk(file: Path, whole: Path, disk: Path) -> Attempts:
    """The data set of `whole` on a file system that is too small, until a file there is removed."""
    part = Attempts("a data set on a full disk")
    room = disk / "room"
    size = sum(path.stat().st_size for path in whole.rglob("*") if path.is_file())
    free = shutil.disk_usage(disk).free
    # What a plan would refuse is not tried: the disk must fill up while shards are written.
    room.write_bytes(b"\0" * max(0, free - size))
    words = words_for(file, disk / "set", "--workers", "1")
    filler = disk / "filler"
    with subprocess.Popen(words, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True) as process:
        while process.poll() is None and not list((disk / "set.partial" / "receipts").glob("*.z")):
            time.sleep(0.02)
        filler.write_bytes(b"\0" * max(0, shutil.disk_usage(disk).free - 4096))
        _, said = process.communicate()
    if process.returncode != 2 or "Traceback" in said:
        part.failed(f"exit {process.returncode}: {said[-300:]}")
    else:
        part.held("stopped with exit code 2")
    for one in (filler, room):
        one.unlink()
    done = subprocess.run(words, capture_output=True, text=True, check=False)
    names = [path.relative_to(whole) for path in whole.rglob("*") if path.is_file()]
    differ = [
        str(one) for one in names if done.returncode or (disk / "set" / one).read_bytes() != (whole / one).read_bytes()
    ]
    if differ:
        part.failed(f"after --resume: exit {done.returncode}, {differ[:3]} {done.stderr[-300:]}")
    else:
        part.held("resumed to the same bytes")
    shutil.rmtree(disk / "set", ignore_errors=True)
    return part


if __name__ == "__main__":
    sys.exit(main())
