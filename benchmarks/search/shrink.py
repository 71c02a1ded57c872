"""Simplify a failure: fewer axes, milder levels and rounder numbers, as long as the estimator still fails.

Axes are removed by delta debugging (Zeller and Hildebrandt 2002): complements of ever finer parts are tried until no
single axis can be removed. Then levels are halved towards their benign end and rounded.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

from .space import Candidate, Dimension, rounded

__all__ = ["minimal_axes", "shrink"]

Test = Callable[[Candidate], bool]

#: Number of halvings of the distance between a level and its benign end.
_HALVINGS = 5


def minimal_axes(find: Candidate, fails: Test) -> Candidate:
    """`find` with a minimal set of axes: without any one of them the estimator no longer fails (ddmin)."""
    parts = 2
    while find.levels:
        axes = find.axes
        parts = min(parts, len(axes))
        size = -(-len(axes) // parts)
        groups = [axes[i : i + size] for i in range(0, len(axes), size)]
        for group in groups:
            smaller = find.without(group)
            if fails(smaller):
                find, parts = smaller, max(parts - 1, 2)
                break
        else:
            if parts >= len(axes):
                return find
            parts = min(2 * parts, len(axes))
    return find


def _plainer(find: Candidate, fails: Test, scenes: Sequence[str]) -> Candidate:
    """The same levels in the simplest scene that still fails."""
    for scene in scenes[: scenes.index(find.scene)] if find.scene in scenes else ():
        if fails(Candidate(scene, find.levels)):
            return Candidate(scene, find.levels)
    return find


def shrink(find: Candidate, fails: Test, scenes: Sequence[str], space: Sequence[Dimension]) -> Candidate:
    """The smallest candidate on the way from `find` that still fails.

    Main arguments:
        fails: returns whether a candidate still shows the failure. scenes: the simplest first.
    """
    find = _plainer(minimal_axes(_plainer(find, fails, scenes), fails), fails, scenes)
    by_axis = {dimension.axis: dimension for dimension in space}
    for axis, level in find.levels:
        dimension = by_axis[axis]
        bad, good = dimension.position(level), dimension.position(dimension.neutral)
        for _ in range(_HALVINGS):
            middle = 0.5 * (bad + good)
            milder = dimension.level(middle)
            if milder != dict(find.levels)[axis] and fails(find.at(axis, milder)):
                find, bad = find.at(axis, milder), middle
            else:
                good = middle
        rounder = rounded(dict(find.levels)[axis], 1)
        if rounder != dict(find.levels)[axis] and dimension.low <= rounder <= dimension.high:
            find = find.at(axis, rounder) if fails(find.at(axis, rounder)) else find
    return minimal_axes(find, fails)
