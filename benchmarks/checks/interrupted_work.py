"""What the campaigns of kills and faults interrupt: commands that write, what must hold after each, and how they are finished."""

from __future__ import annotations

import csv
import hashlib
import json
import os
import shutil
import subprocess
import sys
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from .example_modalities import IMAGING

__all__ = ["OF_THE_MACHINE", "WORKS", "Work", "small_suite"]

_SMALL = ["--set", "rig.camera.rows=4", "--set", "rig.camera.cols=4"]
_SUITE = {
    "schema_version": 1, "suite": "small", "version": 1, "title": "small", "conditions": ["matched"],
    "scenes": [{"scene": "flat-wall", "overrides": {"rig.camera.rows": 4, "rig.camera.cols": 4}}],
    "estimators": ["peak", "weighted-average"], "fidelity": "direct", "rtol": 1e-3, "seeds": {"dev": [1], "test": [2]},
    "stresses": [{"axis": "photons", "values": [1000.0, 10.0]}],
}  # fmt: skip
#: Columns of scores.csv that no two runs have in common.
OF_THE_MACHINE = ("cpu_s", "wall_s", "throughput", "peak_bytes")


@dataclass(frozen=True)
class Work:
    """A command that writes.

    Main arguments:
        prepare: makes its input in a folder. words: of the command, run there. again: commands that finish it after a stop, in this
            order until one ends with 0. result: what the finished work is known by, "" where there is none.
    Other arguments:
        first_thread: whether it starts threads and programs that are not traced (`run_traced`). weight: share of the attempts.
    """

    prepare: Callable[[Path], None]
    words: Callable[[Path], list[str]]
    again: Callable[[Path], list[list[str]]]
    result: Callable[[Path], str]
    first_thread: bool = False
    weight: int = 4


def tree(folder: Path, *, without: tuple[str, ...] = ()) -> str:
    """A hash of the names and bytes of all files of a folder, "" where there is none."""
    files = sorted(path for path in folder.rglob("*") if path.is_file() and path.name not in without)
    if not files:
        return ""
    digest = hashlib.sha256()
    for path in files:
        digest.update(f"{path.relative_to(folder)}\n".encode() + hashlib.sha256(path.read_bytes()).digest())
    return digest.hexdigest()


def _store(folder: Path, seeds: range, name: str = "s.zarr") -> Path:
    from ...captures import write
    from ...captures.example import example_capture

    return write(folder / name, [example_capture(IMAGING, seed=seed, optional=False) for seed in seeds])


