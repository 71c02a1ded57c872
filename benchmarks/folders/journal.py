"""The folder of a run: its default name, and the journal that records finished work line by line."""

from __future__ import annotations

import hashlib
import json
import math
import os
import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from ...scenes.errors import InputError
from ...scenes.json_keys import read_json

__all__ = ["Journal", "default_folder", "with_nan", "without_nan"]


def default_folder(name: str) -> Path:
    """./beambench-runs/<name>-<local time>, followed by a number if that exists."""
    from datetime import datetime

    base = Path("beambench-runs") / f"{name}-{datetime.now():%Y%m%d-%H%M%S}"
    number, folder = 2, base
    while folder.exists():
        folder, number = base.with_name(f"{base.name}-{number}"), number + 1
    return folder


#: The end of a line with a checksum, `sum`: the first 16 digits of the SHA-256 of the line without it.
_SUM = re.compile(r', "sum": "([0-9a-f]{16})"\}$')


def _with_sum(text: str) -> str:
    return f'{text[:-1]}, "sum": "{hashlib.sha256(text.encode()).hexdigest()[:16]}"}}'


def _sound(line: str, must: bool) -> bool:
    """Whether the line is as it was written. Lines of older journals have no sum; where there `must` be one, none is wrong."""
    found = _SUM.search(line)
    if found is None:
        return not must and '"sum"' not in line
    return hashlib.sha256((line[: found.start()] + "}").encode()).hexdigest()[:16] == found[1]


class Journal:
    """journal.jsonl: one line per finished (capture, estimator, condition), so that an interrupted run can be resumed.

    Only results with status "ok" are reused; failures are tried again, and so is work whose line has been altered. The first
    line identifies the run: the hash of its suite, and the other `settings` on which the results depend.
    """

    def __init__(self, folder: Path, suite_hash: str, **settings: Any) -> None:
        self.path = folder / "journal.jsonl"
        self.done: dict[tuple[str, ...], list[dict[str, Any]]] = {}
        self.beside: dict[tuple[str, ...], dict[str, Any]] = {}
        if self.path.is_file():
            text = self.path.read_bytes().decode(errors="replace")
            if not text.endswith("\n"):  # a torn line must not swallow the next one
                with open(self.path, "a", encoding="utf-8") as file:
                    file.write("\n")
            first, *lines = text.split("\n")
            for line in lines:
                if not _sound(line, _SUM.search(first) is not None):
                    continue
                try:
                    entry = read_json(line)
                    key, rows = tuple(map(str, entry["key"])), [with_nan(row) for row in entry["rows"]]
                    beside = dict(entry.get("beside") or {})
                except (ValueError, KeyError, TypeError, AttributeError, RecursionError):
                    continue  # the last line of an interrupted write, or a damaged one: that work is repeated
                if all("status" in row for row in rows):
                    self.done[key], self.beside[key] = rows, beside
        else:
            self._append({"suite_hash": suite_hash, **settings})

    @staticmethod
    def check(folder: Path, suite_hash: str, **settings: Any) -> None:
        """Refuse to resume a run of another suite or other settings. A setting that an older journal does not record is
        not compared.

        Raises:
            InputError: the journal is that of another run, or cannot be read.
        """
        found: Any = {}
        try:
            with open(folder / "journal.jsonl", encoding="utf-8") as file:
                found = read_json(file.readline())
        except (OSError, ValueError, RecursionError):
            pass
        found = found if isinstance(found, dict) else {}
        if (other := str(found.get("suite_hash", ""))) != suite_hash:
            raise InputError(
                "The folder contains a run of another suite, or with other settings.",
                where="--resume",
                value=other,
                allowed=suite_hash,
                next_step="add --overwrite, or choose another --out",
            )
        for name, value in settings.items():
            if name in found and found[name] != value:
                raise InputError(
                    f"The folder contains a run with another {name}.",
                    where="--resume",
                    value=value,
                    allowed=str(found[name]),
                    next_step="add --overwrite, or choose another --out",
                )

    def _append(self, entry: dict[str, Any]) -> None:
        try:
            with open(self.path, "a", encoding="utf-8") as file:
                file.write(_with_sum(json.dumps(entry, allow_nan=False)) + "\n")
                file.flush()
                os.fsync(file.fileno())
        except OSError as error:
            raise InputError(
                "The output folder cannot be written.",
                where=str(self.path),
                value=error.strerror,
                next_step="free space on the disk, then repeat with --resume",
            ) from error

    def add(self, key: tuple[str, ...], rows: list[dict[str, Any]], **beside: Any) -> None:
        """Record finished work: rows of the score table, and further plain data. NaN is written as null, since JSON has
        no NaN."""
        if all(row["status"] == "ok" for row in rows):
            self._append({"key": list(key), "rows": [without_nan(row) for row in rows], "beside": beside})


def without_nan(row: Mapping[str, Any]) -> dict[str, Any]:
    """A row for JSON: numbers that are not finite become None."""
    return {name: None if isinstance(v, float) and not math.isfinite(v) else v for name, v in row.items()}


def with_nan(row: Mapping[str, Any]) -> dict[str, Any]:
    """A row from JSON: None becomes NaN."""
    return {name: math.nan if value is None else value for name, value in row.items()}
