"""What each estimator loses per unit of an error of its declared rig.

    python -m beambench.benchmarks.checks.mismatch [--suite mismatch] [--csv FILE]

Each capture of the suite is read with the right rig, and with each error of its table `mismatch` alone, added and
subtracted. The loss is the change of the rms error over the error's amount, of each sign by itself; the shift that of the
mean error, half of the difference of both signs. Intervals (95 %) are Student's over the seeds: the noise is the same in all
readings of a capture and drops out.
"""

from __future__ import annotations

import argparse
import math
import sys
from collections.abc import Callable, Iterator
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr

from ...captures.hide import hide_truth
from ...estimators.registry import get_estimator, run_estimator
from ...generator.generate import generate
from ...scenes.errors import InputError
from ..folders.files import write_text
from ..judges.bound import truths_of
from ..judges.mismatch import wrongly_declared
from ..scores.tables import to_csv
from ..scores.truth import aligned, errors_of, single_valued
from ..suites.mismatch import ERRORS, applies
from ..suites.stress_axes import AXES
from ..suites.suite import Loaded, cells_of, load_suite

__all__ = ["Loss", "losses", "main"]


@dataclass(frozen=True)
class Loss:
    """A row: rms error with the right rig [unit], and per unit of the error, with half widths of 95 % intervals: what is lost
    where it is added and where it is subtracted, and the shift of the mean error. `error_unit`: unit of the amount."""

    scene: str
    estimator: str
    quantity: str
    unit: str
    error: str
    amount: float
    error_unit: str
    rmse: float
    loss_plus: float
    loss_plus_half: float
    loss_minus: float
    loss_minus_half: float
    shift: float
    shift_half: float


def losses(loaded: Loaded) -> Iterator[Loss]:
    """Rows of all scenes, errors and estimators of a suite with a table `mismatch`. Raises InputError as the suite's run."""
    cells = [cell for cell in cells_of(loaded) if cell.stress == "none"]
    for name, scene in loaded.scenes:
        labels = [label for label in loaded.suite.estimators if loaded.reads(label, name)]
        errors = [error for error in loaded.suite.mismatch if applies(error, scene)]
        found: dict[tuple[str, str, int], list[tuple[float, float]]] = {}
        refused: dict[tuple[str, int], str] = {}
        for cell in (cell for cell in cells if cell.scene_name == name):
            fidelity: Any = cell.fidelity
            capture = generate(
                cell.scene, seed=cell.random_seed, capture_key=cell.key, fidelity=fidelity, rtol=loaded.suite.rtol
            )
            readings: list[tuple[str, int, xr.Dataset]] = [("", 0, hide_truth(capture))]
            for error in errors:
                for sign in (1, -1):
                    wrong = {error: sign * loaded.suite.mismatch[error]}
                    try:
                        readings.append((error, sign, wrongly_declared(cell.scene, wrong, hide_truth(capture))))
                    except InputError as told:  # e.g. an index below 1 in air: this sign has no figures
                        why = (
                            f"{name}: {error} {sign * loaded.suite.mismatch[error]:+g} cannot be declared: {told.what}"
                        )
                        refused.setdefault((error, sign), why)
            for label in labels:
                score = _scored(label, capture)
                for error, sign, hidden in readings:
                    found.setdefault((label, error, sign), []).append(score(hidden))
        for why in refused.values():
            print(why, file=sys.stderr, flush=True)
        for label in labels:
            quantity = get_estimator(label.partition("[")[0]).stage.gives[0] if "+" not in label else _given(label)
            for error in errors:
                right, plus, minus = (
                    np.array(found.get((label, e, s), [(math.nan, math.nan)]))
                    for e, s in (("", 0), (error, 1), (error, -1))
                )
                yield _row(name, label, quantity, error, loaded.suite.mismatch[error], right, plus, minus)


def _given(label: str) -> Any:
    return get_estimator(label).stage.gives[0]


def _scored(label: str, capture: xr.Dataset) -> Callable[[xr.Dataset], tuple[float, float]]:
    """A function: capture without truth -> (rms, mean) of the errors of an estimator."""
    quantity = _given(label) if "[" not in label else get_estimator(label.partition("[")[0]).stage.gives[0]
    stage = get_estimator(label.partition("[")[0] if "+" not in label else label).stage
    truth = truths_of(capture)[quantity.name]
    chosen = single_valued(truth)

    def score(hidden: xr.Dataset) -> tuple[float, float]:
        answer = run_estimator(label, hidden)
        arrays = {str(key): np.asarray(value.values) for key, value in answer.variables.items()}
        value, _, valid = aligned(arrays, stage, quantity, truth.value.shape)
        error = errors_of(np.where(valid, value, np.nan), truth)[chosen]
        error = error[np.isfinite(error)]
        return (float(np.sqrt((error**2).mean())), float(error.mean())) if error.size else (math.nan, math.nan)

    return score


def _row(
    scene: str, label: str, quantity: Any, error: str, amount: float, right: Any, plus: Any, minus: Any
) -> Loss:  # fmt: skip
    up, down = (plus[:, 0] - right[:, 0]) / abs(amount), (minus[:, 0] - right[:, 0]) / abs(amount)
    shift = (plus[:, 1] - minus[:, 1]) / (2.0 * amount)
    return Loss(
        scene, label, quantity.name, quantity.unit, error, amount, AXES[ERRORS[error][0]].unit, float(right[:, 0].mean()),
        float(up.mean()), _half(up), float(down.mean()), _half(down), float(shift.mean()), _half(shift),
    )  # fmt: skip


def _half(values: Any) -> float:
    """Half of a 95 % interval of a mean."""
    from scipy.special import stdtrit

    n = len(values)
    return float(stdtrit(n - 1, 0.975) * values.std(ddof=1) / math.sqrt(n)) if n > 1 else math.nan


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--suite", default="mismatch", help="a suite with a table `mismatch`")
    parser.add_argument("--csv", type=Path, help="also write the rows here")
    given = parser.parse_args()
    rows = []
    print(
        "| scene | estimator | error | rms, right | lost per unit, + | lost per unit, − | shift of the mean per unit |"
    )
    print("|---|---|---|---|---|---|---|")
    for row in losses(load_suite(given.suite)):
        rows.append(asdict(row))
        per = f"{row.unit}/{row.error_unit}" if row.error_unit != "1" else row.unit
        print(
            f"| {row.scene} | `{row.estimator}` | {row.error} ± {row.amount:g} {row.error_unit} | {row.rmse:.3g} {row.unit} | "
            f"{row.loss_plus:.3g} ± {row.loss_plus_half:.1g} {per} | {row.loss_minus:.3g} ± {row.loss_minus_half:.1g} {per} | "
            f"{row.shift:.3g} ± {row.shift_half:.1g} {per} |",
            flush=True,
        )
    if given.csv is not None:
        write_text(given.csv, to_csv(rows, list(rows[0])))


if __name__ == "__main__":
    main()
