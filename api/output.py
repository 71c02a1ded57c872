"""Where a verb writes: a fresh place by default, and never over what is there unless told to."""

from __future__ import annotations

import os
from collections.abc import Callable, Sequence
from pathlib import Path

from .scenes.errors import InputError

__all__ = ["check_free", "claim", "default_out", "is_picture", "slug"]


def slug(name: str) -> str:
    """A name as a part of a file name: letters, digits, dot, dash and underscore."""
    from .benchmarks.folders.kinds import slug

    return slug(name)


def default_out(name: str) -> Path:
    """./beambench-runs/<name>-<time>, with a number behind it where two commands fall into one second."""
    from .benchmarks.folders.journal import default_folder

    return default_folder(slug(Path(name).stem))


def check_free(out: str | Path | None, *, overwrite: bool) -> None:
    """Refuse an output that exists before any work is done for it.

    Raises:
        InputError: it exists and `overwrite` is not given.
    """
    if out is not None and not overwrite and os.path.lexists(Path(out).expanduser()):
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
    """The output's path; makes its parent. Nothing is removed: whoever writes puts its own files in place, one by one.

    Main arguments:
        out: file or folder; under ./beambench-runs by default. name: of what is written.
    Other arguments:
        overwrite: what is there may be replaced, if it is `ours`; None: nothing but an empty folder may.
        inputs: what is read; the output must lie apart from it.

    Raises:
        InputError: the output exists and may not be replaced, or it cannot be made there.
    """
    from .benchmarks.folders.workplace import refuse_inputs, refuse_place

    path = default_out(name) if out is None else Path(out).expanduser()
    refuse_inputs(path, inputs)
    check_free(path, overwrite=overwrite)
    if os.path.lexists(path):
        refuse_place(path)
        empty = path.is_dir() and not any(path.iterdir())
        if not empty and (path.is_symlink() or ours is None or not ours(path)):
            raise InputError(
                "What is there is nothing that Beambench did write, so it is not replaced.",
                where=str(path),
                allowed="an output of this command, an empty folder or a new name",
            )
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise InputError("The output cannot be written there.", where=str(path), value=str(error)) from error
    return path


def is_picture(path: Path) -> bool:
    """Whether a file is a PNG picture, or empty as a full disk leaves one."""
    try:
        with open(path, "rb") as file:
            return file.read(8) in (b"", b"\x89PNG\r\n\x1a\n")
    except OSError:
        return False
