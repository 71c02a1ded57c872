"""The output folder of a verb: it is locked, and an earlier result stays until the new one is complete.

A verb replaces only a folder that has its own mark, and in it only its own files: everything else in the folder stays.
A new result that replaces one is written into `<folder>/unfinished`; when it is complete, the old files are moved to
`<folder>/replaced`, the new ones take their places, and then the old ones are removed. Both folders lie inside the
output folder, because that is on one disk and writable, while the folder around it may not be.
"""

from __future__ import annotations

import errno
import os
import shutil
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path

from ...captures.store.journal import fsync_path
from ...scenes.errors import InputError
from ...scenes.places import local_path
from .kinds import Kind, verb_in

__all__ = ["UNFINISHED", "locked", "output_folder", "refuse_inputs", "refuse_place", "workplace"]

UNFINISHED = "unfinished"
_REPLACED = "replaced"


def output_folder(out: str | Path | None, name: str, *, resume: bool, overwrite: bool) -> Path:
    """The folder named by `out`, or a new one under ./beambench-runs.

    Raises:
        InputError: both flags are given, or `resume` without a folder.
    """
    from .journal import default_folder

    if resume and overwrite:
        raise InputError(
            "The options --resume and --overwrite exclude each other.", where="--resume", allowed="one of them"
        )
    if out is not None:
        return local_path(out)
    if resume:
        raise InputError(
            "The option --resume needs the folder of the earlier output.", where="--out", next_step="add --out FOLDER"
        )
    return default_folder(name)


def refuse_inputs(path: Path, inputs: Sequence[str | Path]) -> None:
    """Refuse an output that is an input, contains one, or lies in an input that is a store of captures.

    Raises:
        InputError: it is refused.
    """
    from ...captures.store.publish import is_store

    place = path.resolve()
    for one in inputs:
        source = Path(one).expanduser().resolve()
        if place == source or place in source.parents or (source in place.parents and is_store(source)):
            raise InputError(
                "The output would overwrite an input.",
                where="--out",
                value=str(path),
                allowed=f"a folder outside {one}",
                next_step="choose another --out",
            )


def refuse_place(path: Path) -> None:
    """Refuse to replace the working folder, or one that contains it.

    Raises:
        InputError: it is refused.
    """
    place, here = path.resolve(), Path.cwd().resolve()
    if place == here or place in here.parents:
        raise InputError(
            "The working folder and the folders that contain it are never replaced.",
            where="--out",
            value=str(path),
            next_step="choose another --out, or change to another folder and repeat",
        )


def _refused(folder: Path, error: OSError) -> InputError:
    return InputError(
        "The output folder cannot be written.",
        where="--out",
        value=f"{folder}: {error.strerror or error}",
        next_step="choose another --out",
    )


@contextmanager
def locked(folder: Path) -> Iterator[None]:
    """Lock a folder against other processes. The lock ends with the process, however that ends.

    Raises:
        InputError: another process has locked it.
    """
    import fcntl

    try:
        handle = os.open(folder, os.O_RDONLY | os.O_DIRECTORY)
    except OSError as error:
        raise _refused(folder, error) from error
    try:
        try:
            fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError as error:
            if error.errno in (errno.EAGAIN, errno.EACCES):
                raise InputError(
                    "Another process is writing into this folder.",
                    where="--out",
                    value=str(folder),
                    next_step="wait until it ends, or choose another --out",
                ) from error
            if error.errno not in (errno.EBADF, errno.ENOLCK, errno.EOPNOTSUPP, errno.ENOSYS):
                raise _refused(folder, error) from error
            # Some network disks cannot lock folders: there the user must avoid two processes in one folder.
        yield
    finally:
        os.close(handle)


@contextmanager
def workplace(
    out: Path,
    kind: Kind,
    *,
    resume: bool = False,
    overwrite: bool = False,
    inputs: Sequence[str | Path] = (),
    check: Callable[[Path], None] | None = None,
) -> Iterator[Path]:
    """The folder into which to write a result; after the block the result is in `out`, or `out` is as before.

    Main arguments:
        out: folder of the result: new, empty, or with an earlier result of this kind. kind: of the verb.
    Other arguments:
        resume: continue the earlier result. overwrite: replace it when the block has ended without an error.
        inputs: files that the verb reads; the output must not overlap them.
        check: called with the folder to be resumed before anything is done; raises InputError where it does not fit.

    Raises:
        InputError: the content may not be replaced, another process is writing there, or the folder cannot be written.
    """
    refuse_inputs(out, inputs)
    held = _held(out)
    if held:
        _admit(out, kind, held, resume=resume, overwrite=overwrite)
    elif resume:
        raise InputError("There is nothing to resume.", where="--resume", value=str(out),
                         next_step="omit --resume to begin")  # fmt: skip
    if resume and check is not None:
        check(out)
    made = _make(out)
    with locked(out):
        if held != _held(out):
            raise InputError("Another process is writing into this folder.", where="--out", value=str(out))
        work = out
        if kind.whole or (held and overwrite):
            work = out / UNFINISHED
            _empty(work, kind)
            _make(work)
        try:
            yield work
            if work != out:
                _exchange(work, out, kind)
        except BaseException as error:
            _tell(error, work, kind)
            if not kind.kept(work) and not resume:
                with suppress(OSError):
                    _remove(work, kind, itself=work != out)
                for folder in made:
                    with suppress(OSError):
                        folder.rmdir()
            raise


