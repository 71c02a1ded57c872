"""Flipped bits: one bit of one file of a store, an unfinished store, a journal, a cache or a folder of results is changed.

    python -m beambench.benchmarks.checks.flips --count 1400 --seed 1

A flip of a store holds if `verify` names it, no reading gives other numbers, and `repair` leaves a sound store that has lost
at most the capture of the flipped chunk (none for a flip of metadata); one of a data set, if `verify` names it and every file is
again what it was, captures made again. A flip of an unfinished store holds if `finalize` or `repair` gives a sound store of
captures that were written. One of a journal or a cache holds if nothing is taken from it but what was written; one of a folder of
results, if every reader ends with a result or a clear error.
"""

from __future__ import annotations

import argparse
import shutil
import sys
import tempfile
import warnings
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from ...scenes.errors import InputError
from .attempts import Attempts, peak_memory, print_attempts
from .fuzz_subjects import SUBJECTS

__all__ = ["flips", "main"]


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the campaign and print its table. Returns 1 where an attempt failed."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--count", type=int, default=1400)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--only", default="", help="part of the name of a part")
    given = parser.parse_args(arguments)
    warnings.simplefilter("ignore")
    return print_attempts(flips(given.count, given.seed, given.only))


def flips(count: int, seed: int = 1, only: str = "") -> list[Attempts]:
    """`count` flips, divided by weight among the parts whose names contain `only`."""
    parts = {name: part for name, part in _PARTS.items() if only in name}
    total = sum(weight for _, _, weight in parts.values())
    done = []
    for name, (subject, judge, weight) in parts.items():
        rng = np.random.default_rng([seed, *name.encode()])
        done.append(_part(name, subject, judge, max(1, round(count * weight / total)), rng))
    return done


Judge = Callable[[Path, Path, Path], str]
"""(the folder before, the folder after, the flipped file) -> what became of it; raises AssertionError where it did not hold."""