def _damaged(folder: Path) -> None:
    store = _store(folder, range(3))
    file = store / "counts" / "c.1.0.0.0"
    content = bytearray(file.read_bytes())
    content[len(content) // 2] ^= 1
    file.write_bytes(content)
    (store / "zarr.json").write_bytes(b"{}")


def _partial(folder: Path) -> None:
    from ...captures import CaptureWriter
    from ...captures.example import example_capture

    writer = CaptureWriter(folder / "s.zarr", overwrite=True)
    for seed in range(3):
        writer.append(example_capture(IMAGING, seed=seed, optional=False))
    writer.abandon()


def _over_old(folder: Path) -> None:
    _store(folder, range(5, 8))
    _partial(folder)


def _scored(folder: Path) -> None:
    """A store, estimates of it, and earlier scores that are to be replaced."""
    import numpy as np

    from ...captures import open_captures
    from ...captures.estimates import Estimates, write_estimates
    from ..folders.files import write_text
    from ..scores.score import COLUMNS

    environment = os.environ | {"PYTHONPATH": os.pathsep.join(path or os.getcwd() for path in sys.path)}
    subprocess.run(
        [sys.executable, "-m", "beambench", *_generate(folder)], check=True, env=environment, capture_output=True
    )
    captures = open_captures(folder / "s.zarr")
    shape = (4, 4)
    one: dict[str, Any] = {"range": np.full(shape, 2.0), "sigma": np.full(shape, 0.1), "valid": np.ones(shape, bool)}
    n = len(captures)
    spent, size = [0.1] * n, [1.0] * n
    estimates = Estimates("peak", IMAGING, [one] * n, spent, spent, size, ["ok"] * n, captures.sha256)
    write_estimates(folder / "peak.h5", estimates)
    (folder / "out").mkdir()
    write_text(folder / "out" / "scores.csv", ",".join(COLUMNS) + "\n")
    write_text(folder / "out" / "report.html", "old")
    (folder / "out" / "mine.txt").write_text("mine")


def small_suite() -> dict[str, Any]:
    """A suite of three captures of 4 × 4 pixels."""
    return dict(_SUITE)


def _suite(folder: Path) -> None:
    (folder / "suite.json").write_text(json.dumps(_SUITE))


def _nothing(folder: Path) -> None:
    pass


def _old_captures(folder: Path) -> None:
    _store(folder, range(2))


def _generate(folder: Path, *more: str) -> list[str]:
    seeds = [word for seed in (1, 2, 3) for word in ("--seeds", str(seed))]
    return ["generate", "flat-wall", *seeds, *_SMALL, "--out", str(folder / "s.zarr"), *more]


def _run(folder: Path, verb: str, *more: str) -> list[str]:
    return [verb, str(folder / "suite.json"), "--out", str(folder / "out"), "--no-report", *more]


def _whole_store(folder: Path) -> str:
    return tree(folder / "s.zarr")


def _tables(*names: str) -> Callable[[Path], str]:
    """The tables that do not depend on times."""

    def result(folder: Path) -> str:
        found = [folder / "out" / name for name in names]
        return "".join(hashlib.sha256(path.read_bytes()).hexdigest() if path.is_file() else "" for path in found)

    return result


def _scored_rows(folder: Path) -> str:
    """The tables of a run that do not depend on times, and each row of scores.csv without its times and memory."""
    tables = _tables("accuracy.csv", "inputs.csv", "profiles.csv", "mine.txt")(folder)
    file = folder / "out" / "scores.csv"
    if not tables or not file.is_file():
        return ""
    with open(file, encoding="utf-8", newline="") as lines:
        rows = [{key: row[key] for key in row if key not in OF_THE_MACHINE} for row in csv.DictReader(lines)]
    return tables + hashlib.sha256(json.dumps(rows).encode()).hexdigest()


def _score(folder: Path, *more: str) -> list[str]:
    return ["score", str(folder / "s.zarr"), str(folder / "peak.h5"), "--out", str(folder / "out"), *more]


def _copy_of_run(folder: Path) -> None:
    """A small folder of a finished run, to be replaced."""
    from .fuzz_subjects import SUBJECTS

    _suite(folder)
    (folder / "out").mkdir()
    SUBJECTS["folders of runs"].make(folder / "out")
    (folder / "out" / "mine.txt").write_text("mine")
    shutil.copy(folder / "suite.json", folder / "out" / "mine.json")


WORKS: dict[str, Work] = {
    "generate --overwrite": Work(
        _old_captures,
        lambda folder: _generate(folder, "--overwrite"),
        lambda folder: [_generate(folder, "--overwrite")],
        _whole_store,
        first_thread=True,
        weight=3,
    ),
    "generate --resume": Work(
        _nothing,
        _generate,
        lambda folder: [_generate(folder, "--resume"), _generate(folder)],
        _whole_store,
        first_thread=True,
        weight=3,
    ),
    "data repair": Work(
        _damaged,
        lambda folder: ["data", "repair", str(folder / "s.zarr")],
        lambda folder: [
            ["data", "repair", str(folder / "s.zarr")],
            ["data", "finalize", str(folder / "s.zarr"), "--overwrite"],
        ],
        _whole_store,
        weight=6,
    ),
    "data finalize --overwrite": Work(
        _over_old,
        lambda folder: ["data", "finalize", str(folder / "s.zarr"), "--overwrite"],
        lambda folder: [
            ["data", "finalize", str(folder / "s.zarr"), "--overwrite"],
            ["data", "status", str(folder / "s.zarr")],
        ],
        _whole_store,
        weight=6,
    ),
    "score --overwrite (exchange)": Work(
        _scored,
        lambda folder: _score(folder, "--overwrite"),
        lambda folder: [_score(folder, "--overwrite"), _score(folder)],
        _tables("scores.csv", "accuracy.csv", "summary.csv", "mine.txt"),
        weight=6,
    ),
    "run --resume": Work(
        _suite,
        lambda folder: _run(folder, "run"),
        lambda folder: [_run(folder, "run", "--resume"), _run(folder, "run", "--overwrite"), _run(folder, "run")],
        _scored_rows,
        first_thread=True,
        weight=2,
    ),
    "run --overwrite (exchange)": Work(
        _copy_of_run,
        lambda folder: _run(folder, "run", "--overwrite"),
        lambda folder: [_run(folder, "run", "--overwrite"), _run(folder, "run")],
        _scored_rows,
        first_thread=True,
        weight=2,
    ),
    "sweep --resume": Work(
        _suite,
        lambda folder: _run(folder, "sweep", "--budget", "3"),
        lambda folder: [
            _run(folder, "sweep", "--budget", "3", "--resume"),
            _run(folder, "sweep", "--budget", "3", "--overwrite"),
            _run(folder, "sweep", "--budget", "3"),
        ],
        _tables("breakdown.csv", "failure_map.csv"),
        first_thread=True,
        weight=1,
    ),
}
