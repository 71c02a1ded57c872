"""The folder of an export: written under another name, one file complete after the other, continued after an interruption.

`NAME.partial` has a journal with a line for each piece that is on disk, with size and sha256 of its files. When all are there,
`export.json` lists them, and the folder gets its name by one rename.
"""

from __future__ import annotations

import errno
import hashlib
import json
import os
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from pathlib import Path, PurePosixPath
from typing import IO, Any

from ...scenes.errors import InputError
from ...scenes.json_keys import read_json
from ..store.journal import append_line, fsync_path, line_of, write_file
from ..store.manifest import regular_size, sha256_file
from ..store.publish import disk_error, partial_of

__all__ = ["EXPORT", "Done", "Pace", "Place", "Tell", "export_place", "exported", "finish"]

#: The list of an export's files, and the journal of one that is unfinished.
EXPORT, JOURNAL = "export.json", "export.jsonl"
_FORMAT = "beambench-export"

Tell = Callable[[str, int, int, str], None]
"""Progress: (stage, done, total, text)."""


@dataclass
class Done:
    """A piece that is on disk: {file: [bytes, sha256]}, its number of captures, and what else was told of it."""

    files: dict[str, list[Any]]
    count: int
    facts: list[dict[str, Any]] = field(default_factory=list)


class Place:
    """An open export. `done` are the pieces that are there, by their first file."""

    def __init__(self, folder: Path, journal: IO[bytes], done: dict[str, Done]) -> None:
        self.folder, self._journal, self.done = folder, journal, done
        self.kept = sum(one.count for one in done.values())

    def write(
        self, files: Sequence[str], count: int, writer: Callable[[list[Path]], list[dict[str, Any]] | None]
    ) -> None:
        """Write the files of one piece and record them. `writer` gets their temporary paths. Raises OSError, InputError."""
        paths = [self.folder / name for name in files]
        for folder in {path.parent for path in paths}:
            folder.mkdir(parents=True, exist_ok=True)
        # The suffix stays: writers of pictures choose the format by it.
        drafts = [path.with_name(f"unfinished.{path.name}") for path in paths]
        try:
            facts = writer(drafts) or []
            told = {}
            for name, draft in zip(files, drafts, strict=True):
                fsync_path(draft)
                told[name] = [draft.stat().st_size, sha256_file(draft)]
            for draft, path in zip(drafts, paths, strict=True):
                os.replace(draft, path)
        except BaseException:
            for draft in drafts:
                draft.unlink(missing_ok=True)
            raise
        for folder in {path.parent for path in paths}:
            fsync_path(folder)
        one = Done(told, count, facts)
        append_line(self._journal, vars(one))
        self.done[files[0]] = one


@contextmanager
def export_place(out: Path, request: Mapping[str, Any], *, resume: bool, overwrite: bool) -> Iterator[Place | None]:
    """The folder into which to write an export; after the block it is `out`. None where a complete one is resumed.

    Main arguments:
        out: the folder. request: what is exported; it is recorded, and a resumed export must have the same.
    Other arguments:
        resume: continue what is unfinished. overwrite: replace an earlier export.

    The block calls `finish` last. Raises InputError: an output that exists and may not be replaced, or is of another request; a
    disk that is full: what is complete is kept, for `resume`.
    """
    partial = partial_of(out)
    _settle(out)
    if os.path.lexists(out):
        if resume and not partial.exists() and exported(out).get("request") == request:
            yield None
            return
        _check_replaceable(out, resume, overwrite)
    try:
        with _opened(partial, request, resume=resume, overwrite=overwrite) as place:
            try:
                yield place
            except BaseException as error:
                if place.done:
                    error.add_note(f"finished files are kept in {partial}; --resume continues")
                else:
                    _remove(partial, [])
                raise
        _publish(partial, out)
    except OSError as error:
        raise disk_error(error, "The export", out, "repeat the command with --resume") from error