def _part(name: str, subject: str, judge: Judge, count: int, rng: np.random.Generator) -> Attempts:
    part = Attempts(name)
    with tempfile.TemporaryDirectory(prefix="beambench-flips-") as place:
        sound, work = Path(place) / "sound", Path(place) / "work"
        sound.mkdir()
        SUBJECTS[subject].make(sound)
        files = sorted(path for path in sound.rglob("*") if path.is_file() and path.stat().st_size)
        for number in range(count):
            # Every file in turn, and every second time one by its size.
            sizes = np.array([path.stat().st_size for path in files], float)
            chosen = files[
                number // 2 % len(files) if number % 2 else int(rng.choice(len(files), p=sizes / sizes.sum()))
            ]
            shutil.copytree(sound, work)
            target = work / chosen.relative_to(sound)
            content = bytearray(target.read_bytes())
            bit = int(rng.integers(8 * len(content)))
            content[bit // 8] ^= 1 << bit % 8
            target.write_bytes(content)
            where = f"{chosen.relative_to(sound)}, bit {bit}"
            try:
                part.held(judge(sound, work, target))
            except AssertionError as error:
                part.failed(f"{where}: {error}")
            except Exception as error:
                part.failed(f"{where}: {type(error).__name__}: {str(error)[:150]}")
            part.used(peak_memory())
            shutil.rmtree(work)
    return part


def _loaded(store: Path) -> list[Any]:
    from ...captures import open_captures

    return [capture.load() for capture in open_captures(store)]


def _store(sound: Path, work: Path, target: Path) -> str:
    from ...captures import repair, verify

    before, store = _loaded(sound / "s.zarr"), work / "s.zarr"
    names = [damage.file for damage in verify(store)]
    assert str(target.relative_to(store)) in names, f"verify names {names}"
    try:
        read = _loaded(store)
        assert target.name == "record.jsonl" and all(a.identical(b) for a, b in zip(read, before, strict=True)), (
            "it was read"
        )
    except InputError:
        pass
    recovery = repair(store)
    assert verify(store) == [], "it is not sound after the repair"
    after = _loaded(store)
    chunk = target.name.startswith("c.")
    assert len(recovery.dropped) == chunk, f"the repair dropped {recovery.dropped}"
    kept = [capture for number, capture in enumerate(before) if number not in recovery.dropped]
    assert len(after) == len(kept) and all(a.identical(b) for a, b in zip(after, kept, strict=True)), "other captures"
    return "captures dropped" if chunk else "written again"


def _data_set(sound: Path, work: Path, target: Path) -> str:
    from ...captures import repair, verify

    before, store = _loaded(sound / "s"), work / "s"
    names = [damage.file for damage in verify(store)]
    assert str(target.relative_to(store)) in names, f"verify names {names}"
    chunk = target.name.startswith("c.")
    if not chunk:
        restored = repair(store)
        assert not restored.dropped, "captures dropped for a flip of metadata"
        note = "written again"
    else:
        remade = repair(store, make=lambda attrs, where: before[int(where.rpartition(" ")[2])])
        assert not remade.dropped, f"the repair dropped {remade.dropped}"
        note = "made again" if remade.remade else "written again"
    assert verify(store) == [], "it is not sound after the repair"
    for path in sorted(one for one in (sound / "s").rglob("*") if one.is_file()):
        assert (store / path.relative_to(sound / "s")).read_bytes() == path.read_bytes(), f"{path.name} differs"
    return note


def _unfinished(sound: Path, work: Path, target: Path) -> str:
    from ...captures import finalize, repair, verify

    whole = sound.with_name("whole")
    if not whole.exists():
        shutil.copytree(sound, whole)
        finalize(whole / "s.zarr")
    written = _loaded(whole / "s.zarr")
    try:
        finalize(work / "s.zarr")
        note = "finalized"
    except InputError:
        try:
            repair(work / "s.zarr.partial")
            note = "repaired"
        except InputError:
            assert not (work / "s.zarr").exists(), "refused, and half done"
            return "refused"
    assert verify(work / "s.zarr") == [], "it is not sound"
    for capture in _loaded(work / "s.zarr"):
        assert any(capture.identical(one) for one in written), "a capture that was never written"
    return note


def _journal(sound: Path, work: Path, target: Path) -> str:
    from ..folders.journal import Journal

    before, after = (Journal(folder, "h", verb="run").done for folder in (sound, work))
    for key, rows in after.items():
        assert repr(rows) == repr(before.get(key)), f"{key} is taken over with other numbers"
    return "all taken over" if len(after) == len(before) else "work repeated"


def _cache(sound: Path, work: Path, target: Path) -> str:
    from ..runner.result_cache import ResultCache
    from .fuzz_subjects import job_of

    job, chosen = job_of(work)
    before, after = (ResultCache(folder / "kept").get(job, chosen) for folder in (sound, work))
    assert before is not None
    if after is None:
        return "measured again"
    same = all((before.arrays[name] == after.arrays[name]).all() for name in before.arrays)
    costs = [(one.cpu_s, one.wall_s, one.peak_bytes) for one in (before, after)]
    assert same and costs[0] == costs[1], "other numbers were taken over"
    return "the same numbers"


def _results(sound: Path, work: Path, target: Path) -> str:
    try:
        SUBJECTS["folders of runs"].read(work)
    except InputError:
        return "refused"
    return "read"


def _journal_folder(sound: Path, work: Path, target: Path) -> str:
    return _journal(sound, work, target) if target.name == "journal.jsonl" else _results(sound, work, target)


_PARTS: dict[str, tuple[str, Judge, int]] = {
    "stores": ("stores, bytes", _store, 4),
    "data sets": ("data sets, bytes", _data_set, 4),
    "unfinished stores": ("unfinished stores", _unfinished, 2),
    "journals of runs": ("journals of runs", _journal, 3),
    "caches": ("caches", _cache, 3),
    "folders of results": ("folders of runs", _journal_folder, 3),
}


if __name__ == "__main__":
    sys.exit(main())
