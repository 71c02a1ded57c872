"""The plan of a data set before it is made: captures, parts, shards, size, time and free space, from a pilot of a few captures."""

from __future__ import annotations

import math
import re
import shutil
import time
from collections import Counter
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from ...scenes.datasets.spec import PARTS
from ...scenes.errors import InputError
from ...scenes.machine import free_bytes, usable_cores
from .crew import Crew, Task
from .jobs import Jobs, groups_of, identity_of, shard_length
from .sizes import stored_bytes

if TYPE_CHECKING:
    from ...scenes.datasets.draws import Draws

__all__ = [
    "Pilot",
    "check_parts",
    "free_bytes_at",
    "lengths_of",
    "most_workers",
    "outline",
    "pilot",
    "request_of",
    "staff",
]

#: Draws of a group that a plan makes, and those of the first that are left out of its times: kernels are loaded there.
_PILOT, _WARM = 10, 2
#: Resident memory of a worker beside its captures, bytes; copies of a capture that are held while it is made.
_WORKER_BYTES, _COPIES = 600 * 2**20, 12
#: Processor time that a worker's start takes, s.
_START_S = 4.0
#: The end of a warning that tells the size of an effect.
_SHARE = re.compile(r"(\d+)%\.$")


@dataclass(frozen=True)
class Pilot:
    """What a few captures of one group tell: layout, bytes of a capture in memory and on disk, processor time of one, s.

    `sizes`: bytes on disk, see `sizes`.
    """

    group: str
    structure: dict[str, Any]
    decoded: int
    stored: float
    sizes: dict[str, float]
    cpu_s: float
    warnings: tuple[str, ...]


