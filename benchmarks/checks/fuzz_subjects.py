"""What the campaign of fuzzed inputs reads: for each kind of file one sound example, and the readers that a verb uses on it."""

from __future__ import annotations

import hashlib
import json
import os
import shutil
from pathlib import Path
from typing import Any

import numpy as np

from .example_modalities import IMAGING, SMALL
from .fuzz_shards import SHARDED
from .fuzz_specs import SPECS, Subject, all_tried, any_file, json_file
from .mutations import json_mutated, mutated

__all__ = ["SUBJECTS", "Subject", "job_of", "reseal"]


# ---------------------------------------------------------------- stores and estimates


def _store(folder: Path) -> None:
    from ...captures import write
    from ...captures.example import example_capture

    write(folder / "s.zarr", [example_capture(SMALL, seed=seed, optional=False) for seed in range(2)])


def reseal(store: Path) -> None:
    """Give altered metadata their checksums, as a hostile writer would."""
    manifest = json.loads((store / "manifest.json").read_bytes())
    for name in manifest["metadata"] if isinstance(manifest.get("metadata"), dict) else []:
        path = store / name
        if path.is_file():
            manifest["metadata"][name] = hashlib.sha256(path.read_bytes()).hexdigest()
    chunks = manifest.get("chunks")
    for array, marks in chunks.items() if isinstance(chunks, dict) else []:
        for key, mark in marks.items() if isinstance(marks, dict) else []:
            path = store / str(array) / str(key)
            if isinstance(mark, list) and len(mark) == 2 and ".." not in str(path) and path.is_file():
                mark[:] = [path.stat().st_size, hashlib.sha256(path.read_bytes()).hexdigest()]
    if (store / "record.jsonl").is_file():
        manifest["record"] = hashlib.sha256((store / "record.jsonl").read_bytes()).hexdigest()
    text = json.dumps(manifest).encode()
    (store / "manifest.json").write_bytes(text)
    (store / "manifest.sha256").write_text(hashlib.sha256(text).hexdigest() + "\n")


def _hostile_store(folder: Path, rng: np.random.Generator) -> None:
    """Change values of the metadata, the manifest or chunks, and seal the store again."""
    import google_crc32c

    store = folder / "s.zarr"
    names = ["zarr.json", "manifest.json", *(str(p.relative_to(store)) for p in sorted(store.glob("*/zarr.json")))]
    for _ in range(int(rng.integers(1, 3))):
        if rng.random() < 0.25:
            chunks = sorted(store.glob("*/c.*"))
            path = chunks[int(rng.integers(len(chunks)))]
            body = mutated(path.read_bytes()[:-4], rng)
            path.write_bytes(body + int(google_crc32c.value(body)).to_bytes(4, "little"))
        else:
            path = store / names[int(rng.integers(len(names)))]
            path.write_bytes(json_mutated(path.read_bytes(), rng))
    try:
        reseal(store)
    except (ValueError, TypeError, AttributeError):
        return  # the manifest itself is no object any more


def _read_store(folder: Path) -> None:
    from ...captures import open_captures, repair, verify
    from ...captures.contents import contents
    from ...captures.store.status import status

    store = folder / "s.zarr"
    all_tried(
        lambda: [capture.load() for capture in open_captures(store)],
        lambda: contents(store),
        lambda: status(store),
        lambda: verify(store),
        lambda: repair(store),
    )


def _unfinished(folder: Path) -> None:
    from ...captures import CaptureWriter
    from ...captures.example import example_capture

    writer = CaptureWriter(folder / "s.zarr")
    for seed in range(2):
        writer.append(example_capture(SMALL, seed=seed, optional=False))
    writer.abandon()


def _hostile_journal(folder: Path, rng: np.random.Generator) -> None:
    """Change one line of the journal; with its checksum, or the bytes alone."""
    path = folder / "s.zarr.partial" / "journal.jsonl"
    lines = path.read_bytes().splitlines(keepends=True)
    number = int(rng.integers(len(lines)))
    if rng.random() < 0.7:
        text = json_mutated(lines[number].split(b" ", 1)[1], rng)
        lines[number] = hashlib.sha256(text).hexdigest().encode() + b" " + text + b"\n"
    else:
        lines[number] = mutated(lines[number], rng)
    path.write_bytes(b"".join(lines))