def _check_replaceable(out: Path, resume: bool, overwrite: bool) -> None:
    if not overwrite:
        told = "an export of other captures, or with other options" if resume and exported(out) else ""
        raise InputError(
            f"The output is {told}." if told else "The output exists.", where=str(out),
            next_step="choose another --out, or add --overwrite",
        )  # fmt: skip
    listed = exported(out)
    if not listed:
        raise InputError(
            "Beambench did not write the existing output, so it is not replaced.", where=str(out),
            allowed="an export, or a new name",
        )  # fmt: skip
    known = {*listed["files"], EXPORT, JOURNAL}
    foreign = sorted(name for name in _files(out) if name not in known)
    if foreign:
        raise InputError(
            "The existing export holds files that are not its own, so it is not replaced.", where=str(out / foreign[0]),
            next_step="move them away, or choose another --out",
        )  # fmt: skip


def _files(folder: Path) -> list[str]:
    """Files and links in a folder, relative to it."""
    found = []
    for root, folders, names in os.walk(folder):
        links = [name for name in folders if Path(root, name).is_symlink()]
        found += [Path(root, name).relative_to(folder).as_posix() for name in (*names, *links)]
    return found


def exported(folder: Path) -> dict[str, Any]:
    """The list of a complete export, {} where there is none."""
    try:
        if folder.is_symlink() or regular_size(folder / EXPORT) is None:
            return {}
        found = read_json((folder / EXPORT).read_bytes())
    except (OSError, ValueError):
        return {}
    sound = isinstance(found, dict) and found.get("format") == _FORMAT and isinstance(found.get("files"), dict)
    return found if sound else {}


@contextmanager
def _opened(partial: Path, request: Mapping[str, Any], *, resume: bool, overwrite: bool) -> Iterator[Place]:
    if os.path.lexists(partial) and (partial.is_symlink() or not partial.is_dir()):
        raise InputError(
            "Something else has the name of the unfinished output.", where=str(partial), next_step="move it away"
        )
    partial.mkdir(parents=True, exist_ok=True)
    with _locked(partial):
        done: dict[str, Done] = {}
        if any(partial.iterdir()):
            done = _continued(partial, request, resume=resume, overwrite=overwrite)
        lines = [line_of({"format": _FORMAT, "request": dict(request)})]
        lines += [line_of(vars(one)) for one in done.values()]
        write_file(partial / JOURNAL, b"".join(lines))
        with open(partial / JOURNAL, "ab") as file:
            yield Place(partial, file, done)


def _continued(partial: Path, request: Mapping[str, Any], *, resume: bool, overwrite: bool) -> dict[str, Done]:
    """The pieces of an unfinished export that are kept; without `resume` they are removed. Raises InputError."""
    header, found = _journal_of(partial)
    if header is None:
        raise InputError(
            "Other files are in the place of the unfinished output.", where=str(partial), next_step="move them away"
        )
    if resume and header == request:
        return {name: one for name, one in found.items() if _whole(partial, one)}
    if resume or not overwrite:
        raise InputError(
            "The unfinished export is of other captures, or with other options." if resume
            else "An unfinished export is in the way.", where=str(partial),
            next_step="--overwrite begins anew" + ("" if resume else ", --resume continues it"),
        )  # fmt: skip
    _remove(partial, [name for one in found.values() for name in one.files], itself=False)
    return {}


@contextmanager
def _locked(folder: Path) -> Iterator[None]:
    """Hold the folder for this process, however it ends. Raises InputError where another one writes there."""
    import fcntl

    handle = os.open(folder, os.O_RDONLY | os.O_DIRECTORY)
    try:
        try:
            fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError as error:
            raise InputError(
                "Another process is writing this export.",
                where=str(folder),
                next_step="wait until it ends, or choose another --out",
            ) from error
        except OSError as error:  # some network disks have no locks: there two processes must not write one export
            if error.errno not in (errno.ENOLCK, errno.EOPNOTSUPP, errno.ENOSYS):
                raise
        yield
    finally:
        os.close(handle)


