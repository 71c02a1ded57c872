"""A data set made: shards by workers, continued after an interruption, grown, and completed; or one part of it, by an array job."""

from __future__ import annotations

import time
from collections.abc import Iterator, Mapping
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import IO, TYPE_CHECKING, Any

from ...scenes.errors import InputError
from .crew import Crew, Task
from .jobs import Job, Jobs, identity_of
from .outline import free_bytes_at, most_workers, staff
from .place import Place, check_identity, locked, opened, refuse_fewer

if TYPE_CHECKING:
    from ...scenes.datasets.draws import Draws
    from ..folders.progress import Progress
    from .cluster import Cluster

__all__ = ["Force", "Made", "begin_dataset", "make_dataset", "make_part"]

#: Share of the free space that a data set may take.
_SPACE = 0.95


@dataclass(frozen=True)
class Force:
    """Who makes the shards.

    Main arguments:
        workers: processes on this machine; as many as there are processors if None. dask: address of a Dask scheduler, whose
            workers do it instead.
    Other arguments:
        limit_s: time after which a worker counts as hung, see `Crew`.
    """

    workers: int | None = None
    dask: str | None = None
    limit_s: float | None = None


@dataclass
class Made:
    """What was made: the store, its content's id, captures made and kept, what happened to workers, and their time, CPU s.

    `missing`: shards that are not there yet, of a data set that several array jobs make.
    """

    path: Path
    content: str = ""
    count: int = 0
    made: int = 0
    kept: int = 0
    remade: int = 0
    cpu_s: float = 0.0
    events: list[str] = field(default_factory=list)
    missing: int = 0


def make_dataset(draws: Draws, out: Path, force: Force, *, resume: bool, overwrite: bool, tell: Progress) -> Made:
    """Make all captures of a data set that are not there yet, and give the store its name.

    Main arguments:
        draws: the data set. out: the store. force: who makes it.
        resume: continue an unfinished store, or let a complete one grow. overwrite: replace a store. tell: receives the progress.

    Raises:
        InputError: an output that exists, is of another data set, or has more captures than are asked for; an impossible scene; a
            job that ended three workers (all others are done, and kept); a disk that is full (what is complete is kept).
    """
    from ...captures.store.publish import disk_error, partial_of
    from ...captures.store.shard_finish import publish_sharded

    partial, identity = partial_of(out), identity_of(draws)
    complete, grown = _found(draws, out, identity, resume=resume, overwrite=overwrite)
    if complete is not None:
        return complete
    new = grown is None and not (resume and partial.exists())
    stage, steps, what = ("generate", draws.data.captures, "pilot") if new else ("check", 1, "captures that are there")
    tell(stage, 0, steps, what)
    try:
        with opened(partial, draws, identity, resume=resume, overwrite=overwrite, grown=grown) as place:
            if not new:
                tell(stage, steps, steps, "")
            made = _Run(draws, partial, identity, place, tell).all(force)
            made.path, made.remade = out, place.damaged
        manifest = publish_sharded(partial, out, overwrite=overwrite or resume)
    except OSError as error:
        raise disk_error(error, "Making the data set", out, f"beambench generate … -o {out} --resume") from error
    made.content, made.count = manifest.content, manifest.count
    return made


def begin_dataset(draws: Draws, out: Path, *, resume: bool, overwrite: bool) -> Made:
    """Begin a data set that others make part by part (`make_part`), or look what one that was begun misses. Raises InputError."""
    from ...captures.store.publish import disk_error, partial_of
    from ..folders.progress import silent

    partial, identity = partial_of(out), identity_of(draws)
    complete, grown = _found(draws, out, identity, resume=resume, overwrite=overwrite)
    if complete is not None:
        return complete
    try:
        with opened(partial, draws, identity, resume=resume, overwrite=overwrite, grown=grown) as place:
            run = _Run(draws, partial, identity, place, silent)
            run.check_space()
            return Made(out, count=draws.data.captures, kept=run.kept, remade=place.damaged, missing=run.count)
    except OSError as error:
        raise disk_error(error, "Beginning the data set", out, f"beambench generate … -o {out} --resume") from error


def make_part(draws: Draws, out: Path, part: tuple[int, int], force: Force, tell: Progress) -> Made:
    """Make the missing shards k, k + n, k + 2n, … of a data set that was begun, beside other processes that make other parts.

    Main arguments:
        part: (k, n). The others are as of `make_dataset`. Nothing is completed: `make_dataset` with `resume` does that.

    Raises:
        InputError: as of `make_dataset`; a data set that was not begun.
    """
    from ...captures.store.journal import JOURNAL
    from ...captures.store.publish import disk_error, partial_of
    from ...captures.store.shard_finish import read_request
    from ...captures.store.shard_manifest import is_sharded, load_sharded

    partial, identity = partial_of(out), identity_of(draws)
    if not is_sharded(partial):
        if is_sharded(out):
            check_identity(out, load_sharded(out).facts.get("identity"), identity)
            return Made(out, load_sharded(out).content, load_sharded(out).count, kept=load_sharded(out).count)
        raise InputError(
            "The data set has not been begun.",
            where=str(partial),
            next_step="begin it by --slurm FILE, then submit that file",
        )
    try:
        with locked(partial / JOURNAL, shared=True) as lock:
            request = read_request(partial)
            check_identity(partial, request.get("identity"), identity)
            if request["count"] != draws.data.captures:
                raise InputError(
                    "The data set was begun with another number of captures.", where=str(partial), value=draws.data.captures,
                    allowed=str(request["count"]),
                )  # fmt: skip
            run = _Run(draws, partial, identity, Place(request, lock), tell, part)
            made = run.all(force)
        made.path, made.count = out, draws.data.captures
        return made
    except OSError as error:
        raise disk_error(error, "Making the data set", out, "free space, then submit the array again") from error


