"""Breakdown level of each estimator per scene, condition and stress, from the scores of a run.

    python -m beambench.benchmarks.search.breakdown_levels RUN [RUN ...]

`beambench sweep` refines levels at the edge and gives intervals. This program reads the fixed levels of `beambench run`,
which has all conditions and separates scenes (e.g. waters). It pools the failure rates of all seeds at a level, and
interpolates between levels where the rate first passes 10 % and 50 %.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from ...captures.layouts import scored_first
from ...estimators.labels import label_of
from ..statistics.levels import is_log
from ..suites.suite import CELL_NONE

if TYPE_CHECKING:
    import pandas as pd

__all__ = ["LEVEL_COLUMNS", "breaking_level", "level_rows", "main", "markdown"]

LEVEL_COLUMNS = (
    "suite", "scene", "condition", "axis", "estimator", "level10", "level50", "rate_first", "rate_last", "worst_level",
    "worst_rate",
)  # fmt: skip


def breaking_level(levels: Sequence[float], rates: Sequence[float], target: float) -> float:
    """The interpolated level at which the rate first passes `target`; NaN if it never does.

    Levels run from benign to breaking. If the first level already fails, it is returned.
    """
    log = is_log(levels)
    for number, rate in enumerate(rates):
        if rate < target:
            continue
        if number == 0:
            return levels[0]
        share = (target - rates[number - 1]) / (rate - rates[number - 1])
        a, b = levels[number - 1], levels[number]
        return float(a * (b / a) ** share) if log else float(a + share * (b - a))
    return math.nan


def level_rows(scores: pd.DataFrame, orders: dict[tuple[str, str], Sequence[float]]) -> list[dict[str, Any]]:
    """One row per scene, condition, axis and estimator of a run's scores.

    Main arguments:
        scores: the table scores.csv. orders: levels of each (suite, axis), from benign to breaking.

    Rows of other quantities than a stage's main one, of mixed elements, and of stresses with two axes are left out.
    """
    first = [
        scored_first(*place) for place in zip(scores["modality"], scores["stage"], scores["quantity"], strict=True)
    ]
    chosen = scores[np.array(first, bool) & (scores["stress"] != CELL_NONE) & (scores["n"] > 0)]
    chosen = chosen.assign(level=chosen["level"].astype(float))
    rows: list[dict[str, Any]] = []
    keys = ["suite", "scene", "condition", "stress", "estimator", "params"]
    for key, group in chosen.groupby(keys, sort=True, dropna=False):
        suite, scene, condition, axis, name, params = map(str, key if isinstance(key, tuple) else (key,))
        if (suite, axis) not in orders:
            continue
        failed = (group["failure_rate"] * group["n"]).groupby(group["level"]).sum()
        rate_of = (failed / group["n"].groupby(group["level"]).sum()).to_dict()
        levels = [level for level in orders[suite, axis] if level in rate_of]
        if not levels:
            continue
        rates = [float(rate_of[level]) for level in levels]
        worst = max(range(len(rates)), key=rates.__getitem__)
        label = label_of(name, "" if params == "nan" else params)
        values = (suite, scene, condition, axis, label, breaking_level(levels, rates, 0.1),
                  breaking_level(levels, rates, 0.5), rates[0], rates[-1], levels[worst], rates[worst])  # fmt: skip
        rows.append(dict(zip(LEVEL_COLUMNS, values, strict=True)))
    return rows


def markdown(rows: Iterable[dict[str, Any]]) -> str:
    """Tables of level10 / level50, one per axis: a row per estimator, a column per scene and condition. A dash means that the
    rate is never reached; the worst rate follows in brackets."""
    rows = list(rows)
    text: list[str] = []
    for axis in dict.fromkeys((r["suite"], r["axis"]) for r in rows):
        selected = [r for r in rows if (r["suite"], r["axis"]) == axis]
        columns = list(dict.fromkeys((r["scene"], r["condition"]) for r in selected))
        text += [f"**{axis[0]}** ({axis[1]}), level at 10 % / 50 % failed", ""]
        text += [
            "| estimator | " + " | ".join(f"{s}, {c}" for s, c in columns) + " |",
            "|---" * (1 + len(columns)) + "|",
        ]
        for estimator in dict.fromkeys(r["estimator"] for r in selected):
            cells = {(r["scene"], r["condition"]): _cell(r) for r in selected if r["estimator"] == estimator}
            text.append(f"| `{estimator}` | " + " | ".join(cells.get(column, "") for column in columns) + " |")
        text.append("")
    return "\n".join(text)


def _cell(row: dict[str, Any]) -> str:
    first, second = ("–" if math.isnan(level) else f"{level:.2g}" for level in (row["level10"], row["level50"]))
    return f"{first} / {second}" if second != "–" else f"{first} / – ({row['worst_rate']:.0%})"


def _orders(scores: pd.DataFrame) -> dict[tuple[str, str], Sequence[float]]:
    """Levels in the order of the suite file, if it is built in; otherwise rising."""
    from ..suites.suite import list_suites, load_suite

    suite = str(scores["suite"].iloc[0])
    found: dict[tuple[str, str], Sequence[float]] = {}
    if suite in list_suites():
        for stress in load_suite(suite).suite.stresses:
            if stress.axis2 is None:
                found[suite, stress.axis] = stress.values
    for axis in scores["stress"].unique():
        if axis != CELL_NONE and (suite, str(axis)) not in found:
            found[suite, str(axis)] = sorted(
                float(level) for level in scores.loc[scores["stress"] == axis, "level"].unique()
            )
    return found


def main(arguments: Sequence[str] | None = None) -> int:
    """Print the tables of the given runs."""
    import argparse

    from ..scores.tables import read_scores

    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("runs", nargs="*", help="folders of runs, with scores.csv")
    folders = parser.parse_args(arguments).runs
    if not folders:
        parser.print_help()
        return 2
    for folder in folders:
        scores = read_scores(Path(folder) / "scores.csv")
        print(markdown(level_rows(scores, _orders(scores))))
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
