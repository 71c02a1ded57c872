"""Folders of results for tests: made from a table of files, and read back whole."""

from __future__ import annotations

import json
from pathlib import Path


def tree(folder: Path) -> dict[str, bytes]:
    return {str(path.relative_to(folder)): path.read_bytes() for path in sorted(folder.rglob("*")) if path.is_file()}


def plant(folder: Path, files: dict[str, str]) -> dict[str, bytes]:
    folder.mkdir(parents=True, exist_ok=True)
    for name, text in files.items():
        path = folder / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text)
    return tree(folder)


def a_run(folder: Path, verb: str = "run") -> dict[str, bytes]:
    """An earlier run with a file of the user's in it."""
    header = json.dumps({"suite_hash": "h", "verb": verb})
    return plant(
        folder,
        {"run.json": json.dumps({"verb": verb}), "journal.jsonl": header + "\n", "scores.csv": "old", "mine.txt": "x",
         "pictures/a__b.npz": "old", "pictures/my.png": "x", "breakdown.csv": "old"},
    )  # fmt: skip