def _found(draws: Draws, out: Path, identity: str, *, resume: bool, overwrite: bool) -> tuple[Made | None, Path | None]:
    """(what is complete already, the store that is to grow), or None for each. Raises InputError for what is in the way."""
    from ...captures.store.publish import partial_of, refuse_existing
    from ...captures.store.shard_manifest import is_sharded, load_sharded

    if not (resume and is_sharded(out)):
        if not overwrite and is_sharded(out):
            _advise(draws, out, identity)
        refuse_existing(out, overwrite)
        return None, None
    manifest = load_sharded(out)
    check_identity(out, manifest.facts.get("identity"), identity)
    refuse_fewer(out, max(manifest.count, int(manifest.facts.get("asked", 0))), draws.data.captures)
    if partial_of(out).exists():
        return None, None
    if manifest.count == draws.data.captures:
        return Made(out, manifest.content, manifest.count, kept=manifest.count), None
    return None, out


def _advise(draws: Draws, out: Path, identity: str) -> None:
    """Refuse a complete store of this data set, and say what --resume would do. Raises InputError."""
    from ...captures.store.shard_manifest import load_sharded

    asked = draws.data.captures
    try:
        manifest = load_sharded(out)
    except InputError:
        return  # `refuse_existing` says what is in the way
    if manifest.facts.get("identity") != identity or asked < manifest.count:
        return
    grows = (
        f"--resume keeps them and makes {asked - manifest.count} more"
        if asked > manifest.count
        else f"with --resume it grows: --set captures={2 * asked} makes {asked} more"
    )
    raise InputError(
        f"The output exists: it holds {manifest.count} captures of this data set.", where=str(out),
        next_step=f"{grows}; or choose another --out, or add --overwrite",
    )  # fmt: skip


class _Run:
    """The shards that are missing, made by workers; of a `part` (k, n), every n-th from the k-th."""

    def __init__(
        self, draws: Draws, partial: Path, identity: str, place: Place, tell: Progress,
        part: tuple[int, int] = (0, 1),
    ) -> None:  # fmt: skip
        self._draws, self._partial, self._identity, self._tell = draws, partial, identity, tell
        self._groups: Mapping[str, Any] = place.request["groups"]
        self._place, self._part = place, part
        self._jobs = Jobs(draws, {name: one["length"] for name, one in self._groups.items()})
        own = [len(job.rows) for n, job in enumerate(self._jobs) if n % part[1] == part[0]]
        missing = [len(job.rows) for job in self._missing()]
        #: Shards that are missing, and captures that are there.
        self.count, self.kept = len(missing), sum(own) - sum(missing)
        self._total, self._done = sum(own), self.kept
        #: When the first capture came, and how many were there then.
        self._began: tuple[float, int] | None = None

    def all(self, force: Force) -> Made:
        """Make all missing shards. Raises InputError where some could not be made; all others are there then."""
        self.check_space()
        made = Made(self._partial, kept=self.kept)
        lost: list[Task] = []
        if self.count:
            self._tell("generate", self.kept, self._total, "workers start")
            with self._crew(force, self._place.lock) as crew:
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

    def _crew(self, force: Force, lock: IO[bytes]) -> Crew | Cluster:
        begin = {
            "root": str(self._partial.absolute()), "identity": self._identity, "resolved": self._draws.resolved(),
            "structures": {name: one["structure"] for name, one in self._groups.items()},
        }  # fmt: skip
        if force.dask is not None:
            from .cluster import Cluster

            return Cluster(begin, force.dask, limit_s=force.limit_s, expected_s=self._place.expected_s)
        count, threads = staff(force.workers, self.count)
        count = most_workers(max(one["decoded"] for one in self._groups.values()), count)
        return Crew(begin, count, threads, keep=lock.fileno(), limit_s=force.limit_s, expected_s=self._place.expected_s)

    def _missing(self) -> Iterator[Job]:
        from ...captures.store.shard_receipts import list_receipts

        there = {*list_receipts(self._partial)}
        for number, job in enumerate(self._jobs):
            if number % self._part[1] != self._part[0]:
                continue
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

    def check_space(self) -> None:
        """Refuse a data set that does not fit on the disk. Raises InputError."""
        needed = (self._total - self.kept) * max(one["stored"] for one in self._groups.values())
        free = free_bytes_at(self._partial)
        if needed > _SPACE * free:
            raise InputError(
                "The data set does not fit on the disk.", where=str(self._partial), value=f"about {needed / 1e9:.3g} GB",
                allowed=f"{free / 1e9:.3g} GB are free", next_step="free space, or choose another --out",
            )  # fmt: skip

    def _heard(self, index: int) -> None:
        self._done = min(self._done + 1, self._total - 1)
        now = time.monotonic()
        self._began = self._began or (now, self._done)
        passed, made = now - self._began[0], self._done - self._began[1]
        self._tell("generate", self._done, self._total, f"{made / passed:.3g} captures/s" if passed > 1.0 else "")


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
