"""A data set made: shards by workers, continued after an interruption, grown, and completed."""

from __future__ import annotations

import os
import shutil
import time
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import IO, TYPE_CHECKING, Any

from ...scenes.errors import InputError
from .crew import Crew, Task
from .jobs import Job, Jobs, identity_of
from .outline import check_parts, free_bytes_at, lengths_of, most_workers, pilot, staff

if TYPE_CHECKING:
    from ...captures.store.shard_receipts import Receipt
    from ...scenes.datasets.draws import Draws
    from ..folders.progress import Progress

__all__ = ["Made", "make_dataset"]

#: Share of the free space that a data set may take.
_SPACE = 0.95
#: Longest wait for workers of an earlier run to end, s.
_WAIT_S = 10.0


@dataclass
class Made:
    """What was made: the store, its content's id, captures made and kept, what happened to workers, and their time, CPU s."""

    path: Path
    content: str = ""
    count: int = 0
    made: int = 0
    kept: int = 0
    remade: int = 0
    cpu_s: float = 0.0
    events: list[str] = field(default_factory=list)


def make_dataset(
    draws: Draws, out: Path, *, workers: int | None, resume: bool, overwrite: bool, tell: Progress
) -> Made:
    """Make all captures of a data set that are not there yet, and give the store its name.

    Main arguments:
        draws: the data set. out: the store.
        workers: processes; as many as there are processors if None. resume: continue an unfinished store, or let a complete one
            grow. overwrite: replace a store. tell: receives the progress.

    Raises:
        InputError: an output that exists, is of another data set, or has more captures than are asked for; an impossible scene; a
            job that ended three workers (all others are done, and kept); a disk that is full (what is complete is kept).
    """
    from ...captures.store.publish import disk_error, partial_of, refuse_existing
    from ...captures.store.shard_manifest import is_sharded, load_sharded

    partial, identity = partial_of(out), identity_of(draws)
    grows = False
    if resume and is_sharded(out):
        manifest = load_sharded(out)
        _check_identity(out, manifest.facts.get("identity"), identity)
        _refuse_fewer(out, max(manifest.count, int(manifest.facts.get("asked", 0))), draws.data.captures)
    if resume and is_sharded(out) and not partial.exists():
        if manifest.count == draws.data.captures:
            return Made(out, manifest.content, manifest.count, kept=manifest.count)
        grows = True
    else:
        refuse_existing(out, overwrite or (resume and is_sharded(out)))
    try:
        with _opened(
            partial, draws, identity, resume=resume, overwrite=overwrite, grown=out if grows else None
        ) as place:
            made = _Run(draws, partial, identity, place.request, tell).all(workers, place.lock)
            made.path, made.remade = out, place.damaged
        return _completed(made, partial, out, overwrite or grows or resume)
    except OSError as error:
        raise disk_error(error, "Making the data set", out, f"beambench generate … -o {out} --resume") from error


def _completed(made: Made, partial: Path, out: Path, overwrite: bool) -> Made:
    from ...captures.store.shard_finish import publish_sharded

    manifest = publish_sharded(partial, out, overwrite=overwrite)
    made.content, made.count = manifest.content, manifest.count
    return made


def _check_identity(where: Path, found: object, identity: str) -> None:
    if found != identity:
        raise InputError(
            "The existing captures are not of this data set: another file, other scenes, or other meshes.", where=str(where),
            value=str(found)[:16], allowed=identity[:16], next_step="choose another --out, or give --overwrite",
        )  # fmt: skip


def _refuse_fewer(where: Path, there: int, asked: int) -> None:
    """Refuse fewer captures than were asked for before, finished or not: some that are made would be lost."""
    if asked < there:
        raise InputError(
            "The data set there has more captures, which would be lost.", where=str(where), value=asked,
            allowed=f"{there} or more", next_step="choose another --out, or give --overwrite",
        )  # fmt: skip


@dataclass
class _Place:
    """An unfinished store that is open: the request that it records, its lock, and shards that were found damaged."""

    request: dict[str, Any]
    lock: IO[bytes]
    damaged: int = 0


