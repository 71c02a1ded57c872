"""Where a verb writes: a fresh folder by default, and never over what is there unless told to."""

from __future__ import annotations

import re
import shutil
from pathlib import Path

from .scenes.errors import InputError

__all__ = ["check_free", "claim", "default_out", "slug"]


def slug(name: str) -> str:
    """A name as a part of a file name: letters, digits, dot, dash and underscore."""
    return re.sub(r"[^A-Za-z0-9._-]+", "-", name).strip("-.") or "run"


def default_out(name: str) -> Path:
    """./beambench-runs/<name>-<time>, with a number behind it where two commands fall into one second."""
    from .benchmarks.output import default_folder

    return default_folder(slug(Path(name).stem))


def check_free(out: str | Path | None, *, overwrite: bool) -> None:
    """Refuse an output that exists before any work is done for it.

    Raises:
        InputError: it exists and `overwrite` is not given.
    """
    if out is not None and not overwrite and Path(out).expanduser().exists():
        raise InputError(
            "The output exists.",
            where=str(out),
            allowed="--overwrite to replace it, or another --out",
            next_step="add --resume to go on with it, where the command has that",
        )


def claim(out: str | Path | None, name: str, *, resume: bool = False, overwrite: bool = False) -> Path:
    """The output's path; makes its parent. What is there stays, or with `overwrite` is removed.

    Raises:
        InputError: the output exists and neither `resume` nor `overwrite` is given, or it cannot be made there.
    """
    if resume and overwrite:
        raise InputError("Both --resume and --overwrite are given.", where="--resume", allowed="one of them")
    if out is None:
        if resume:
            raise InputError(
                "--resume needs the folder to go on with.",
                where="--out",
                next_step="add --out FOLDER, an earlier output",
            )
        path = default_out(name)
    else:
        path = Path(out).expanduser()
    if path.exists() and not resume:
        check_free(path, overwrite=overwrite)
        _refuse_foreign(path)
        shutil.rmtree(path) if path.is_dir() and not path.is_symlink() else path.unlink()
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise InputError("The output cannot be written there.", where=str(path), value=str(error)) from error
    return path


def _refuse_foreign(path: Path) -> None:
    """A folder is only replaced where it looks like an output of ours: a wrong --out must not delete a home."""
    if not path.is_dir() or path.is_symlink() or not any(path.iterdir()):
        return
    marks = (
        "scores.csv",
        "run.json",
        "zarr.json",
        "manifest.json",
        "estimates.json",
        "pyproject.toml",
        "beambench.json",
    )
    if not any((path / mark).exists() for mark in marks):
        raise InputError(
            "The folder holds something that Beambench did not write, so it is not replaced.",
            where=str(path),
            allowed="an output of Beambench, an empty folder or a new name",
        )
