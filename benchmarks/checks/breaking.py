"""`beambench break` on known bugs: how many of twenty are found, and how short the suites that show them are.

    python -m beambench.benchmarks.checks.breaking                 the search alone, bugs as functions of the candidate: seconds
    python -m beambench.benchmarks.checks.breaking --captures 20   estimators with a fault, on generated captures: minutes each

A bug makes an estimator thirty times worse in a region of the search space: an end or a window of one axis (a twelfth of
its span), of two (a third of each) or of three (half of each). A bug counts as found where the candidate lies in the
region, names its axes and no others, and is a suite of at most ten lines; on captures that suite is also run again, and
must give the same numbers.
"""

from __future__ import annotations

import argparse
import math
import tempfile
import time
import zlib
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ..search.breaker import search_and_shrink, suite_text
from ..search.space import SPACE, Candidate
from ..suites.stress import stressed
from .gated_planted import DIMENSIONS, READABLE, Region, inside, region_text, registered

__all__ = ["Found", "PlantedJudge", "check_captures", "check_search", "holds", "planted_regions"]

#: The simplest first, as for a real search.
_SCENES = ("flat-wall", "tilted-wall")
_LINES = 10


@dataclass(frozen=True)
class Found:
    """Result of the search for one bug: found in its region, with its axes only; lines of the suite; whether the suite
    repeats bit for bit (None where a function judged the search); candidates judged, and seconds."""

    region: Region
    found: bool
    axes: tuple[str, ...]
    lines: int
    replays: bool | None
    judged: int
    wall_s: float

    @property
    def good(self) -> bool:
        """Found, short, and repeated."""
        return self.found and set(self.axes) == set(self.region) and self.lines <= _LINES and self.replays is not False


def planted_regions(count: int, *, axes: Sequence[str] | None = None, seed: int = 20260101) -> list[Region]:
    """`count` regions, of one, two and three axes in turn.

    Other arguments:
        axes: to choose from; by default all axes of the space. An axis of few values (`coarse`) gets no window of its own.
    """
    rng = np.random.default_rng(seed)
    names = [dimension.axis for dimension in SPACE if axes is None or dimension.axis in axes]
    regions = []
    for number in range(count):
        size = 1 + number % 3
        width = {1: 1 / 12, 2: 1 / 3, 3: 1 / 2}[size]
        fine = [name for name in names if not (DIMENSIONS[name].coarse and size == 1)]
        region: Region = {}
        for axis in rng.choice(fine, size=size, replace=False):
            low = float(rng.choice([0.0, 1.0 - width])) if number % 2 else float(rng.uniform(0.0, 1.0 - width))
            region[str(axis)] = (low, low + width)
        regions.append(region)
    return regions


def holds(region: Region, candidate: Candidate) -> bool:
    """Whether a candidate names all axes of a region, with levels inside."""
    levels = dict(candidate.levels)
    return all(
        axis in levels and low - 1e-9 <= DIMENSIONS[axis].position(levels[axis]) <= high + 1e-9
        for axis, (low, high) in region.items()
    )


class PlantedJudge:
    """log10 of the error ratio of an estimator with a bug: log10 30 in the region; elsewhere it differs from other
    estimators by noise."""

    def __init__(self, region: Region) -> None:
        self.region, self.calls = region, 0

    def __call__(self, candidate: Candidate, seed: int) -> float:
        self.calls += 1
        rng = np.random.default_rng([zlib.crc32(repr(candidate).encode()), seed])
        return float(rng.normal(0.1, 0.1)) + (math.log10(30.0) if holds(self.region, candidate) else 0.0)


def check_search(regions: Sequence[Region], *, budget: int = 300) -> Iterator[Found]:
    """Search for each bug with a function as judge."""
    from ...scenes.load import load_scene

    for number, region in enumerate(regions):
        start = time.perf_counter()
        search = search_and_shrink(PlantedJudge(region), _SCENES, SPACE, budget=budget, seed=number)
        candidate = search.find.candidate if search.find is not None else None
        lines = 0
        if candidate is not None:
            overrides = stressed(load_scene(candidate.scene), candidate.levels)[1]
            text = suite_text("found", "a note", candidate.scene, overrides, ["a", "b"], number, "found.toml")
            lines = len(text.splitlines())
        found = candidate is not None and holds(region, candidate)
        axes = candidate.axes if candidate is not None else ()
        yield Found(region, found, axes, lines, None, search.judged, time.perf_counter() - start)


def check_captures(count: int, *, budget: int = 300, side: int = 8) -> Iterator[Found]:
    """Search for each bug of an estimator that runs on generated captures, and repeat each result."""
    from ...scenes.declared import declared_rig
    from ...scenes.load import load_scene
    from ..run import run_suite
    from ..search.break_run import break_estimator

    rig = declared_rig(load_scene(_SCENES[0]))
    # A fault that shows on the unmodified scene does not count: the estimator would be worse everywhere.
    regions = [
        region
        for region in planted_regions(4 * count, axes=tuple(READABLE))
        if not any(inside(region_text({axis: span}), rig) for axis, span in region.items())
    ][:count]
    with registered():
        for number, region in enumerate(regions):
            start = time.perf_counter()
            label = f"planted[region={region_text(region)}]"
            with tempfile.TemporaryDirectory(prefix="beambench-break-check-") as folder:
                out = Path(folder)
                result = break_estimator(
                    label, out, neighbours=["poisson-ml"], scenes=_SCENES[:1], side=side, budget=budget, seed=number
                )
                lines, replays = 0, None
                if result.spec is not None:
                    lines = len(result.spec.read_text(encoding="utf-8").splitlines())
                    again = run_suite(result.spec, out / "again", report=False).rows
                    first = {row["estimator"]: row for row in result.rows}
                    names = ("rmse_full", "bias", "coverage", "bound")
                    replays = all(row[name] == first[row["estimator"]][name] for row in again for name in names)
            candidate = Candidate(result.scene, tuple(sorted(result.levels.items())))
            found = result.found and holds(region, candidate)
            yield Found(region, found, candidate.axes, lines, replays, result.judged, time.perf_counter() - start)


def main(arguments: Sequence[str] | None = None) -> int:
    """Print one line per bug and the count; return 1 where fewer than 19 of 20 are found with short suites."""
    parser = argparse.ArgumentParser(prog="python -m beambench.benchmarks.checks.breaking", description=__doc__)
    parser.add_argument("--captures", type=int, metavar="N", help="N estimators with a fault on generated captures")
    parser.add_argument("--count", type=int, default=20, help="bugs in the test of the search alone")
    parser.add_argument("--budget", type=int, default=300)
    chosen = parser.parse_args(arguments)
    if chosen.captures is not None:
        results = check_captures(chosen.captures, budget=chosen.budget)
    else:
        results = check_search(planted_regions(chosen.count), budget=chosen.budget)
    good = total = 0
    for one in results:
        total, good = total + 1, good + one.good
        where = region_text(one.region)
        replay = "" if one.replays is None else ", repeats" if one.replays else ", does not repeat"
        what = f"{one.lines} lines{replay}, axes {' '.join(one.axes)}" if one.found else "not found"
        print(f"{where:70} {what} ({one.judged} judged, {one.wall_s:.1f} s)", flush=True)
    print(f"{good} of {total} found, with their axes only and in at most {_LINES} lines")
    return int(good < math.ceil(0.95 * total))


if __name__ == "__main__":
    raise SystemExit(main())
