"""The result of a run in sentences: the most accurate and the fastest estimator, and where each estimator fails."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import chain
from typing import TYPE_CHECKING, Any

from ..statistics.skips import skip_reason
from .above_bound import above_bound
from .cell import Cell, common_noun
from .data import base_cells, by_quantity, cells_of, seeds_of, unit_scale
from .numbers import number, rate, time_text, times_text

if TYPE_CHECKING:
    import pandas as pd

__all__ = [
    "Ranked", "beaten_by_best", "closing_lines", "failures_of", "listed", "plural", "rank", "skips_of_cells", "summary",
]  # fmt: skip


@dataclass(frozen=True)
class Ranked:
    """One estimator over all unstressed cells.

    `error_ratio`: geometric mean over cells of rmse_full / (the smallest rmse_full there), ≥ 1. `bound_ratio`: the same
    over the bound, in cells where that is exact. `cpu_per_element_s`: geometric mean. `cells` of `total` gave a result.
    """

    label: str
    error_ratio: float
    bound_ratio: float
    cpu_per_element_s: float
    coverage: float
    cells: int
    total: int


def rank(cells: list[Cell]) -> list[Ranked]:
    """Estimators from the most to the least accurate; those without a result in every cell come last. Suspect ones (better
    than their bound by more than chance) are left out."""
    best: dict[tuple[str, ...], float] = {}
    suspect = {cell.label for cell in cells if cell.suspect}
    cells = [cell for cell in cells if cell.label not in suspect]
    for cell in cells:
        if cell.ok and cell.rmse_full >= 0:
            best[_where(cell)] = min(best.get(_where(cell), math.inf), cell.rmse_full)
    ranked = []
    total = len({_where(cell) for cell in cells})
    for label in dict.fromkeys(cell.label for cell in cells):
        mine = [c for c in cells if c.label == label and c.ok and c.rmse_full >= 0]
        ranked.append(
            Ranked(
                label,
                _geometric([_over(c.rmse_full, best[_where(c)]) for c in mine]),
                _geometric([c.rmse_full / c.bound for c in mine if c.bound > 0 and c.bound_kind == "exact"]),
                _geometric([c.cpu_per_element_s for c in mine if c.cpu_per_element_s > 0]),
                min((c.coverage for c in mine), default=math.nan),
                len(mine),
                total,
            )
        )
    return sorted(ranked, key=lambda r: (-r.cells, r.error_ratio if math.isfinite(r.error_ratio) else math.inf))


def _where(cell: Cell) -> tuple[str, ...]:
    return (cell.scene, cell.stage, cell.quantity, cell.condition, cell.stress, cell.level, cell.stress2, cell.level2)


def _over(error: float, smallest: float) -> float:
    """error/smallest, where both may be zero (a scene without noise)."""
    return error / smallest if smallest > 0 else 1.0 if error == 0 else math.inf


def _geometric(values: list[float]) -> float:
    if 0.0 in values:
        return 0.0
    return math.exp(sum(map(math.log, values)) / len(values)) if values else math.nan


def _one_condition(cells: list[Cell]) -> tuple[list[Cell], str]:
    """The cells of one condition ("matched" if present) and its name in parentheses: conditions are never pooled."""
    names = list(dict.fromkeys(cell.condition for cell in cells))
    chosen = "matched" if "matched" in names else (names[0] if names else "")
    return [c for c in cells if c.condition == chosen], f" ({chosen})" if len(names) > 1 else ""


def beaten_by_best(
    cells: list[Cell], ranked: list[Ranked], pairs: Sequence[Mapping[str, Any]] = ()
) -> tuple[int, int, str]:
    """Numbers of estimators (significantly worse than the first of `ranked`, others in all) with results in as many cells, and
    what that rests on: "over scenes", "on these scenes" or, where nothing is decided, "".

    Main arguments:
        cells: of one condition, without stress. ranked: see `rank`.
    Other arguments:
        pairs: rows of pairs.csv; without them the pairs are compared over scenes, of which at least six are needed.
    """
    names = {r.label for r in ranked if r.cells == ranked[0].cells}
    best = ranked[0].label
    rows = list(pairs) or _over_scenes(cells, sorted(names))
    mine = [
        row
        for row in rows
        if {row["a"], row["b"]} <= names
        and best in (row["a"], row["b"])
        and str(row.get("condition", "")) in ("", *(cell.condition for cell in cells[:1]))
        and not str(row.get("quantity", "")).endswith("-mixed")
    ]
    bases = {str(row.get("basis", "")) for row in mine} & {"scenes", "captures", "tiles"}
    # An estimator with several quantities is better only where it is better in all of them.
    won: dict[str, bool] = {}
    here: dict[str, bool] = {}
    for row in mine:
        other = str(row["b"] if row["a"] == best else row["a"])
        won[other] = won.get(other, True) and row["winner"] == best
        here[other] = here.get(other, True) and row.get("winner_here") == best
    told = "on these scenes" if bases & {"captures", "tiles"} else "over scenes" if bases else ""
    if told == "over scenes" and sum(here.values()) > sum(won.values()):
        told += f", {sum(here.values())} on these scenes"
    return sum(won.values()), len(names) - 1, told


def _over_scenes(cells: list[Cell], names: list[str]) -> list[dict[str, Any]]:
    """Pairs of estimators over scenes, by paired differences corrected for their number, as rows of pairs.csv."""
    from ..statistics.bootstrap import MIN_SCENES
    from ..statistics.pairs import pairwise

    scenes = sorted({cell.scene for cell in cells})
    squares: dict[tuple[str, str], list[tuple[float, float]]] = {}
    for cell in cells:
        if cell.ok and cell.rmse_full >= 0:
            squares.setdefault((cell.label, cell.scene), []).append((cell.n, cell.n * cell.rmse_full**2))
    kept = [s for s in scenes if all((name, s) in squares for name in names)]
    if len(names) < 2 or not kept:
        return []
    sums = [[[sum(part) for part in zip(*squares[name, s], strict=True)] for s in kept] for name in names]
    figures = [[max(math.sqrt(square / n), 1e-150) if n > 0 else math.nan for n, square in row] for row in sums]
    if not all(map(math.isfinite, chain.from_iterable(figures))):
        return []
    basis = "scenes" if len(kept) >= MIN_SCENES else ""
    return [{"a": p.a, "b": p.b, "winner": p.winner, "basis": basis} for p in pairwise(names, figures)]


def failures_of(cells: list[Cell]) -> dict[str, list[Cell]]:
    """For each estimator, the cells in which it did not run or failed on more than a tenth of the elements."""
    return {
        label: [cell for cell in cells if cell.label == label and cell.fails]
        for label in dict.fromkeys(cell.label for cell in cells)
    }


def skips_of_cells(cells: list[Cell]) -> dict[str, str]:
    """Reason for which an estimator was skipped, by label; several reasons are joined."""
    found: dict[str, dict[str, None]] = {}
    for cell in cells:
        for status in cell.statuses:
            if reason := skip_reason(status):
                found.setdefault(cell.label, {})[reason] = None
    return {label: "; ".join(reasons) for label, reasons in found.items()}


def summary(table: pd.DataFrame, pairs: Sequence[Mapping[str, Any]] = ()) -> list[str]:
    """Three sentences: the smallest error and its significance, the fastest estimator, and the estimators that fail.

    Of several quantities the first only introduces, and a sentence for each stands between it and the last.

    Main arguments:
        table: scores. pairs: rows of pairs.csv, if there are any.
    """
    cells = cells_of(table)
    base, where = _one_condition(base_cells(cells))
    ranked = [r for r in rank(base) if r.cells]
    fallen = _standing(base)[1]
    said = failures_of([cell for cell in cells if not cell.mixed])
    scenes, seeds = len({cell.scene for cell in cells}), len(seeds_of(table))
    if not ranked:
        return [
            "No estimator gave a result.",
            f"{plural(scenes, 'scene')} and {plural(seeds, 'seed')} were tried.",
            "The list of failures below gives the reasons.",
        ]
    tried = f"{plural(scenes, 'scene')} and {plural(seeds, 'seed')}{where}"
    if fallen:
        return [f"On {tried}, {fallen}.", "So none is called the most accurate, or the fastest.", _failing(cells, said)]
    groups = by_quantity(base)
    standing = _standing(base)[0]
    return [
        *(_of_each(groups, tried) if len(groups) > 1 else _of_one(base, standing, pairs, tried)),
        _failing(cells, said),
    ]


def _of_each(groups: Mapping[str, list[Cell]], tried: str) -> list[str]:
    """A sentence for each quantity, the smallest error and the fastest estimator: those of different ones have no order."""
    said = [f"On {tried}, by what is estimated:"]
    for name, cells in groups.items():
        ranked, fallen = _standing(cells)
        if not ranked:
            said += [f"{name}: {fallen}."] if fallen else []
            continue
        best, fastest = ranked[0], _fastest(ranked)
        example = min((c for c in cells if c.label == best.label and c.ok), key=lambda c: c.rmse_full)
        factor, unit = unit_scale(example)
        least = f"{name}: {best.label} has the smallest error, down to {number(example.rmse_full * factor)} {unit}"
        time = f"{time_text(fastest.cpu_per_element_s)} of CPU time per {common_noun(cells)}"
        if not fastest.cpu_per_element_s > 0:  # estimates of another program, which states no times
            said.append(f"{least}.")
        elif fastest.label == best.label:
            said.append(f"{least}; it is also the fastest, {time}.")
        else:
            ratio = times_text(fastest.error_ratio)
            said.append(f"{least}; {fastest.label} is the fastest, {time} at {ratio} times the smallest error.")
    return said


def _of_one(base: list[Cell], ranked: list[Ranked], pairs: Sequence[Mapping[str, Any]], tried: str) -> list[str]:
    """The most accurate estimator and its significance, and the fastest, of one quantity."""
    best, fastest, noun = ranked[0], _fastest(ranked), common_noun(base)
    example = min((c for c in base if c.label == best.label and c.ok), key=lambda c: c.rmse_full, default=None)
    factor, unit = unit_scale(example) if example else (1.0, "")
    detail = f": down to {number(example.rmse_full * factor)} {unit} ({example.scene})" if example else ""
    near = (
        f", on average {_of_bound(best.bound_ratio)} times the exact bound" if math.isfinite(best.bound_ratio) else ""
    )
    beaten, others, basis = beaten_by_best(base, ranked, pairs)
    claim = "is the most accurate" if beaten == others > 0 else "has the smallest error"
    if beaten == others:
        doubt = " on these scenes" if others and basis == "on these scenes" else ""
    elif basis:
        doubt = f"; {beaten} of {plural(others, 'other')} significantly worse {basis}"
    else:
        doubt = "; too few scenes to say which differences are significant"
    first = f"On {tried}, {best.label} {claim}{detail}{near}{doubt}."
    if not fastest.cpu_per_element_s > 0:
        return [first]
    if fastest.label == best.label:
        second = f"It is also the fastest, with {time_text(fastest.cpu_per_element_s)} of CPU time per {noun}."
    else:
        second = (
            f"{fastest.label} is the fastest, with {time_text(fastest.cpu_per_element_s)} of CPU time per {noun} "
            f"({times_text(best.cpu_per_element_s / fastest.cpu_per_element_s)} times less than {best.label}) "
            f"at {times_text(fastest.error_ratio)} times the smallest error."
        )
    return [first, second]


def _failing(cells: list[Cell], said: Mapping[str, list[Cell]]) -> str:
    """How many estimators fail, and which."""
    noun = common_noun(cells)
    failing = [label for label, places in said.items() if places]
    mixed = [label for label, places in failures_of([cell for cell in cells if cell.mixed]).items() if places]
    apart = f" On mixed {noun}s, which are scored apart, {plural(len(mixed), 'estimator')} did." if mixed else ""
    if failing:
        several = "estimators fail" if len(failing) > 1 else "estimator fails"
        third = f"{len(failing)} {several} on more than 10 % of the {noun}s in at least one case: {listed(failing)}."
    else:
        third = f"No estimator fails on more than 10 % of the {noun}s in any case."
    return third + apart


def _fastest(ranked: list[Ranked]) -> Ranked:
    most = max(r.cells for r in ranked)
    timed = [r for r in ranked if r.cells == most and r.cpu_per_element_s > 0]
    return min(timed or ranked, key=lambda r: r.cpu_per_element_s)


def closing_lines(scores: pd.DataFrame, pairs: Sequence[Mapping[str, Any]] = ()) -> list[str]:
    """The last lines of a run in the terminal: most accurate and fastest estimator, results better than their bound, and where
    each estimator fails.

    Main arguments:
        scores: the table. pairs: rows of pairs.csv, if there are any.
    """
    cells = cells_of(scores)
    base, where = _one_condition(base_cells(cells))
    groups = by_quantity(base)
    lines = []
    for name, group in groups.items():
        lines += _leaders(group, where, pairs, f"{name}: " if len(groups) > 1 else "")
    if not lines:
        lines = ["best     none: no estimator gave a result that is ranked"]
    ranked = any(_standing(group)[0] for group in groups.values())
    lines += [f"doubt    {sentence}" for sentence in above_bound(cells)]
    said = failures_of([cell for cell in cells if not cell.mixed])
    for label, places in said.items():
        if not places:
            continue
        # Several quantities of one estimate fail for one reason.
        told = list(dict.fromkeys(_failure(cell) for cell in places))
        more = f"; and {plural(len(told) - 3, 'more case')}" if len(told) > 3 else ""
        reason = next((cell.status.partition(":")[2] for cell in places if not cell.ok), "")
        lines.append(f"fails    {label}: " + "; ".join(told[:3]) + more + (f":{reason}" if reason else ""))
    for label, reason in skips_of_cells(cells).items():
        lines.append(f"skipped  {label}: {reason}")
    if ranked and not any(said.values()):
        lines.append(f"fails    none: no estimator failed on more than 10 % of the {common_noun(cells)}s in any case")
    return lines


def _leaders(cells: list[Cell], where: str, pairs: Sequence[Mapping[str, Any]], of: str) -> list[str]:
    """The lines of the most accurate and of the fastest estimator of one quantity, which `of` names; none without a result."""
    ranked, fallen = _standing(cells)
    noun = common_noun(cells)
    if not ranked:
        return [f"best     {of}none: {fallen}"] if fallen else []
    best, fastest = ranked[0], _fastest(ranked)
    ratio = best.bound_ratio
    near = f", {_of_bound(ratio)} x the exact bound" if math.isfinite(ratio) else ""
    speed = f", {time_text(best.cpu_per_element_s)} CPU per {noun}" if best.cpu_per_element_s > 0 else ""
    own = [row for row in pairs if row.get("quantity", cells[0].quantity) == cells[0].quantity]
    beaten, others, basis = beaten_by_best(cells, ranked, own)
    doubt = f", {beaten} of {plural(others, 'other')} significantly worse {basis}".rstrip() if others else ""
    return [
        f"best     {of}{best.label}: smallest error over {plural(best.cells, 'cell')}{where}{doubt}{near}{speed}",
    ] + [
        f"fastest  {of}{fastest.label}: {time_text(fastest.cpu_per_element_s)} CPU per {noun}, "
        f"{times_text(fastest.error_ratio)} x the smallest error",
    ] * (fastest.cpu_per_element_s > 0)


def _of_bound(ratio: float) -> str:
    """A multiple of the bound, with two digits behind the point: 1.04 and 1.004 differ little."""
    return f"{ratio:.2f}" if ratio < 100.0 else times_text(ratio)


def _standing(cells: list[Cell]) -> tuple[list[Ranked], str]:
    """Estimators with a case in which they do not fail, the most accurate first; and where all fail, words that say so."""
    ranked = [r for r in rank(cells) if r.cells]
    stands = {cell.label for cell in cells if not cell.mixed and not cell.fails}
    standing = [r for r in ranked if r.label in stands]
    if standing or not ranked:
        return standing, ""
    least = min((c for c in cells if c.ok), key=lambda c: c.failure_rate)
    return [], (
        f"all fail: each estimator on more than 10 % of the {least.noun}s in every case (the fewest: {least.label}, "
        f"{rate(least.failure_rate)}, {least.place})"
    )


def _failure(cell: Cell) -> str:
    what = f"{rate(cell.failure_rate)} of {cell.noun}s" if cell.ok else cell.status.partition(":")[0]
    return f"{cell.place} ({what})"


def listed(names: list[str], most: int = 4) -> str:
    """The first names, and how many more there are."""
    return ", ".join(names[:most]) + (f" and {len(names) - most} more" if len(names) > most else "")


def plural(count: int, noun: str) -> str:
    """`1 scene`, `3 scenes`."""
    return f"{count} {noun}" + ("" if count == 1 else "s")