@contextmanager
def _opened(
    partial: Path, draws: Draws, identity: str, *, resume: bool, overwrite: bool, grown: Path | None
) -> Iterator[_Place]:
    """The unfinished store, new or continued, locked. Raises InputError, OSError."""
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
        with _locked(partial / JOURNAL):
            remove_store(partial)
    new = not partial.exists()
    if new:
        request = _request(draws, identity)
        partial.parent.mkdir(parents=True, exist_ok=True)
        partial.mkdir()
        with open(partial / JOURNAL, "xb") as file:
            mark_journal(file)
    with _locked(partial / JOURNAL) as lock:
        damaged = 0
        if new:
            write_request(partial, request)
            if grown is not None:
                _link(grown, partial, draws)
        else:
            request = read_request(partial)
            _check_identity(partial, request.get("identity"), identity)
            _refuse_fewer(partial, int(request["count"]), draws.data.captures)
            if request["count"] != draws.data.captures:
                request = request | {"count": draws.data.captures}
                write_request(partial, request)
            damaged = _drop_damaged(partial)
        yield _Place(request, lock, damaged)


@contextmanager
def _locked(journal: Path) -> Iterator[IO[bytes]]:
    """Hold the lock of a store; workers of a run that was killed hold it until the kernel has ended them."""
    from ...captures.store.journal import lock_journal

    with open(journal, "r+b") as file:
        until = time.monotonic() + _WAIT_S
        while True:
            try:
                lock_journal(file, journal.parent)
                break
            except InputError:
                if time.monotonic() > until:
                    raise
                time.sleep(0.1)
        yield file


def _request(draws: Draws, identity: str) -> dict[str, Any]:
    """What the store records of the request, with the layout of its groups by a pilot. Raises InputError."""
    from ...captures.sources import bare_scene
    from ...scenes.datasets.distributions import Choice, Expressed, Grid

    check_parts(draws)
    pilots = pilot(draws, len(draws.data.scenes))
    parameters = draws.data.parameters.items()
    texts = [n for n, p in parameters if isinstance(p, Choice | Grid) and not all(map(_is_number, p.values))]
    numbers = [n for n, p in parameters if n not in texts or isinstance(p, Expressed)]
    lengths = lengths_of(draws, pilots)
    return {
        "name": draws.data.dataset, "version": draws.data.version, "identity": identity, "count": draws.data.captures,
        "numbers": numbers, "texts": texts,
        "groups": {name: {"structure": one.structure, "length": lengths[name], "stored": one.stored,
                          "decoded": one.decoded} for name, one in pilots.items()},
        "dataset": draws.data.model_dump(mode="json"),
        "scenes": {name: bare_scene(one) for name, one in draws.scenes.items()},
    }  # fmt: skip


def _is_number(value: Any) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool)


def _drop_damaged(partial: Path) -> int:
    """Remove the receipts of damaged shards, which are then made again, and return their number. Raises InputError."""
    from ...captures.store.shard_receipts import COPY, RECEIPTS, list_receipts, receipt_name, write_receipt

    dropped = 0
    for place in list_receipts(partial):
        receipt = _sound(partial, place)
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


def _sound(root: Path, place: tuple[str, int]) -> Receipt | None:
    """The receipt of a shard whose files are as they were written; None for any other."""
    from ...captures.store.shard_receipts import read_either
    from ...captures.store.shard_verify import shard_damage

    with suppress(InputError):
        receipt = read_either(root, *place)
        return None if shard_damage(root, receipt) else receipt
    return None


def _link(store: Path, partial: Path, draws: Draws) -> None:
    """Take over the whole and sound shards of a store that is to grow: their files get a second name. Raises InputError, OSError."""
    from ...captures.store.shard_chunks import shard_key
    from ...captures.store.shard_finish import read_request, write_request
    from ...captures.store.shard_receipts import list_receipts, write_receipt

    old = read_request(store)
    request = old | {"count": draws.data.captures, "dataset": draws.data.model_dump(mode="json")}
    write_request(partial, request)
    for place in list_receipts(store):
        receipt = _sound(store, place)
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


