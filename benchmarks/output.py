"""The folder of a run: refuse, resume or replace what is there, and remember finished work line by line."""

from __future__ import annotations

import json
import math
import os
import shutil
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from ..scenes.errors import InputError

__all__ = ["Journal", "default_folder", "prepare_folder", "without_nan"]

#: What a run writes, and what `overwrite` may therefore remove. Other files in the folder stay.
_OURS = (
    "captures", "pictures", "run.json", "scores.csv", "scores.parquet", "accuracy.csv", "summary.csv", "report.html",
    "speed-accuracy.png", "speed-accuracy.svg", "journal.jsonl", "breakdown.csv", "failure_map.csv", "maps", "costs.csv",
    "errors_by_tile.npz", "ranking.csv", "pairs.csv", "profiles.csv",
)  # fmt: skip


def default_folder(name: str) -> Path:
    """./beambench-runs/<name>-<local time>, with a number behind it where that exists."""
    from datetime import datetime

    base = Path("beambench-runs") / f"{name}-{datetime.now():%Y%m%d-%H%M%S}"
    number, folder = 2, base
    while folder.exists():
        folder, number = base.with_name(f"{base.name}-{number}"), number + 1
    return folder


def prepare_folder(folder: Path, suite_hash: str, *, resume: bool, overwrite: bool) -> None:
    """Make the folder of a run ready to be written.

    Raises:
        InputError: it exists with content and neither flag is given, both are, it cannot be written, it is no run
            (overwrite), or it belongs to another suite (resume).
    """
    if resume and overwrite:
        raise InputError("--resume and --overwrite exclude each other.", where="run")
    if folder.exists() and not folder.is_dir():
        raise InputError("The output is a file, not a folder.", where="--out", value=str(folder))
    held = sorted(path.name for path in folder.iterdir()) if folder.is_dir() else []
    if held and not (resume or overwrite):
        raise InputError(
            "The output folder is not empty.",
            where="--out",
            value=str(folder),
            next_step="--resume to finish it, --overwrite to replace it, or another --out",
        )
    if held and not {"run.json", "journal.jsonl"} & set(held):
        raise InputError(
            "The output folder holds something that is no run.",
            where="--out",
            value=str(folder),
            allowed="a run's folder",
        )
    if held and resume and (found := Journal.hash_in(folder)) != suite_hash:
        raise InputError(
            "The folder holds a run of another suite, or of other settings.",
            where="--resume",
            value=found,
            allowed=suite_hash,
            next_step="--overwrite, or another --out",
        )
    try:
        if overwrite:
            for name in _OURS:
                path = folder / name
                if path.is_dir() and not path.is_symlink():
                    shutil.rmtree(path)
                else:
                    path.unlink(missing_ok=True)
        for part in ("captures", "pictures"):
            (folder / part).mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise InputError(
            "The output folder cannot be written.",
            where="--out",
            value=f"{folder}: {error.strerror}",
            next_step="choose another place with --out",
        ) from error


class Journal:
    """journal.jsonl: one line per finished (capture, estimator, condition), so that a broken run can be resumed.

    Only results with status "ok" are taken up again: a failure is tried anew.
    """

    def __init__(self, folder: Path, suite_hash: str) -> None:
        self.path = folder / "journal.jsonl"
        self.done: dict[tuple[str, ...], list[dict[str, Any]]] = {}
        self.beside: dict[tuple[str, ...], dict[str, Any]] = {}
        if self.path.is_file():
            text = self.path.read_text(encoding="utf-8")
            if not text.endswith("\n"):  # a torn line must not swallow the next one
                with open(self.path, "a", encoding="utf-8") as file:
                    file.write("\n")
            for line in text.splitlines()[1:]:
                try:
                    entry = json.loads(line)
                    key, rows = tuple(map(str, entry["key"])), entry["rows"]
                except (ValueError, KeyError, TypeError):
                    continue  # the last line of an interrupted write
                self.done[key] = [_with_nan(row) for row in rows]
                self.beside[key] = entry.get("beside") or {}
        else:
            self._append({"suite_hash": suite_hash})

    @staticmethod
    def hash_in(folder: Path) -> str:
        """The suite hash of the run in a folder, or ""."""
        try:
            with open(folder / "journal.jsonl", encoding="utf-8") as file:
                return str(json.loads(file.readline()).get("suite_hash", ""))
        except (OSError, ValueError, AttributeError):
            return ""

    def _append(self, entry: dict[str, Any]) -> None:
        try:
            with open(self.path, "a", encoding="utf-8") as file:
                file.write(json.dumps(entry, allow_nan=False) + "\n")
                file.flush()
                os.fsync(file.fileno())
        except OSError as error:
            raise InputError(
                "The output folder cannot be written.",
                where=str(self.path),
                value=error.strerror,
                next_step="make room, then repeat with --resume",
            ) from error

    def add(self, key: tuple[str, ...], rows: list[dict[str, Any]], **beside: Any) -> None:
        """Note finished work: rows of the score table, and plain data beside them. NaN of a row travels as null: JSON
        has none."""
        if all(row["status"] == "ok" for row in rows):
            self._append({"key": list(key), "rows": [without_nan(row) for row in rows], "beside": beside})


def without_nan(row: Mapping[str, Any]) -> dict[str, Any]:
    """A row as JSON can hold it: what is no finite number becomes None."""
    return {name: None if isinstance(v, float) and not math.isfinite(v) else v for name, v in row.items()}


def _with_nan(row: Mapping[str, Any]) -> dict[str, Any]:
    return {name: math.nan if value is None else value for name, value in row.items()}