def _read_unfinished(folder: Path) -> None:
    from ...captures import finalize, repair
    from ...captures.store.status import status
    from ...scenes.errors import InputError

    partial = folder / "s.zarr.partial"
    status(folder / "s.zarr")
    try:
        finalize(partial)
    except InputError:
        repair(partial)


def _estimates(folder: Path) -> None:
    from ...captures.estimates import Estimates, write_estimates

    one: dict[str, Any] = {"range": np.full((3, 4), 5.0), "sigma": np.ones((3, 4)), "valid": np.ones((3, 4), bool)}
    write_estimates(
        folder / "peak.h5",
        Estimates("peak", IMAGING, [one, one], [0.1, 0.2], [0.1, 0.2], [1e6, 1e6], ["ok", "ok"], "ab" * 32),
    )


def _read_estimates(folder: Path) -> None:
    from ...captures.estimates import read_estimates

    read_estimates(folder / "peak.h5", 2, {"row": 3, "col": 4}, modality=IMAGING, captures_sha256="ab" * 32)


# ---------------------------------------------------------------- folders of results


def _row(seed: int, estimator: str) -> dict[str, Any]:
    from ..scores.score import COLUMNS

    texts = {
        "suite": "s", "scene": "flat-wall", "stress": "", "stress2": "", "condition": "matched", "stage": "range",
        "estimator": estimator, "params": "", "modality": IMAGING, "quantity": "range", "unit": "m", "bound_kind": "exact",
        "status": "ok",
    }  # fmt: skip
    numbers = dict.fromkeys(COLUMNS, 0.5) | {"level": float("nan"), "level2": float("nan"), "seed": seed, "n": 48}
    return numbers | texts


def _results(folder: Path) -> None:
    from ..folders.files import write_json
    from ..folders.journal import Journal
    from ..runner.costs import COST_COLUMNS, write_costs
    from ..scores.error_tiles import write_tiles
    from ..scores.inputs import INPUT_COLUMNS, write_inputs
    from ..scores.tables import write_tables

    rows = [_row(seed, name) for seed in (1, 2) for name in ("peak", "parabola")]
    write_tables(folder, rows)
    costs = dict.fromkeys(COST_COLUMNS, 0.5) | {"source": "measured", "elements": 12, "calls": 3}
    write_costs(
        folder, [costs | {name: row[name] for name in row if name in costs and name != "cpu_s"} for row in rows]
    )
    key = {name: str(rows[0][name]) for name in INPUT_COLUMNS[:-1]}
    write_inputs(folder, [{**key, "sha256": "ab" * 32}])
    journal = Journal(folder, "h", verb="run")
    for row in rows:
        journal.add(("flat-wall", str(row["seed"]), row["estimator"]), [row])
    write_json(folder / "run.json", {"verb": "run", "hash": "h", "tables_version": 3, "machine": {}, "failures": []})
    tiles = {
        ("flat-wall", "matched", seed, name): (np.ones(64), np.ones(64))
        for seed in (1, 2)
        for name in ("peak", "parabola")
    }
    write_tiles(folder, tiles)
    (folder / "pictures").mkdir()
    shape = (3, 4)
    np.savez_compressed(
        folder / "pictures" / "flat-wall__peak.npz", value=np.ones(shape), truth=np.ones(shape), error=np.zeros(shape),
        valid=np.ones(shape, bool), scene="flat-wall", estimator="peak", condition="matched", quantity="range", unit="m",
    )  # fmt: skip


def _journals(folder: Path) -> None:
    from ..folders.journal import Journal

    journal = Journal(folder, "h", verb="run")
    for seed in range(20):
        journal.add(("flat-wall", str(seed), "peak"), [_row(seed, "peak")])


def _read_journal(folder: Path) -> None:
    from ..folders.journal import Journal

    Journal.check(folder, "h", verb="run")
    Journal(folder, "h", verb="run")


