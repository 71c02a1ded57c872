"""The exchange of an old result for a new one in the output folder, which a kill at any moment leaves to be finished.

Its plan, every move in order, is on disk (`exchange.json`) before the first file moves, and goes last. Moves are renames on
one disk, so each was made or was not: the plan and the files tell how far it came.
"""

from __future__ import annotations

import json
import os
import re
import shutil
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path, PurePosixPath
from typing import Any

from ...captures.store.journal import fsync_path, write_file
from ...scenes.errors import InputError, reason
from ...scenes.json_keys import read_json
from .kinds import Kind

__all__ = ["EXCHANGE", "UNFINISHED", "exchange", "finish_exchange", "refuse_unfinished", "remove_owned"]

UNFINISHED = "unfinished"
EXCHANGE = "exchange.json"
_REPLACED = "replaced"
_ASIDE = re.compile(rf"{_REPLACED}(-[1-9][0-9]{{0,5}})?")

Move = tuple[str, str]
"""A file's place before and after, as paths in the output folder."""


@dataclass(frozen=True)
class Plan:
    """Moves of an exchange: `old` files go `aside`, then `new` ones take their places."""

    verb: str
    aside: str
    old: list[Move]
    new: list[Move]


def exchange(work: Path, out: Path, kind: Kind) -> None:
    """Replace the old files in `out` by the new ones in `work`. If a move fails, all files are back in their places.

    Raises:
        InputError: a foreign file has the name of a new one. OSError: a move failed.
    """
    plan = _plan(work, out, kind)
    write_file(out / EXCHANGE, json.dumps(vars(plan)).encode())
    fsync_path(out)
    done: list[tuple[Path, Path]] = []
    try:
        for move in (*plan.old, *plan.new):
            source, target = (out / name for name in move)
            target.parent.mkdir(parents=True, exist_ok=True)
            os.rename(source, target)
            done.append((source, target))
        fsync_path(out)
    except BaseException:
        for source, target in reversed(done):
            os.rename(target, source)
        (out / EXCHANGE).unlink()
        raise
    _clear(out, plan, kind)


def finish_exchange(out: Path, kind: Kind) -> None:
    """Complete an exchange that a kill or a lost machine interrupted; nothing is done where there is none.

    Raises:
        InputError: the plan is damaged, of another verb, or leads out of the folder. OSError: a move failed.
    """
    if not os.path.lexists(out / EXCHANGE):
        return
    plan = _read(out, kind)
    begun = any(not os.path.lexists(out / source) for source, _ in plan.new)
    # Once a new file has taken its place, what stands in the place of an old one is new.
    for source, target in [*([] if begun else plan.old), *plan.new]:
        if os.path.lexists(out / source):
            (out / target).parent.mkdir(parents=True, exist_ok=True)
            os.rename(out / source, out / target)
    fsync_path(out)
    _clear(out, plan, kind)


def refuse_unfinished(folder: Path) -> None:
    """Refuse to read a folder in which old and new files are mixed.

    Raises:
        InputError: an exchange was interrupted there.
    """
    if os.path.lexists(folder / EXCHANGE):
        raise InputError(
            "The result was being replaced when its writer was stopped, so that old and new files are mixed.",
            where=str(folder), next_step="repeat the command that wrote it, with --overwrite; it finishes this first",
        )  # fmt: skip


def remove_owned(folder: Path, kind: Kind, *, itself: bool) -> None:
    """Remove the files of the verb, folders that are then empty, and the folder `itself` if it is."""
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


def _plan(work: Path, out: Path, kind: Kind) -> Plan:
    old, new = kind.files(out), [path for path in kind.files(work) if path.suffix != ".partial"]
    known = {*kind.files(work)}
    new += [path for path in work.rglob("*") if path.is_file() and not {path, *path.parents} & known]
    standing = {path.relative_to(out) for path in old}
    for path in new:
        place = path.relative_to(work)
        if place not in standing and os.path.lexists(out / place):
            raise InputError("A file of the new output has the same name as one that Beambench did not write.",
                             where=str(out / place), next_step="move it elsewhere")  # fmt: skip
    aside, number = _REPLACED, 2
    while os.path.lexists(out / aside):
        aside, number = f"{_REPLACED}-{number}", number + 1
    return Plan(
        kind.verb,
        aside,
        [(name, f"{aside}/{name}") for name in (path.relative_to(out).as_posix() for path in old)],
        [(f"{UNFINISHED}/{name}", name) for name in (path.relative_to(work).as_posix() for path in new)],
    )


def _clear(out: Path, plan: Plan, kind: Kind) -> None:
    """Remove what was replaced, the empty working folder, and then the plan."""
    for name in (plan.aside, UNFINISHED):
        if (out / name).is_dir() and not (out / name).is_symlink():
            with suppress(OSError):  # a file that cannot be removed stays: the new result is complete
                remove_owned(out / name, kind, itself=False)
            for root, _, _ in os.walk(out / name, topdown=False):
                with suppress(OSError):
                    os.rmdir(root)
    _tidy(out, kind)  # parts that the old output had and the new one has not
    (out / EXCHANGE).unlink()


def _read(out: Path, kind: Kind) -> Plan:
    """The plan in `out`. It is a file like any other: each path is checked, and old files must be the verb's own."""
    try:
        data: Any = read_json((out / EXCHANGE).read_bytes())
        plan = Plan(str(data["verb"]), str(data["aside"]), _moves(data["old"]), _moves(data["new"]))
        if plan.verb != kind.verb or not _ASIDE.fullmatch(plan.aside):
            raise ValueError(f"verb {plan.verb!r}, aside {plan.aside!r}")
        owned = _patterns(kind, out, out / plan.aside, out / UNFINISHED)
        for source, target in plan.old:
            if target != f"{plan.aside}/{source}" or not any(map(PurePosixPath(source).match, owned)):
                raise ValueError(f"{source!r} to {target!r}")
        for source, target in plan.new:
            if source != f"{UNFINISHED}/{target}":
                raise ValueError(f"{source!r} to {target!r}")
        for place in (path for move in (*plan.old, *plan.new) for path in move):
            if any((out / part).is_symlink() for part in list(PurePosixPath(place).parents)[:-1]):
                raise ValueError(f"{place!r} passes a link")
    except (OSError, ValueError, TypeError, KeyError, RecursionError) as error:
        raise InputError(
            "The plan of an interrupted exchange is damaged, or does not belong to this verb.",
            where=str(out / EXCHANGE), value=reason(error), allowed=f"written by `beambench {kind.verb}`",
            next_step="choose another --out; the folder's files stay as they are",
        ) from error  # fmt: skip
    return plan


def _patterns(kind: Kind, *folders: Path) -> list[str]:
    """Patterns of the verb's files; the list that names further ones may be in any of the folders by now."""
    named = [name for folder in folders for name in (kind.named(folder) if kind.named is not None else ())]
    return [pattern for name in (*kind.owned, *named) for pattern in (name, f"{name}.partial")]


def _moves(value: Any) -> list[Move]:
    moves = [(str(source), str(target)) for source, target in value]
    for place in (path for move in moves for path in move):
        if place.startswith("/") or not {"..", ".", ""}.isdisjoint(place.split("/")) or "\0" in place:
            raise ValueError(f"{place!r} leads out of the folder")
    return moves
