"""The journal of a run: what a line says is taken over as it was written, or the work is repeated."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from beambench.benchmarks.folders.journal import Journal

ROWS = {("object1", str(seed), "poisson-ml", "matched"): [{"status": "ok", "rmse": 0.001 * seed, "z_rms": float("nan"), "n": 4096}]
        for seed in range(4)}  # fmt: skip


def _written(folder: Path) -> bytes:
    journal = Journal(folder, "hash", rtol=0.01)
    for key, rows in ROWS.items():
        journal.add(key, rows, picture={"scene": key[0]})
    return (folder / "journal.jsonl").read_bytes()


def _same(found: dict[tuple[str, ...], list[dict[str, object]]]) -> bool:
    return all(key in ROWS and json.dumps(rows) == json.dumps(ROWS[key]) for key, rows in found.items())


def test_what_was_written_is_read(tmp_path: Path) -> None:
    _written(tmp_path)
    again = Journal(tmp_path, "hash", rtol=0.01)
    assert again.done.keys() == ROWS.keys() and _same(again.done)
    assert all(beside["picture"] == {"scene": "object1"} for beside in again.beside.values())


def test_no_flipped_bit_changes_a_number(tmp_path: Path) -> None:
    whole, rng, kept = _written(tmp_path), np.random.default_rng(3), 0
    first = whole.index(b"\n") + 1
    for place in rng.integers(8 * first, 8 * len(whole), 400):
        flipped = bytearray(whole)
        flipped[place // 8] ^= 1 << int(place) % 8
        (tmp_path / "journal.jsonl").write_bytes(flipped)
        found = Journal(tmp_path, "hash", rtol=0.01).done
        assert _same(found) and len(found) >= 2
        kept += len(found)
    assert kept >= 400 * 2.9  # a flip costs the line that it hits, and a lost line end the next one too


@pytest.mark.parametrize("line", ["[" * 60_000, '{"key": ["a"]}', "\x00", "{}", '{"key": 1, "rows": 2}'])
def test_a_foreign_line_is_passed_over(line: str, tmp_path: Path) -> None:
    whole = _written(tmp_path)
    (tmp_path / "journal.jsonl").write_bytes(whole + line.encode() + b"\n")
    assert _same(Journal(tmp_path, "hash", rtol=0.01).done)


def test_a_journal_of_an_earlier_version_is_taken_over(tmp_path: Path) -> None:
    lines = [json.dumps({"suite_hash": "hash", "rtol": 0.01})]
    lines += [
        json.dumps({"key": list(key), "rows": [{**rows[0], "z_rms": None}], "beside": {}}) for key, rows in ROWS.items()
    ]
    (tmp_path / "journal.jsonl").write_text("\n".join(lines) + "\n")
    found = Journal(tmp_path, "hash", rtol=0.01).done
    assert found.keys() == ROWS.keys() and _same(found)
