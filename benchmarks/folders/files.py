"""Atomic files: written under another name, synced, then renamed, so that a file is complete or absent."""

from __future__ import annotations

import json
import os
from collections.abc import Callable
from pathlib import Path
from typing import Any

from ...scenes.errors import InputError, reason

__all__ = ["write_atomic", "write_json", "write_text"]


def write_atomic(path: Path, write: Callable[[Path], None]) -> None:
    """Call `write` on `<path>.partial`, sync it, and rename it to `path`. If this fails neither file is left.

    Raises:
        InputError: the file cannot be written, or the disk is full.
    """
    partial = path.with_name(path.name + ".partial")
    try:
        write(partial)
        with open(partial, "rb+") as file:
            os.fsync(file.fileno())
        os.replace(partial, path)
        folder = os.open(path.parent, os.O_RDONLY)
        try:
            os.fsync(folder)
        finally:
            os.close(folder)
    except OSError as error:
        partial.unlink(missing_ok=True)
        raise InputError(
            "The file cannot be written.",
            where=str(path),
            value=reason(error),
            next_step="choose another --out, or free space on the disk",
        ) from error
    except BaseException:
        partial.unlink(missing_ok=True)
        raise


def write_bytes(path: Path, data: bytes) -> None:
    """Write bytes, atomically."""

    def write(partial: Path) -> None:
        partial.write_bytes(data)

    write_atomic(path, write)


def write_text(path: Path, text: str) -> None:
    """Write UTF-8 text, atomically; lone surrogates, which it does not have, as backslash escapes (which JSON reads again)."""
    write_bytes(path, text.encode("utf-8", "backslashreplace"))


def write_json(path: Path, data: Any) -> None:
    """Write JSON with sorted keys, atomically. NaN raises ValueError."""
    write_text(path, json.dumps(data, indent=2, sort_keys=True, allow_nan=False, ensure_ascii=False) + "\n")