class _Run:
    """The shards that are missing, made by workers."""

    def __init__(self, draws: Draws, partial: Path, identity: str, request: Mapping[str, Any], tell: Progress) -> None:
        self._draws, self._partial, self._identity, self._tell = draws, partial, identity, tell
        self._groups = request["groups"]
        self._jobs = Jobs(draws, {name: one["length"] for name, one in self._groups.items()})
        self._total, self._done, self._began = draws.data.captures, 0, time.monotonic()
        self._kept = 0

    def all(self, workers: int | None, lock: IO[bytes]) -> Made:
        """Make all missing shards. Raises InputError where some could not be made; all others are there then."""
        missing = sum(1 for _ in self._missing())
        self._kept = self._done = self._total - sum(len(job.rows) for job in self._missing())
        self._check_space()
        count, threads = staff(workers, missing)
        count = most_workers(max(one["decoded"] for one in self._groups.values()), count)
        begin = {
            "root": str(self._partial.absolute()), "identity": self._identity, "resolved": self._draws.resolved(),
            "structures": {name: one["structure"] for name, one in self._groups.items()},
        }  # fmt: skip
        made = Made(self._partial, kept=self._kept)
        lost: list[Task] = []
        with Crew(begin, count, threads, keep=lock.fileno()) as crew:
            for task in crew.run((self._task(job) for job in self._missing()), self._heard):
                if task.done is None:
                    lost.append(task)
                    continue
                made.made += len(task.line["rows"])
                made.cpu_s += task.done["cpu_s"]
            made.events = crew.events
        self._tell("generate", self._total, self._total, "")
        if lost:
            raise _incomplete(lost, self._partial)
        return made

    def _missing(self) -> Iterator[Job]:
        from ...captures.store.shard_receipts import list_receipts

        there = {*list_receipts(self._partial)}
        for job in self._jobs:
            if (job.group, job.shard) not in there or not self._same(job):
                yield job

    def _same(self, job: Job) -> bool:
        """Whether the receipt of a job's shard is of this request; that of a shorter last shard is not, in a set that grew."""
        from ...captures.store.shard_receipts import read_either

        with suppress(InputError):
            receipt = read_either(self._partial, job.group, job.shard)
            return receipt.job == job.key(self._identity) and len(receipt.captures) == len(job.rows)
        return False

    def _task(self, job: Job) -> Task:
        line = {
            "kind": "shard",
            "group": job.group,
            "shard": job.shard,
            "rows": job.rows,
            "length": job.length,
            "last": job.last,
        }
        return Task(f"{job.group}, shard {job.shard} (captures {job.rows[0]} … {job.rows[-1]})", line)

    def _check_space(self) -> None:
        needed = (self._total - self._kept) * max(one["stored"] for one in self._groups.values())
        free = free_bytes_at(self._partial)
        if needed > _SPACE * free:
            raise InputError(
                "The data set does not fit on the disk.", where=str(self._partial), value=f"about {needed / 1e9:.3g} GB",
                allowed=f"{free / 1e9:.3g} GB are free", next_step="free space, or choose another --out",
            )  # fmt: skip

    def _heard(self, index: int) -> None:
        self._done = min(self._done + 1, self._total - 1)
        made = self._done - self._kept
        rate = made / max(time.monotonic() - self._began, 1e-3)
        left = (self._total - self._done) / rate
        self._tell("generate", self._done, self._total, f"{_time_text(left)} left, {rate:.3g} captures/s")


def _time_text(seconds: float) -> str:
    if seconds < 90:
        return f"{seconds:.0f} s"
    return f"{seconds / 60:.0f} min" if seconds < 5400 else f"{seconds / 3600:.1f} h"


def _incomplete(lost: list[Task], partial: Path) -> InputError:
    told = [f"{one.name}: {one.lost}".replace("\n", "\n             ") for one in lost[:8]]
    more = [f"and {len(lost) - 8} more"] if len(lost) > 8 else []
    return InputError(
        "Some shards of the data set could not be made; all others are complete.", where=str(partial),
        value=f"{len(lost)} shards",
        next_step="\n           ".join([
            f"mend the cause, then --resume; `beambench data finalize {partial}` keeps the others. The causes:", *told, *more
        ]),
    )  # fmt: skip
