"""The table of a campaign of attempts on the project's reliability: tries, held and failed by part, and each failure in a line."""

from __future__ import annotations

import os
import sys
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field

from ..runner.tree import memory_bytes

__all__ = ["Attempts", "peak_memory", "print_attempts", "shares"]


@dataclass
class Attempts:
    """One part of a campaign.

    Main arguments:
        part: its name. tries: attempts made. failures: one line for each that did not hold.
    Other arguments:
        notes: {name: count} of what else was counted, such as "refused". peak_bytes: most memory of a process of an attempt, 0
            where it was not measured.
    """

    part: str
    tries: int = 0
    failures: list[str] = field(default_factory=list)
    notes: dict[str, int] = field(default_factory=dict)
    peak_bytes: int = 0

    def used(self, peak_bytes: int) -> None:
        """Take note of the most resident memory of a process of an attempt."""
        self.peak_bytes = max(self.peak_bytes, peak_bytes)

    def held(self, note: str = "") -> None:
        """Count an attempt that held."""
        self.tries += 1
        if note:
            self.notes[note] = self.notes.get(note, 0) + 1
        self._tell()

    def failed(self, told: str) -> None:
        """Count an attempt that did not hold."""
        self.tries += 1
        self.failures.append(told)
        print(f"FAILED {self.part}: {told}", file=sys.stderr, flush=True)
        self._tell()

    def _tell(self) -> None:
        """Every tenth attempt, how far the part is: a campaign that is ended early has figures too."""
        if self.tries % 10 == 0:
            told = ", ".join(f"{count} {name}" for name, count in sorted(self.notes.items()))
            print(f"{self.part}: {self.tries} tries, {len(self.failures)} failed; {told}", file=sys.stderr, flush=True)


def peak_memory() -> int:
    """The most resident memory that this process had since it was executed, in bytes.

    `ru_maxrss` is not it: a process inherits there the peak of the one that started it, however large that was.
    """
    return memory_bytes(os.getpid(), "VmHWM")


def shares(total: int, weights: Iterable[float]) -> list[int]:
    """`total` attempts divided by weight, the first parts getting what is left over."""
    weights = list(weights)
    parts = [int(total * weight / sum(weights)) for weight in weights]
    return [part + (index < total - sum(parts)) for index, part in enumerate(parts)]


def _rows(parts: Iterable[Attempts]) -> Iterator[str]:
    yield "| part | tries | held | failed | of those that held | peak MiB |"
    yield "|---|---|---|---|---|---|"
    tries = failed = 0
    for part in parts:
        notes = ", ".join(f"{count} {name}" for name, count in sorted(part.notes.items()))
        peak = f"{part.peak_bytes / 2**20:,.0f}" if part.peak_bytes else ""
        held = part.tries - len(part.failures)
        yield f"| {part.part} | {part.tries:,} | {held:,} | {len(part.failures)} | {notes} | {peak} |"
        tries, failed = tries + part.tries, failed + len(part.failures)
    yield f"| all | {tries:,} | {tries - failed:,} | {failed} | | |"


def print_attempts(parts: list[Attempts]) -> int:
    """Print the table, then every failure. Returns the exit code: 1 where an attempt failed."""
    print(*_rows(parts), sep="\n")
    for part in parts:
        for told in part.failures:
            print(f"failed: {part.part}: {told}")
    return int(any(part.failures for part in parts))
