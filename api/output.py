"""The place of a verb's output: new by default; an existing output is replaced only on request."""

from __future__ import annotations

import os
from collections.abc import Callable, Sequence
from pathlib import Path

from .scenes.errors import InputError, reason
from .scenes.places import local_path

__all__ = ["check_free", "claim", "default_out", "is_picture", "slug"]


def slug(name: str) -> str:
    """A name as a part of a file name: letters, digits, dot, dash and underscore."""
    from .benchmarks.folders.kinds import slug

    return slug(name)


def default_out(name: str) -> Path:
    """./beambench-runs/<name>-<time>, followed by a number where two commands start in the same second."""
    from .benchmarks.folders.journal import default_folder

    return default_folder(slug(Path(name).stem))


def check_free(out: str | Path | None, *, overwrite: bool) -> None:
    """Refuse an existing output before any work is done for it.

    Main arguments:
        out: The output; None is not checked.
        overwrite: Whether it may be replaced.

    Raises:
        InputError: It exists and may not be replaced.
    """
    if out is not None and not overwrite and os.path.lexists(local_path(out)):
        raise InputError(
            "The output exists.",
            where=str(out),
            allowed="--overwrite to replace it, or another --out",
        )


def claim(
    out: str | Path | None,
    name: str,
    *,
    overwrite: bool = False,
    ours: Callable[[Path], bool] | None = None,
    inputs: Sequence[str | Path] = (),
) -> Path:
    """The path of an output, whose parent folder is created. Nothing is removed: the files are replaced one by one.

    Main arguments:
        out: File or folder; by default under ./beambench-runs.
        name: Name of the output.
    Other arguments:
        overwrite: Whether an existing output may be replaced, if `ours` recognises it.
        ours: Whether Beambench wrote a file or folder; None: only an empty folder may be replaced.
        inputs: Files and folders that are read; the output must not overlap them.

    Raises:
        InputError: The output exists and may not be replaced, or it cannot be created.
    """
    from .benchmarks.folders.workplace import refuse_inputs, refuse_place

    path = default_out(name) if out is None else local_path(out)
    refuse_inputs(path, inputs)
    check_free(path, overwrite=overwrite)
    if os.path.lexists(path):
        refuse_place(path)
        empty = path.is_dir() and not any(path.iterdir())
        if not empty and (path.is_symlink() or ours is None or not ours(path)):
            raise InputError(
                "Beambench did not write the existing output, so it is not replaced.",
                where=str(path),
                allowed="an output of this command, an empty folder or a new name",
            )
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise InputError("The output cannot be written there.", where=str(path), value=reason(error)) from error
    return path


def is_picture(path: Path) -> bool:
    """Whether a file is a PNG picture, or is empty, as a full disk leaves it."""
    try:
        with open(path, "rb") as file:
            return file.read(8) in (b"", b"\x89PNG\r\n\x1a\n")
    except OSError:
        return False
