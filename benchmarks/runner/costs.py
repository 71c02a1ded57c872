"""costs.csv: the cost of each estimate per call and per element, its spread, and the source of the times.

The runner measures them, over the process of the estimator and all that it started. `cpu_s` and `wall_s` are medians over the
timed calls, each on data that the process has not seen; `_first` is the first of them, whose answer is scored, and which follows
a warm-up with data of eight elements; `_min` and `_max` are the shortest and the longest, `cpu_log_sd` the standard deviation of
the logarithm of CPU times; `_per_element_s` divides by all elements of the capture, including
those without truth. `source` is "measured", or "cache" for the times of an earlier run on this machine.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from ...estimators.labels import label_of
from ...scenes.errors import InputError, reason
from ..folders.files import write_text
from ..runner.session import Outcome
from ..scores.tables import read_numbers, to_csv

__all__ = ["COST_COLUMNS", "cost_interval", "cost_row", "quickened", "read_costs", "slow_starts", "write_costs"]

_KEY = (
    "suite", "scene", "stress", "level", "stress2", "level2", "seed", "condition", "estimator", "params", "modality",
)  # fmt: skip
_TIMES = (
    "cpu_s", "cpu_s_min", "cpu_s_max", "cpu_log_sd", "cpu_per_element_s", "wall_s", "wall_s_min", "wall_s_max",
    "wall_per_element_s", "peak_bytes", "cpu_s_first", "wall_s_first",
)  # fmt: skip
_FIRST = ("cpu_s_first", "wall_s_first")
_OLD_TIMES = tuple(name for name in _TIMES if name not in _FIRST)
COST_COLUMNS = (*_KEY, "device_class", "elements", "calls", *_TIMES, "source")


def cost_row(key: Mapping[str, Any], outcome: Outcome, *, device_class: str, source: str) -> dict[str, Any]:
    """One row: the key columns of a score row, and the costs of its outcome."""
    elements = outcome.job.elements
    row: dict[str, Any] = {
        **{name: key[name] for name in _KEY if name != "modality"}, "modality": outcome.job.modality,
        "device_class": device_class, "elements": elements, "calls": len(outcome.cpu_calls), "source": source,
        "cpu_s": outcome.cpu_s, "wall_s": outcome.wall_s, "peak_bytes": outcome.peak_bytes,
        "cpu_per_element_s": outcome.cpu_s / elements, "wall_per_element_s": outcome.wall_s / elements,
    }  # fmt: skip
    for name, calls in (("cpu_s", outcome.cpu_calls), ("wall_s", outcome.wall_calls)):
        row[f"{name}_first"] = calls[0] if calls else math.nan
        row[f"{name}_min"], row[f"{name}_max"] = min(calls, default=math.nan), max(calls, default=math.nan)
    positive = np.log([call for call in outcome.cpu_calls if call > 0])
    row["cpu_log_sd"] = float(positive.std(ddof=1)) if positive.size > 1 else math.nan
    return {name: row[name] for name in COST_COLUMNS}


def write_costs(folder: Path, rows: Iterable[Mapping[str, Any]]) -> None:
    """Write costs.csv of a run, its rows sorted by key, completely or not at all."""
    ordered = sorted(rows, key=lambda row: tuple(str(row[name]) for name in _KEY))
    write_text(folder / "costs.csv", to_csv([dict(row) for row in ordered], COST_COLUMNS))


def read_costs(folder: Path) -> list[dict[str, Any]]:
    """The rows of costs.csv with typed numbers; no rows if the folder has no such file.

    Raises:
        InputError: the file is not such a table.
    """
    texts = (*_KEY, "source")
    rows = read_numbers(folder / "costs.csv", ("elements", "calls", *_OLD_TIMES), "The table of costs", texts=texts)
    for row in rows:  # tables of before version 4 hold no first calls
        for name in _FIRST:
            try:
                row[name] = float(row.get(name) or math.nan)
            except (TypeError, ValueError) as error:
                raise InputError(
                    "The table of costs cannot be read.", where=str(folder / "costs.csv"), value=reason(error)
                ) from error
    return rows


def quickened(calls: Sequence[float]) -> bool:
    """Whether the first of some calls took more than 3 times the median of the others, and 20 ms more.

    All have data that are new to the estimator, and follow a warm-up: one that is so much faster later has kept something.
    """
    if len(calls) < 2:
        return False
    others = float(np.median(calls[1:]))
    return calls[0] > 3.0 * others and calls[0] > others + 0.02


def slow_starts(rows: Iterable[Mapping[str, Any]]) -> list[str]:
    """A sentence for every estimator with a row whose first call is much slower than the median of all, by CPU time."""
    found: dict[str, str] = {}
    for row in rows:
        first, middle = float(row["cpu_s_first"]), float(row["cpu_s"])
        if first > 3.0 * middle and first > middle + 0.02:
            label = label_of(str(row["estimator"]), str(row["params"]))
            ratio = first / middle if middle > 0 else math.inf
            found.setdefault(
                label,
                (
                    f"{label}, {row['scene']}: the first call on new data takes {ratio:.3g} times the CPU time of the median call; "
                    "see cpu_s_first in costs.csv."
                ),
            )
    return list(found.values())


def cost_interval(
    middle: float, own_rows: Sequence[tuple[float, float]], all_rows: Sequence[tuple[float, float]]
) -> tuple[float, float]:
    """95 % interval of a median CPU time from the scatter of calls, s; (NaN, NaN) if no call was repeated.

    Main arguments:
        middle: the median, s. own_rows: (calls, cpu_log_sd) of the rows behind it. all_rows: the same for all rows in the
            comparison.

    m·exp(∓ t s √(π/2n)) with n calls, and s the larger of the pooled scatters of the own rows and of all rows, because a few
    calls underestimate their scatter. √(π/2): standard error of a median over that of a mean, for normal scatter. The
    interval does not include differences between processes or days.
    """
    from scipy.special import stdtrit

    own, _ = _pooled(own_rows)
    common, freedom = _pooled(all_rows)
    calls = sum(n for n, _ in own_rows if n > 0)
    if freedom < 1 or calls < 1 or not middle > 0:
        return math.nan, math.nan
    scatter = max(common, own) if own == own else common
    half = float(stdtrit(freedom, 0.975)) * scatter * math.sqrt(0.5 * math.pi / calls)
    return middle * math.exp(-half), middle * math.exp(half)


def _pooled(rows: Sequence[tuple[float, float]]) -> tuple[float, float]:
    """Pooled standard deviation of the logarithms, and its degrees of freedom."""
    known = [(n - 1.0, sd) for n, sd in rows if n > 1 and sd == sd]
    freedom = sum(f for f, _ in known)
    return (math.sqrt(sum(f * sd * sd for f, sd in known) / freedom) if freedom > 0 else math.nan), freedom
