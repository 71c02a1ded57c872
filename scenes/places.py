"""Names of files and folders to write: a path is a path, and a URL is not one."""

from __future__ import annotations

import re
from pathlib import Path

from .errors import InputError, reason

__all__ = ["local_path"]


def local_path(name: str | Path, where: str = "--out") -> Path:
    """The path of an output, "~" replaced.

    Raises:
        InputError: a URL, which would become a local folder of that name; a null byte; no such home.
    """
    text = str(name)
    # A Path of a URL has lost one of its slashes.
    if re.match(r"[A-Za-z][A-Za-z0-9+.-]+:/(/|$)", text) or (
        isinstance(name, Path) and re.match(r"(https?|s3|gs|gcs|az|abfs|file|ftp|memory):/", text)
    ):
        raise InputError(
            "An output is written to this machine's disks, not to a URL.", where=where, value=text,
            allowed="a path", next_step="write it to a folder, and copy the folder",
        )  # fmt: skip
    try:
        if "\0" in text:
            raise ValueError("it holds a null byte")
        return Path(text).expanduser()
    except (ValueError, RuntimeError) as error:
        raise InputError(
            "This cannot be the name of an output.", where=where, value=text, allowed=reason(error)
        ) from error