def _held(folder: Path) -> list[str]:
    try:
        return sorted(path.name for path in folder.iterdir())
    except FileNotFoundError:
        return []
    except NotADirectoryError as error:
        if not os.path.lexists(folder):
            raise _refused(folder, error) from error
        raise InputError("The output is a file, not a folder.", where="--out", value=str(folder)) from error
    except OSError as error:
        raise _refused(folder, error) from error


def _admit(out: Path, kind: Kind, held: list[str], *, resume: bool, overwrite: bool) -> None:
    """Refuse a folder into which the verb must not write."""
    if not (resume or overwrite):
        also = "--resume to finish it, " if kind.resumes else ""
        raise InputError(
            "The output folder exists and is not empty.",
            where="--out",
            value=str(out),
            next_step=f"add {also}--overwrite to replace it, or choose another --out",
        )
    if overwrite:
        refuse_place(out)
    # An earlier attempt may have left nothing but its unfinished folder.
    found = verb_in(out) or ("" if held != [UNFINISHED] else verb_in(out / UNFINISHED) or kind.verb)
    if found != kind.verb:
        what = f"an output of `beambench {found}`" if found else f"files that `beambench {kind.verb}` did not write"
        raise InputError(
            f"The output folder contains {what}, so it is neither replaced nor resumed.",
            where="--out",
            value=str(out),
            allowed=f"an output of `beambench {kind.verb}`, an empty folder or a new name",
        )


def _make(folder: Path) -> list[Path]:
    """Make a folder and its parents; returns the new ones, innermost first."""
    new = [path for path in (folder, *folder.parents) if not path.exists()]
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise _refused(folder, error) from error
    return new


def _empty(work: Path, kind: Kind) -> None:
    """Remove the unfinished files of an earlier attempt."""
    if not os.path.lexists(work):
        return
    if work.is_symlink() or not work.is_dir():
        raise InputError("Other files are in the place of the new output.", where=str(work))
    with locked(work):
        _remove(work, kind, itself=True)
    if work.exists():
        raise InputError("Other files are in the place of the new output.", where=str(work),
                         value=_held(work), next_step="move them elsewhere")  # fmt: skip


def _remove(folder: Path, kind: Kind, *, itself: bool) -> None:
    """Remove the files of the verb, and folders that are then empty."""
    for path in kind.files(folder):
        shutil.rmtree(path) if path.is_dir() and not path.is_symlink() else path.unlink()
    _tidy(folder, kind)
    if itself:
        with suppress(OSError):
            folder.rmdir()


def _tidy(folder: Path, kind: Kind) -> None:
    """Remove the empty folders of an output."""
    for part in {path.parent for path in map(folder.joinpath, kind.owned)} - {folder}:
        with suppress(OSError):
            part.rmdir()


def _exchange(work: Path, out: Path, kind: Kind) -> None:
    """Replace the old files by the new ones; if that fails, all files are back in their places."""
    old, new = kind.files(out), [path for path in kind.files(work) if path.suffix != ".partial"]
    known = {*kind.files(work)}
    new += [path for path in work.rglob("*") if path.is_file() and not {path, *path.parents} & known]
    standing = {path.relative_to(out) for path in old}
    for path in new:
        place = path.relative_to(work)
        if place not in standing and os.path.lexists(out / place):
            raise InputError("A file of the new output has the same name as one that Beambench did not write.",
                             where=str(out / place), next_step="move it elsewhere")  # fmt: skip
    aside, number = out / _REPLACED, 2
    while os.path.lexists(aside):
        aside, number = out / f"{_REPLACED}-{number}", number + 1
    moves = [(path, aside / path.relative_to(out)) for path in old]
    moves += [(path, out / path.relative_to(work)) for path in new]
    done: list[tuple[Path, Path]] = []
    try:
        for source, target in moves:
            target.parent.mkdir(parents=True, exist_ok=True)
            os.rename(source, target)
            done.append((source, target))
        fsync_path(out)
    except BaseException as error:
        for source, target in reversed(done):
            os.rename(target, source)
        if isinstance(error, OSError):
            raise _refused(out, error) from error
        raise
    shutil.rmtree(aside, ignore_errors=True)
    shutil.rmtree(work, ignore_errors=True)  # it contains no files any more
    _tidy(out, kind)  # parts that the old output had and the new one has not


def _tell(error: BaseException, work: Path, kind: Kind) -> None:
    """Add a note to an error: what is kept, and how to continue; the command line prints it."""
    if not kind.kept(work):
        return
    how = f"to continue, repeat the command with --resume and --out {work}" if kind.resumes else kind.note
    error.add_note(f"finished work is kept in {work}; {how}")
