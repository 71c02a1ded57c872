"""`beambench break`: search for scenes in which an estimator fails but its neighbours do not, and simplify the failure.

The badness of a candidate is log10 of the estimator's full RMSE over a reference: the smallest full RMSE of its neighbours,
or the local bound if that is larger. Therefore scenes that are hard for every estimator do not count. For an estimator that
crashes, hangs or breaks the contract 1 is added, as its elements already count with the prior's error.

Each axis is tried alone at both ends. Of the remaining budget 60 % is drawn at random, and 40 % by mutation of the worst
candidate so far, in ever smaller steps. A failure is confirmed with another seed, shrunk, and written as a suite of at most
ten lines, which `beambench run` repeats bit for bit.
"""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from ..folders.progress import Progress, silent
from .shrink import shrink
from .space import Candidate, Dimension, draw, ends, mutate

__all__ = ["Find", "Judge", "Search", "search_and_shrink", "suite_text"]

#: (candidate, seed) -> badness; −inf for a candidate that is not a possible scene.
Judge = Callable[[Candidate, int], float]

_POOL = 6
_WIDTHS = (0.25, 0.04)


@dataclass(frozen=True)
class Find:
    """A failure: the smallest candidate that shows it, its badness there, and the candidate that first showed it."""

    candidate: Candidate
    badness: float
    first: Candidate
    first_badness: float


@dataclass
class Search:
    """Result of a search: every candidate with its badness, in order, and the failure, if one was detected."""

    seen: list[tuple[Candidate, float]] = field(default_factory=list)
    find: Find | None = None
    judged: int = 0

    @property
    def worst(self) -> tuple[Candidate, float]:
        """The candidate with the largest badness."""
        return max(self.seen, key=lambda pair: pair[1])


class _Memory:
    """Judge each pair of candidate and seed only once."""

    def __init__(self, judge: Judge) -> None:
        self.judge, self.known = judge, dict[tuple[Candidate, int], float]()

    def __call__(self, candidate: Candidate, seed: int) -> float:
        key = (candidate, seed)
        if key not in self.known:
            badness = self.judge(candidate, seed)
            self.known[key] = -math.inf if math.isnan(badness) else badness
        return self.known[key]


def search_and_shrink(
    judge: Judge,
    scenes: Sequence[str],
    space: Sequence[Dimension],
    *,
    factor: float = 3.0,
    budget: int = 300,
    seed: int = 0,
    progress: Progress = silent,
) -> Search:
    """Search the space, confirm the worst candidate, and shrink it.

    Main arguments:
        judge: returns the badness of a candidate with a seed. scenes: names, the simplest first. space: the dimensions.
    Other arguments:
        factor: least ratio of the estimator's error to that of its best neighbour in a failure, and to its own error on the
            unchanged simplest scene: an estimator that is always worse does not count as a failure.
        budget: number of candidates judged before shrinking. seed: random seed of the search; it and the next one are the
            seeds of the captures.
    """
    rng = np.random.Generator(np.random.PCG64(seed))
    remember = _Memory(judge)
    search = Search()
    usual = max(remember(Candidate(scene, ()), seed) for scene in scenes)
    threshold = math.log10(factor) + max(usual, 0.0)
    pool: list[tuple[float, Candidate]] = []
    alone = ends(scenes[0], space)[:budget]
    random_until = len(alone) + round(0.6 * (budget - len(alone)))
    for count in range(budget):
        progress("search", count, budget, f"{len(pool)} kept")
        if count < len(alone):
            candidate = alone[count]
        elif count < random_until or not pool:
            candidate = draw(rng, scenes, space)
        else:
            share = (count - random_until) / (budget - random_until)
            width = _WIDTHS[0] * (_WIDTHS[1] / _WIDTHS[0]) ** share
            candidate = mutate(rng, pool[int(rng.integers(len(pool)))][1], scenes, space, width)
        badness = remember(candidate, seed)
        search.seen.append((candidate, badness))
        if math.isfinite(badness) and all(candidate != other for _, other in pool):
            pool = sorted([*pool, (badness, candidate)], key=lambda pair: -pair[0])[:_POOL]
    progress("search", budget, budget, "")

    def fails(candidate: Candidate, least: float) -> bool:
        return remember(candidate, seed) >= least and remember(candidate, seed + 1) >= least

    for badness, candidate in pool:
        if not fails(candidate, threshold):
            continue
        # The shrunk candidate must show the same failure: not below the threshold, nor far below the original badness.
        least = max(threshold, 0.7 * min(badness, remember(candidate, seed + 1)))
        progress("shrink", 0, 1, "")
        small = shrink(candidate, lambda c, least=least: fails(c, least), list(scenes), space)  # type: ignore[misc]
        search.find = Find(small, remember(small, seed), candidate, badness)
        progress("shrink", 1, 1, "")
        break
    search.judged = len(remember.known)
    return search


def suite_text(
    name: str, note: str, scene: str, overrides: dict[str, Any], estimators: Sequence[str], seed: int, file: str
) -> str:
    """The failure as a suite file of at most ten lines.

    Main arguments:
        name: name of the suite. note: description in one line. scene: name or path. overrides: {path: value}.
        estimators: labels. seed: random seed of the capture. file: name of the file, for the command in the first line.
    """
    lines = [f"# beambench run {file}", f"# {' '.join(note.split())}", f"suite = {json.dumps(name)}"]
    lines += [f"estimators = {json.dumps(list(estimators))}", f"seeds.test = [{seed}]", "[[scenes]]"]
    lines.append(f"scene = {json.dumps(scene)}")
    if overrides:
        inside = ", ".join(f"{json.dumps(path)} = {_toml(value)}" for path, value in sorted(overrides.items()))
        lines.append(f"overrides = {{ {inside} }}")
    return "\n".join(lines) + "\n"


def _toml(value: Any) -> str:
    """A plain value in TOML, on one line; numbers keep all their digits."""
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, int | float):
        return repr(value)
    if isinstance(value, list | tuple):
        return "[" + ", ".join(map(_toml, value)) + "]"
    if isinstance(value, dict):
        return "{ " + ", ".join(f"{json.dumps(k)} = {_toml(v)}" for k, v in value.items()) + " }"
    return json.dumps(value, ensure_ascii=False)