def _journal_of(partial: Path) -> tuple[dict[str, Any] | None, dict[str, Done]]:
    """The request and the pieces of an unfinished export, up to its last intact line; None where it is not one."""
    request: dict[str, Any] | None = None
    found: dict[str, Done] = {}
    if regular_size(partial / JOURNAL) is None:
        return None, {}
    with open(partial / JOURNAL, "rb") as file:
        for line in file:
            digest, _, text = line.removesuffix(b"\n").partition(b" ")
            if hashlib.sha256(text).hexdigest().encode() != digest:
                break
            try:
                body = read_json(text)
                if request is not None:
                    found[next(iter(body["files"]))] = Done(
                        dict(body["files"]), int(body["count"]), list(body["facts"])
                    )
                elif body["format"] == _FORMAT:
                    request = dict(body["request"])
            except (ValueError, KeyError, TypeError, AttributeError, StopIteration):
                break
            if request is None:
                break
    return request, found


def _whole(partial: Path, one: Done) -> bool:
    """Whether the files of a piece are as they were written; a name that leads out of the folder is not."""
    return all(
        _inside(partial, name) and regular_size(partial / name) == size and sha256_file(partial / name) == digest
        for name, (size, digest) in one.files.items()
    )


def _inside(folder: Path, name: str) -> bool:
    parts = PurePosixPath(name).parts
    return not name.startswith("/") and ".." not in parts and not (folder / name).parent.is_symlink()


def _publish(partial: Path, out: Path) -> None:
    """Give the export its name; what it replaces is removed once it has it. Raises OSError."""
    aside = _aside(out)
    if os.path.lexists(out):
        os.rename(out, aside)
    os.rename(partial, out)
    fsync_path(out.parent)
    (out / JOURNAL).unlink(missing_ok=True)
    if aside.exists():
        _remove(aside, list(exported(aside).get("files", {})))


def _aside(out: Path) -> Path:
    return out.with_name(f"{out.name}.replaced")


def _settle(out: Path) -> None:
    """Finish a replacement that was stopped: the old export gets its name back, or is removed."""
    aside = _aside(out)
    if not exported(aside):
        return
    if os.path.lexists(out):
        _remove(aside, list(exported(aside)["files"]))
    else:
        os.rename(aside, out)


def _remove(folder: Path, names: Sequence[str], *, itself: bool = True) -> None:
    """Remove an export: the files that it lists, drafts, its own records, and folders that are then empty."""
    for name in (*names, EXPORT, JOURNAL):
        if _inside(folder, name):
            (folder / name).unlink(missing_ok=True)
    for root, _, files in os.walk(folder, topdown=False):
        for name in files:
            if name.startswith("unfinished.") or name in (f"{EXPORT}.new", f"{JOURNAL}.new"):
                Path(root, name).unlink(missing_ok=True)
        if itself or Path(root) != folder:
            with suppress(OSError):
                os.rmdir(root)


def finish(place: Place, request: Mapping[str, Any], more: Mapping[str, bytes], about: Mapping[str, Any]) -> None:
    """Write further files and the list of all. Raises OSError."""
    for name, content in more.items():
        write_file(place.folder / name, content)
    files = {name: told for one in place.done.values() for name, told in one.files.items()}
    files |= {name: [len(content), hashlib.sha256(content).hexdigest()] for name, content in more.items()}
    count = sum(one.count for one in place.done.values())
    body = {"format": _FORMAT, "version": 1, "request": dict(request), "captures": count, **about}
    body["files"] = dict(sorted(files.items()))
    write_file(place.folder / EXPORT, (json.dumps(body, indent=1) + "\n").encode())
    fsync_path(place.folder)


class Pace:
    """Progress with the pace of what was written in this run."""

    def __init__(self, tell: Tell, total: int, kept: int) -> None:
        self._tell, self._total, self._kept, self._done = tell, total, kept, kept
        self._began = time.monotonic()

    def add(self, count: int) -> None:
        """So many captures more are written."""
        self._done += count
        rate = (self._done - self._kept) / max(time.monotonic() - self._began, 1e-3)
        self._tell("export", self._done, self._total, f"{rate:.3g} captures/s")
