"""Checks of costs against the baseline's: peak memory, and CPU time by a yardstick.

Costs of two runs can be compared only where libraries, processor and its features are equal; even then the times of two runs of
the same code differed by a factor of .88 to 1.19. So the CPU time of an estimator is divided by that of a *yardstick*, an
estimator that did not change, from the same run; and how far such ratios wander by themselves is read from the other
estimators, most of which did not change either. `gate --against` is sharper by far.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from .check import Check, abstained, equal, measured
from .figures import CellKey, Figures, Row
from .paired import Effects

__all__ = ["memory_checks", "setting_differs", "yardstick_checks"]

#: A growth of less than this many bytes is not of interest, whatever its fraction.
_LEAST_BYTES = 4 * 2**20
#: Estimators beside the yardstick that are needed to know the scatter.
_LEAST_OTHERS = 4


def setting_differs(old: Figures, new: Figures, *, processor: bool) -> str:
    """What differs between the libraries and, with `processor`, the processors of two runs; "" for nothing."""
    parts: list[tuple[dict[str, Any], dict[str, Any]]] = [(old.head["versions"], new.head["versions"])]
    if processor:
        names = ("processor", "features", "device_class", "threads_per_estimator")
        first, second = ({name: one.head["machine"].get(name) for name in names} for one in (old, new))
        parts.append((first, second))
    found = [
        f"{name} {a.get(name, 'unknown')} -> {b.get(name, 'unknown')}"
        for a, b in parts
        for name in sorted({*a, *b} - {"beambench"})
        if a.get(name) != b.get(name)
    ]
    return "; ".join(found) if found or all(one.head["versions"] for one in (old, new)) else "unknown versions"


def _costs(figures: Figures, name: str) -> dict[str, dict[CellKey, float]]:
    """{label: {cell: cost}} of the cells that were answered."""
    found: dict[str, dict[CellKey, float]] = {}
    for (subject, cell), row in figures.rows.items():
        value = getattr(row, name)
        if row.status == "ok" and value > 0:
            found.setdefault(subject[0], {})[cell] = value
    return found


def memory_checks(old: Figures, new: Figures, effects: Effects) -> list[Check]:
    """One check per estimator: mean over cells of ln(peak_bytes new/old), with the scatter of all estimators pooled."""
    size = math.log1p(effects.memory)
    if reason := setting_differs(old, new, processor=False):
        return [abstained("memory", "all estimators", reason, size)]
    a, b = _costs(old, "peak_bytes"), _costs(new, "peak_bytes")
    logs: dict[str, np.ndarray[Any, Any]] = {}
    more: dict[str, float] = {}
    checks: list[Check] = []
    for label in sorted({subject[0] for subject, _ in old.rows}):
        shared = sorted(a.get(label, {}).keys() & b.get(label, {}).keys())
        if not shared:
            if _answered(old, label):
                checks.append(abstained("memory", label, "no peak is known on both sides", size))
            continue
        logs[label] = np.array([math.log(b[label][cell] / a[label][cell]) for cell in shared])
        more[label] = float(np.median([b[label][cell] - a[label][cell] for cell in shared]))
    freedom = sum(one.size - 1 for one in logs.values())
    square = sum(float(((one - one.mean()) ** 2).sum()) for one in logs.values())
    for label, one in logs.items():
        note = f"{one.size} cells, {more[label] / 2**20:+.1f} MiB in the middle one"
        if more[label] < _LEAST_BYTES:
            checks.append(equal("memory", label, size, f"{note}: less than {_LEAST_BYTES / 2**20:.0f} MiB more"))
        elif freedom < 2:
            checks.append(abstained("memory", label, f"{note}; too few cells to know the scatter", size))
        else:
            error = math.sqrt(square / freedom / one.size)
            checks.append(measured("memory", label, float(one.mean()), error, freedom, size, note))
    return checks


def _answered(figures: Figures, label: str) -> bool:
    rows: list[Row] = [row for (subject, _), row in figures.rows.items() if subject[0] == label]
    return any(row.status == "ok" for row in rows)


def yardstick_checks(old: Figures, new: Figures, yardstick: str, effects: Effects) -> list[Check]:
    """One check per estimator: ln of its CPU time new/old, less the same of the yardstick.

    The scatter is that between the estimators, from the median of absolute deviations (1.4826 MAD), with as many degrees of
    freedom as there are estimators less two. It needs equal libraries and processors, and four estimators.
    """
    size = math.log1p(effects.speed)
    if reason := setting_differs(old, new, processor=True):
        return [abstained("speed", "all estimators", f"stored times are of another setting: {reason}", size)]
    a, b = _costs(old, "cpu_s"), _costs(new, "cpu_s")
    change = {
        label: float(np.mean([math.log(b[label][cell] / a[label][cell]) for cell in shared]))
        for label in sorted(a.keys() & b.keys())
        if (shared := a[label].keys() & b[label].keys())
    }
    if yardstick not in change:
        return [abstained("speed", "all estimators", f"the yardstick {yardstick} has no time on both sides", size)]
    zero = change.pop(yardstick)
    if len(change) < _LEAST_OTHERS:
        reason = (
            f"{len(change)} estimators beside the yardstick do not show how times scatter; {_LEAST_OTHERS} are needed"
        )
        return [abstained("speed", "all estimators", reason, size)]
    values = np.array(list(change.values()))
    scatter = 1.4826 * float(np.median(np.abs(values - np.median(values))))
    note = f"by the yardstick {yardstick} ({100 * math.expm1(zero):+.1f} %), scatter {100 * scatter:.1f} %"
    return [
        measured("speed", label, value - zero, scatter, len(change) - 1, size, note) for label, value in change.items()
    ]
