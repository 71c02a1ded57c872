"""The output folder of a verb: it is locked, and an earlier result stays until the new one is complete.

A verb replaces only a folder that has its own mark, and in it only its own files: everything else in the folder stays.
A new result that replaces one is written into `<folder>/unfinished`; when it is complete, the old files are moved to
`<folder>/replaced`, the new ones take their places, and then the old ones are removed (`exchange`; the next start finishes
one that was interrupted). Both folders lie inside the output folder, because that is on one disk and writable, while the
folder around it may not be.
"""

from __future__ import annotations

import errno
import os
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path

from ...scenes.errors import InputError
from ...scenes.places import local_path
from .exchange import EXCHANGE, UNFINISHED, exchange, finish_exchange, remove_owned
from .kinds import Kind, is_finished, verb_in

__all__ = ["UNFINISHED", "locked", "output_folder", "refuse_inputs", "refuse_place", "workplace"]


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
    _finish(out, kind)
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
                    remove_owned(work, kind, itself=work != out)
                for folder in made:
                    with suppress(OSError):
                        folder.rmdir()
            raise


def _finish(out: Path, kind: Kind) -> None:
    """Finish an exchange that was interrupted."""
    if os.path.lexists(out / EXCHANGE):
        with locked(out):
            try:
                finish_exchange(out, kind)
            except OSError as error:
                raise _refused(out, error) from error


def _exchange(work: Path, out: Path, kind: Kind) -> None:
    try:
        exchange(work, out, kind)
    except OSError as error:
        raise _refused(out, error) from error


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
        done = kind.resumes and verb_in(out) == kind.verb and is_finished(out)
        also = "--resume to finish it, " if kind.resumes and not done else ""
        raise InputError(
            f"The output folder holds a finished {kind.verb}; it is not empty."
            if done
            else "The output folder exists and is not empty.",
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
        remove_owned(work, kind, itself=True)
    if work.exists():
        raise InputError("Other files are in the place of the new output.", where=str(work),
                         value=_held(work), next_step="move them elsewhere")  # fmt: skip


def _tell(error: BaseException, work: Path, kind: Kind) -> None:
    """Add a note to an error: what is kept, and how to continue; the command line prints it."""
    if not kind.kept(work):
        return
    how = f"to continue, repeat the command with --resume and --out {work}" if kind.resumes else kind.note
    error.add_note(f"finished work is kept in {work}; {how}")
