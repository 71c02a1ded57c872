"""Checks of a run against its baseline on equal captures: accuracy, failures, coverage, sigma, memory, stored times.

The two sides read the same scenes with the same seeds, level by level. A cell counts only where the hashes of what the
estimators read are equal; elsewhere the change of the captures would be taken for one of the code.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, fields

import numpy as np
import numpy.typing as npt

from ...captures.layouts import is_main_quantity
from ..statistics.pooled import concentrated
from .check import REGRESSION, Check, abstained, equal, measured
from .figures import CellKey, Figures, Row, folded

__all__ = ["Effects", "paired_checks"]

Subject = tuple[str, str, str]
#: What depends on how busy the machine is, and not only on the code.
_BUSY = ("timeout:", "memory:", "skip: gave up")
#: With so many cells the scatter between them is known; with fewer, that between tiles is used.
_MANY = 6


@dataclass(frozen=True)
class Effects:
    """The least changes that must not pass: of errors, CPU time, peak memory and |ln z_rms| as fractions, of rates absolute."""

    accuracy: float = 0.05
    speed: float = 0.10
    memory: float = 0.20
    rates: float = 0.01
    sigma: float = 0.10


@dataclass(frozen=True)
class Pairs:
    """The cells that one subject has in both, its rows of old and new, and those that were left out, by reason."""

    cells: list[CellKey]
    old: list[Row]
    new: list[Row]
    missing: int
    changed: int


def paired_checks(old: Figures, new: Figures, effects: Effects) -> list[Check]:
    """All checks of accuracy, failures, coverage and sigma, one per subject (estimator, stage, quantity) and condition."""
    checks: list[Check] = []
    for subject, condition in sorted({(s, cell[6]) for s, cell in old.rows}):
        name = f"{subject[0]} · {subject[2]} · {condition}"
        pairs = _pairs(old, new, subject, condition)
        broken = _broken(name, pairs)
        if broken is not None:
            checks.append(broken)
            continue
        if reason := _reason(pairs):
            checks += [abstained(figure, name, reason) for figure in ("accuracy", "failures", "coverage", "sigma")]
            continue
        checks += [
            _accuracy(name, subject, pairs, old, new, effects.accuracy),
            _rate("failures", name, pairs, lambda row: row.n * row.failure_rate, effects.rates),
            _rate("coverage", name, pairs, lambda row: row.n * (1.0 - row.coverage), effects.rates),
            _sigma(name, pairs, effects.sigma),
        ]
    return checks


def _pairs(old: Figures, new: Figures, subject: Subject, condition: str) -> Pairs:
    cells: list[CellKey] = []
    missing = changed = 0
    for other, cell in old.rows:
        if other != subject or cell[6] != condition:
            continue
        if (subject, cell) not in new.rows:
            missing += 1
        elif not old.inputs.get(cell) or old.inputs[cell] != new.inputs.get(cell):
            changed += 1
        else:
            cells.append(cell)
    return Pairs(
        cells,
        [old.rows[subject, cell] for cell in cells],
        [new.rows[subject, cell] for cell in cells],
        missing,
        changed,
    )


def _reason(pairs: Pairs) -> str:
    """Why the subject cannot be compared, or ""."""
    if pairs.changed:
        return (
            f"the captures of {pairs.changed} cells are not those of the baseline (generator, libraries or processor changed), "
            "or one side has no inputs.csv"
        )
    if pairs.missing:
        return f"{pairs.missing} cells of the baseline are not in the run"
    slow = [b.status for a, b in zip(pairs.old, pairs.new, strict=True) if a.status != b.status]
    return f"the result of {len(slow)} cells depends on how busy the machine was: {slow[0]}" if slow else ""


def _broken(name: str, pairs: Pairs) -> Check | None:
    """A regression where an estimator that answered fails now."""
    found = [
        b.status
        for a, b in zip(pairs.old, pairs.new, strict=True)
        if a.status == "ok" and b.status != "ok" and not b.status.startswith(_BUSY)
    ]
    if not found:
        return None
    note = f"{len(found)} of {len(pairs.cells)} cells fail now: {found[0]}"
    return Check("failures", name, 1.0, 1.0, 0.0, 0.0, 0.0, REGRESSION, note)


def _same(pairs: Pairs) -> bool:
    """Whether all figures except costs are equal to the nine digits of the tables."""
    names = [one.name for one in fields(Row) if one.name not in ("cpu_s", "peak_bytes", "status")]
    return all(
        _digits(getattr(a, name)) == _digits(getattr(b, name))
        for a, b in zip(pairs.old, pairs.new, strict=True)
        for name in names
    )


def _digits(value: float) -> str:
    return f"{value:.9g}"


def _accuracy(name: str, subject: Subject, pairs: Pairs, old: Figures, new: Figures, effect: float) -> Check:
    """Mean over cells of ln(rmse_full new/old). Its error from the scatter between cells or, with few, between tiles."""
    size = math.log1p(effect)
    if _same(pairs):
        return equal("accuracy", name, size)
    a, b = (np.array([row.rmse_full for row in rows]) for rows in (pairs.old, pairs.new))
    used = ~((a == 0) & (b == 0)) & ~(np.isnan(a) & np.isnan(b))
    if not used.any():
        return equal("accuracy", name, size, "no error in either")
    if not ((a[used] > 0) & (b[used] > 0)).all():
        return abstained("accuracy", name, "an error is zero or unknown on one side only", size)
    logs = np.log(b[used] / a[used])
    note = f"{logs.size} cells"
    if logs.size >= _MANY:
        error = float(logs.std(ddof=1)) / math.sqrt(logs.size)
        return measured("accuracy", name, float(logs.mean()), error, logs.size - 1, size, note)
    if not is_main_quantity(subject[1], subject[2]):
        return abstained("accuracy", name, f"{note}, and errors by tile are kept of the main quantity only", size)
    variances = []
    for cell in [cell for cell, use in zip(pairs.cells, used, strict=True) if use]:
        found = _by_tile(old.tiles.get((subject[0], cell)), new.tiles.get((subject[0], cell)))
        if found is None:
            return abstained("accuracy", name, f"{note}, and few tiles hold most of the error, or none are known", size)
        variances.append(found)
    error = math.sqrt(sum(variance for variance, _ in variances)) / logs.size
    return measured(
        "accuracy",
        name,
        float(logs.mean()),
        error,
        sum(f for _, f in variances),
        size,
        f"{note}, scatter between tiles",
    )


def _by_tile(old: npt.NDArray[np.float64] | None, new: npt.NDArray[np.float64] | None) -> tuple[float, float] | None:
    """Variance of ½ ln(Σnew/Σold) over K tiles, K/(K−1) Σ (a_k/Σa − b_k/Σb)²/4, and its degrees of freedom.

    Source: W. G. Cochran, Sampling Techniques, 3rd ed., 1977, sec. 6.3 (ratios).
    """
    if old is None or new is None:
        return None
    a, b = old, folded(new, old.size)
    if a.size != b.size or bool(concentrated(a)) or bool(concentrated(b)):
        return None
    filled = (a > 0) | (b > 0)
    count = int(filled.sum())
    spread = float(((a / a.sum() - b / b.sum()) ** 2).sum()) * count / (count - 1)
    return 0.25 * spread, count - 1


def _rate(figure: str, name: str, pairs: Pairs, count: Callable[[Row], float], effect: float) -> Check:
    """Change of the share of elements that fail, or are refused.

    With k_a and k_b such elements, k_b given their sum is binomial with p = ½ where nothing changed. Pairs that agree would
    make the test sharper; the tables do not hold them, so that it is conservative.
    """
    from scipy.stats import binomtest, norm

    if _same(pairs):
        return equal(figure, name, effect)
    k_a, k_b = (round(sum(count(row) for row in rows)) for rows in (pairs.old, pairs.new))
    n = sum(row.n for row in pairs.new)
    if not n:
        return equal(figure, name, effect, "no elements")
    change = (k_b - k_a) / n
    p = float(binomtest(k_b, k_a + k_b, 0.5, alternative="greater").pvalue) if k_a + k_b else 1.0
    high = change + float(norm.ppf(0.95)) * math.sqrt(max(k_a + k_b, 1)) / n
    return Check(figure, name, change, high, effect, p, note=f"{k_a} and {k_b} of {n:.0f} elements")


def _sigma(name: str, pairs: Pairs, effect: float) -> Check:
    """Change of |ln z_rms|, how far the stated sigma is from the errors; at least the error of two independent samples."""
    size = math.log1p(effect)
    if _same(pairs):
        return equal("sigma", name, size)
    used = [(a, b) for a, b in zip(pairs.old, pairs.new, strict=True) if a.z_rms > 0 and b.z_rms > 0]
    if not used:
        return equal("sigma", name, size, "no sigma in either")
    old, new = (abs(0.5 * math.log(_mean_square([pair[k] for pair in used]))) for k in (0, 1))
    count = sum(b.n * b.coverage for _, b in used)
    error = 1.0 / math.sqrt(max(count, 1.0))  # each ln z has 1/√(2n)
    freedom = math.inf
    if len(used) >= _MANY:
        logs = np.array([abs(math.log(b.z_rms)) - abs(math.log(a.z_rms)) for a, b in used])
        error, freedom = max(error, float(logs.std(ddof=1)) / math.sqrt(logs.size)), len(used) - 1
    return measured("sigma", name, new - old, error, freedom, size, f"{count:.0f} elements")


def _mean_square(rows: Sequence[Row]) -> float:
    weight: Iterable[float] = [row.n * row.coverage for row in rows]
    return float(np.average([row.z_rms**2 for row in rows], weights=np.maximum(list(weight), 1e-300)))