def staff(workers: int | None, jobs: int) -> tuple[int, int]:
    """(workers, threads of each), workers × threads within the processors. Raises InputError for a number that is none."""
    cores = usable_cores()
    if workers is not None and not (1 <= workers <= 4096):
        raise InputError(
            "The number of workers is a whole number above 0.", where="--workers", value=workers, allowed=f"1 … {cores}"
        )
    if workers is not None and workers > cores:
        raise InputError(
            "There are fewer processors than workers.", where="--workers", value=workers,
            allowed=f"1 … {cores}, the processors that this process may use",
        )  # fmt: skip
    count = min(workers or cores, max(jobs, 1))
    return count, max(1, cores // count)


def pilot(draws: Draws, captures: int = _PILOT, told: Callable[[int], None] = lambda index: None) -> dict[str, Pilot]:
    """A few captures of each group, spread over the data set, made by a worker and not kept.

    Raises InputError: one cannot be made; two base scenes of one modality have different layouts.
    """
    begin = {"root": "", "structures": {}, "identity": "", "resolved": draws.resolved()}
    found: dict[str, Pilot] = {}
    with Crew(begin, 1, 1) as crew:
        for group, rows in _rows(draws, captures).items():
            task = Task(f"pilot of {group}", {"kind": "probe", "group": group, "rows": rows})
            for ended in crew.run([task], told):
                if ended.done is None:
                    raise ended.error or InputError(
                        "The pilot failed.", where=ended.name, value=ended.lost, next_step="beambench doctor"
                    )
                found[group] = _pilot_of(group, ended.done, rows, draws.data.repeats)
    return found


def _rows(draws: Draws, captures: int) -> dict[str, list[int]]:
    """Captures of the pilot: of every base scene at least one; of each draw the first, and the second, which costs less."""
    data = draws.data
    wanted: dict[str, list[int]] = {group: [] for group in groups_of(draws)}
    bases: Counter[str] = Counter()
    each = max(1, math.ceil(captures / len(data.scenes)))
    total = math.ceil(data.captures / data.repeats)
    for number in range(min(total, 1000 + 100 * len(data.scenes))):
        base = draws.base(number)
        if bases[base] < each:
            bases[base] += 1
            rows = range(number * data.repeats, min((number + 1) * data.repeats, data.captures))
            wanted[str(draws.scenes[base]["rig"]["kind"])] += rows[:2]
        if all(bases[one.label] >= each for one in data.scenes):
            break
    return {group: rows for group, rows in wanted.items() if rows}


def _pilot_of(group: str, told: Mapping[str, Any], rows: Sequence[int], repeats: int) -> Pilot:
    first = [cpu_s for row, cpu_s in zip(rows, told["cpu_s"], strict=True) if row % repeats == 0]
    again = [cpu_s for row, cpu_s in zip(rows, told["cpu_s"], strict=True) if row % repeats]
    first, again = first[_WARM:] or first, again[_WARM:] or again or first
    cpu_s = (sum(first) / len(first) + (repeats - 1) * sum(again) / len(again)) / repeats
    sizes = told["sizes"]
    return Pilot(
        group, told["structure"], int(told["decoded"]), sizes["capture"] + sizes["table"], sizes, cpu_s,
        tuple(told["warnings"]),
    )  # fmt: skip


def lengths_of(draws: Draws, pilots: Mapping[str, Pilot]) -> dict[str, int]:
    """Captures of a whole shard, by group: as many as the data set says, if it does."""
    asked = draws.data.per_shard
    return {
        name: asked or shard_length(one.decoded, len(one.structure), draws.data.captures)
        for name, one in pilots.items()
    }


def request_of(draws: Draws, identity: str, pilots: Mapping[str, Pilot]) -> dict[str, Any]:
    """What a store records of the request, with the layout of its groups."""
    from ...captures.sources import bare_scene
    from ...scenes.datasets.distributions import Choice, Expressed, Grid

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


def outline(draws: Draws, out: Path, workers: int | None) -> dict[str, Any]:
    """The plan: what is made, how large it is, how long it takes, and where it goes.

    Main arguments:
        out: where the data set will be written; the free space is that of its disk. workers: as of `generate`.

    Raises:
        InputError: a scene that cannot be made, a part of the split without captures, more workers than processors.
    """
    from ...captures.store.shard_finish import request_bytes

    pilots = pilot(draws)
    jobs = Jobs(draws, lengths_of(draws, pilots))
    count, threads = staff(workers, len(jobs))
    groups = []
    # The request, twice, and what else stands beside the groups; all scenes are drawn once before they are made.
    size, files = 2.0 * len(request_bytes(request_of(draws, identity_of(draws), pilots))), 5.0
    began = time.process_time()
    parts, scenes = check_parts(draws)
    seconds = time.process_time() - began
    for name, one in pilots.items():
        number = jobs.count(name)
        shards = math.ceil(number / jobs.lengths[name])
        groups.append({
            "group": name, "captures": number, "shards": shards, "captures_per_shard": jobs.lengths[name],
            "bytes_per_capture": round(one.stored), "cpu_s_per_capture": one.cpu_s,
        })  # fmt: skip
        seconds += number * one.cpu_s
        size += stored_bytes(one.sizes, number, jobs.lengths[name])
        files += shards * (len(one.structure) + 2) + len(one.structure) + 1
    free = free_bytes_at(out)
    return {
        "dataset": draws.data.dataset, "captures": draws.data.captures, "groups": groups, "parts": parts,
        "distinct_scenes": scenes, "bytes": round(size), "free_bytes": free, "fits": size < free, "files": round(files),
        "workers": count, "threads": threads, "cpu_s": seconds + _START_S * count,
        "wall_s": seconds / count + _START_S,
        "warnings": _in_one({told for one in pilots.values() for told in one.warnings}),
    }  # fmt: skip


def _in_one(warnings: Iterable[str]) -> list[str]:
    """Warnings of captures that differ in the percentage at their end alone as one, "by 37% to 111%."."""
    shares: dict[str, list[int]] = {}
    for told in warnings:
        match = _SHARE.search(told)
        shares.setdefault(told[: match.start()] if match else told, []).extend([int(match[1])] if match else [])
    ends = {text: sorted({min(values), max(values)}) for text, values in shares.items() if values}
    return [
        text + " to ".join(f"{end}%" for end in ends[text]) + "." if text in ends else text for text in sorted(shares)
    ]


def check_parts(draws: Draws) -> tuple[dict[str, int], int]:
    """(captures of each part, number of distinct scenes).

    Raises:
        InputError: a part with a share has no capture; draws of one scene are in two parts, by a `by` that is finer than scenes.
    """
    data = draws.data
    total = math.ceil(data.captures / data.repeats)
    # Nine bytes a scene, for any number of them: by chance two of 10⁶ hashes of 64 bits are equal once in 4 · 10⁷.
    content, part = np.empty(total, np.uint64), np.empty(total, np.uint8)
    names = ["", *PARTS]
    for number in range(total):
        drawn = draws.drawn(number)
        content[number] = int(draws.content(drawn)[:16], 16)
        part[number] = names.index(draws.part(drawn))
    count = np.full(total, data.repeats)
    count[-1] = data.captures - (total - 1) * data.repeats
    parts = {name: int(count[part == n].sum()) for n, name in enumerate(names) if (part == n).any()}
    order = np.lexsort((part, content))
    content, part = content[order], part[order]
    same = content[1:] == content[:-1]
    if (part[1:] != part[:-1])[same].any():
        raise InputError(
            "One scene is in two parts of the split.", where="split.by", value=None if data.split is None else data.split.by,
            next_step="leave out `by`",
        )  # fmt: skip
    distinct = total - int(np.count_nonzero(same))
    split = data.split
    if split is not None:
        empty = [name for name in PARTS if getattr(split, name) > 0 and not parts.get(name)]
        if empty:
            raise InputError(
                "A part of the split has no capture: all captures of one scene are in one part.", where="split",
                value=", ".join(empty), allowed=f"{distinct} distinct scenes (target and medium) are drawn",
                next_step="draw more of target or medium, make more captures, or leave out the split",
            )  # fmt: skip
    return parts, distinct


def free_bytes_at(out: Path) -> int:
    """Free space of the disk that a path is, or will be, on."""
    place = out.absolute()
    while not place.exists():
        place = place.parent
    return int(shutil.disk_usage(place).free)


def most_workers(decoded: int, wanted: int) -> int:
    """As many workers as the free memory holds, at least one."""
    return max(1, min(wanted, free_bytes() // (_WORKER_BYTES + _COPIES * decoded)))
