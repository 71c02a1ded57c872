"""The unfinished store of a data set, begun or continued: its lock, what it records of the request, and its sound shards."""

from __future__ import annotations

import os
import shutil
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import IO, TYPE_CHECKING, Any

from ...scenes.errors import InputError
from .outline import check_parts, pilot, request_of

if TYPE_CHECKING:
    from ...captures.store.shard_receipts import Receipt
    from ...scenes.datasets.draws import Draws

__all__ = ["Place", "check_identity", "locked", "opened", "refuse_fewer", "sound_receipt"]

#: Longest wait for workers of an earlier run to end, s.
_WAIT_S = 10.0


@dataclass
class Place:
    """An unfinished store that is open: the request that it records, its lock, shards that were found damaged, and the time that a
    capture took in a pilot, s (0: there was none)."""

    request: dict[str, Any]
    lock: IO[bytes]
    damaged: int = 0
    expected_s: float = 0.0


@contextmanager
def opened(
    partial: Path, draws: Draws, identity: str, *, resume: bool, overwrite: bool, grown: Path | None
) -> Iterator[Place]:
    """The unfinished store, new or continued, locked. `grown`: a complete store whose sound shards are taken over.

    Raises InputError, OSError.
    """
    from ...captures.store.journal import JOURNAL, mark_journal
    from ...captures.store.ownership import is_removable_partial, remove_store
    from ...captures.store.shard_finish import read_request, write_request
    from ...captures.store.shard_manifest import is_sharded

    if os.path.lexists(partial) and not (resume and is_sharded(partial)):
        if not (resume or overwrite) or not is_removable_partial(partial):
            raise InputError(
                "An unfinished store is in the way.", where=str(partial),
                next_step="--resume continues it; or remove it",
            )  # fmt: skip
        with locked(partial / JOURNAL):
            remove_store(partial)
    new = not partial.exists()
    expected_s = 0.0
    if new:
        check_parts(draws)
        pilots = pilot(draws, len(draws.data.scenes))
        request, expected_s = request_of(draws, identity, pilots), max(one.cpu_s for one in pilots.values())
        partial.parent.mkdir(parents=True, exist_ok=True)
        try:
            partial.mkdir()
        except FileExistsError as error:
            raise InputError(
                "Another command has begun this data set meanwhile.", where=str(partial), allowed="one command at a time",
                next_step="wait for it; --resume goes on where it stopped, if it does",
            ) from error  # fmt: skip
        with open(partial / JOURNAL, "xb") as file:
            mark_journal(file)
    with locked(partial / JOURNAL) as lock:
        damaged = 0
        if new:
            write_request(partial, request)
            if grown is not None:
                _link(grown, partial, draws)
        else:
            request = read_request(partial)
            check_identity(partial, request.get("identity"), identity)
            refuse_fewer(partial, int(request["count"]), draws.data.captures)
            if request["count"] != draws.data.captures:
                request = request | {"count": draws.data.captures}
                write_request(partial, request)
            damaged = _drop_damaged(partial)
        yield Place(request, lock, damaged, expected_s)


@contextmanager
def locked(journal: Path, *, shared: bool = False) -> Iterator[IO[bytes]]:
    """Hold the lock of a store, `shared` with others or alone; workers of a run that was killed hold it until they have ended."""
    from ...captures.store.journal import lock_journal

    with open(journal, "r+b") as file:
        until = time.monotonic() + _WAIT_S
        while True:
            try:
                lock_journal(file, journal.parent, shared=shared)
                break
            except InputError:
                if time.monotonic() > until:
                    raise
                time.sleep(0.1)
        yield file


def _drop_damaged(partial: Path) -> int:
    """Remove temporary files, and the receipts of damaged shards, which are then made again; their number. Raises InputError."""
    from ...captures.store.shard_finish import drop_temporary
    from ...captures.store.shard_receipts import COPY, RECEIPTS, list_receipts, receipt_name, write_receipt

    drop_temporary(partial)
    dropped = 0
    for place in list_receipts(partial):
        receipt = sound_receipt(partial, place)
        names = [receipt_name(*place), receipt_name(*place) + COPY]
        if receipt is None:
            dropped += 1
            for name in names:
                (partial / RECEIPTS / name).unlink(missing_ok=True)
        elif any(
            not (partial / RECEIPTS / n).is_file() or (partial / RECEIPTS / n).read_bytes() != receipt.raw
            for n in names
        ):
            write_receipt(partial, receipt)
    return dropped


def sound_receipt(root: Path, place: tuple[str, int]) -> Receipt | None:
    """The receipt of a shard whose files are as they were written; None for any other."""
    from ...captures.store.shard_receipts import read_either
    from ...captures.store.shard_verify import shard_damage

    with suppress(InputError):
        receipt = read_either(root, *place)
        return None if shard_damage(root, receipt) else receipt
    return None


def _link(store: Path, partial: Path, draws: Draws) -> None:
    """Take over the whole and sound shards of a store that is to grow: files get a second name. Raises InputError, OSError."""
    from ...captures.store.shard_chunks import shard_key
    from ...captures.store.shard_finish import read_request, write_request
    from ...captures.store.shard_receipts import list_receipts, write_receipt

    old = read_request(store)
    request = old | {"count": draws.data.captures, "dataset": draws.data.model_dump(mode="json")}
    write_request(partial, request)
    for place in list_receipts(store):
        receipt = sound_receipt(store, place)
        if receipt is None or len(receipt.captures) < receipt.length:
            continue
        for name, entry in receipt.structure.items():
            inside = Path(receipt.group) / name / shard_key(receipt.shard, entry)
            (partial / inside).parent.mkdir(parents=True, exist_ok=True)
            try:
                os.link(store / inside, partial / inside)
            except OSError:
                shutil.copyfile(store / inside, partial / inside)
        write_receipt(partial, receipt)


def check_identity(where: Path, found: object, identity: str) -> None:
    """Raises InputError where the captures there were made of another data set: `found` is not its `identity`, hexadecimal."""
    if found != identity:
        raise InputError(
            "The existing captures are not of this data set: another file, other scenes, or other meshes.", where=str(where),
            value=str(found)[:16], allowed=identity[:16], next_step="choose another --out, or give --overwrite",
        )  # fmt: skip


def refuse_fewer(where: Path, there: int, asked: int) -> None:
    """Refuse fewer captures than were asked for before, finished or not: some that are made would be lost."""
    if asked < there:
        raise InputError(
            "The data set there has more captures, which would be lost.", where=str(where), value=asked,
            allowed=f"{there} or more", next_step="choose another --out, or give --overwrite",
        )  # fmt: skip