def _read_results(folder: Path) -> None:
    from ..folders.journal import Journal
    from ..folders.kinds import verb_in
    from ..report.compare import compare_tables
    from ..report.data import cells_of, read_run
    from ..report.pairs import pairs_section
    from ..report.pictures import read_pictures
    from ..report.ranking import ranking_section
    from ..runner.costs import read_costs
    from ..scores.error_tiles import read_tiles
    from ..scores.inputs import read_inputs
    from ..scores.tables import read_scores

    verb_in(folder)
    all_tried(
        lambda: Journal.check(folder, "h", verb="run"),
        lambda: Journal(folder, "h", verb="run"),
        lambda: read_run(folder),
        lambda: cells_of(read_scores(folder / "scores.csv")),
        lambda: cells_of(read_scores(folder / "scores.parquet")),
        lambda: compare_tables(folder, folder),
        lambda: read_tiles(folder),
        lambda: read_pictures(folder / "pictures"),
        lambda: ranking_section(folder),
        lambda: pairs_section(folder),
        lambda: read_costs(folder),
        lambda: read_inputs(folder),
    )


def _read_page(folder: Path) -> None:
    from ..report.page import write_report

    write_report(folder)


def _cache(folder: Path) -> None:
    from ..runner.result_cache import ResultCache

    job, chosen = job_of(folder)
    from ..runner.session import Outcome

    arrays: dict[str, Any] = {
        "range": np.full((3, 4), 5.0),
        "sigma": np.full((3, 4), 0.1),
        "valid": np.ones((3, 4), bool),
    }
    ResultCache(folder / "kept").put(Outcome(job, "ok", arrays, cpu_s=0.1, wall_s=0.2, peak_bytes=300.0), chosen)


def job_of(folder: Path) -> tuple[Any, Any]:
    """A job and an estimator under which the cache beside `folder` holds a result."""
    from ..runner.estimator_labels import check_estimators
    from ..runner.session import Job

    place = folder.parent / "capture-of-the-cache"
    if not place.is_dir():
        place.mkdir()
        np.save(place / "counts.npy", np.ones((2, 3, 4), np.uint16))
        (place / "meta-matched.json").write_text("{}")
    (chosen,) = check_estimators(["peak"])
    return Job(0, place, "matched", IMAGING, {"row": 3, "col": 4}), chosen


def _read_cache(folder: Path) -> None:
    from ..runner.result_cache import ResultCache

    job, chosen = job_of(folder)
    found = ResultCache(folder / "kept").get(job, chosen)
    if found is not None:
        for name in ("range", "sigma"):
            if not np.isfinite(found.arrays[name][found.arrays["valid"]]).all():
                raise AssertionError(f"the cache took {name} that is not finite")


def _plans(folder: Path) -> None:
    from ..folders.exchange import EXCHANGE

    _results(folder)
    plan = {
        "verb": "run",
        "aside": "replaced",
        "old": [["run.json", "replaced/run.json"]],
        "new": [["unfinished/run.json", "run.json"]],
    }
    (folder / EXCHANGE).write_text(json.dumps(plan))
    (folder / "unfinished").mkdir()
    shutil.copy(folder / "run.json", folder / "unfinished" / "run.json")


def _change_plan(folder: Path, rng: np.random.Generator) -> None:
    path = folder / "exchange.json"
    content = path.read_bytes()
    path.write_bytes(json_mutated(content, rng) if rng.random() < 0.7 else mutated(content, rng))


def _read_plan(folder: Path) -> None:
    from ..folders.exchange import finish_exchange
    from ..folders.kinds import RUN

    guard = folder.parent / "guard"
    guard.write_text("mine")
    finish_exchange(folder, RUN)
    if guard.read_text() != "mine" or not os.path.lexists(guard):
        raise AssertionError("a file outside the folder was touched")


SUBJECTS: dict[str, Subject] = {
    **SPECS,
    **SHARDED,
    "stores, bytes": Subject(_store, any_file, _read_store),
    "stores, values under right checksums": Subject(_store, _hostile_store, _read_store),
    "unfinished stores": Subject(_unfinished, _hostile_journal, _read_unfinished),
    "estimates (HDF5)": Subject(_estimates, any_file, _read_estimates),
    "folders of runs": Subject(_results, json_file, _read_results),
    "pages of runs": Subject(_results, json_file, _read_page, weight=0.15),
    "journals of runs": Subject(_journals, any_file, _read_journal),
    "caches": Subject(_cache, any_file, _read_cache),
    "plans of exchanges": Subject(_plans, _change_plan, _read_plan),
}
