"""breakdown.csv: the level of a stress at which each estimator breaks down, its mode of failure, and its stability below it.

Columns: modality, suite, estimator, axis, unit; `level10` with its 95 % interval `lo`, `hi`, `level50` with `lo50`,
`hi50` (see `failure_map`); an empty field is an end outside the levels of the suite. `mode` is the most frequent mode of
failure (bias, outlier, refusal or crash) at the failing level closest to `level50`; "none" if the estimator fails at no
level of the axis.

`float32_vs_64` and `gain_1dn` state how far the estimates move when the same counts are given as float32 instead of
float64, and when 1 DN is added to every sample: the rms change over elements that are valid in both, in units of the rms
bound of those elements, at the last level that is below the 10 % edge with certainty. An element that becomes invalid, or
valid, counts with the prior's error. A change below about .1 is invisible; one above 1 costs more than the noise. The field
is empty if the estimator does not accept such counts, or fails at every level. `condition`: the condition of the declared
rig, as in scores.csv.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from ...captures.layouts import layout_of
from ..folders.files import write_text
from ..scores.tables import to_csv
from ..scores.truth import Bound, Truth, aligned, single_valued
from .failure_map import EdgeMap
from .failure_rate import dispersion, failure_rate, mode_of, rate_bounds

if TYPE_CHECKING:
    import xarray as xr

    from ..runner.session import Outcome

__all__ = [
    "BREAKDOWN_COLUMNS", "MAP_COLUMNS", "VARIANTS", "breakdown_row", "calm_level", "change_in_bounds", "map_rows",
    "write_breakdown",
]  # fmt: skip

BREAKDOWN_COLUMNS = (
    "modality", "suite", "estimator", "axis", "unit", "level10", "lo", "hi", "level50", "lo50", "hi50", "mode",
    "float32_vs_64", "gain_1dn", "condition",
)  # fmt: skip
MAP_COLUMNS = (
    "modality", "suite", "estimator", "axis", "unit", "level", "axis2", "unit2", "level2", "scene", "seeds", "n",
    "failure_rate", "lo", "hi", "bias", "outlier", "refusal", "crash",
    "condition",
)  # fmt: skip

_Z95_ONE_SIDED = 0.025


def breakdown_row(
    key: Mapping[str, str], levels: Sequence[float], found: EdgeMap, *, float32_vs_64: float, gain_1dn: float
) -> dict[str, Any]:
    """One row of the table.

    Main arguments:
        key: modality, suite, estimator, axis, unit, condition. levels: levels of the suite, from benign to breaking.
        found: the map along the axis, with the edges at 10 % and 50 %.
    """
    falling = levels[-1] < levels[0]
    fields: dict[str, Any] = {}
    for edge, names in zip(found.edges, (("level10", "lo", "hi"), ("level50", "lo50", "hi50")), strict=True):
        low, high = edge.interval[::-1] if falling else edge.interval
        fields |= dict(zip(names, (edge.level, low, high), strict=True))
    stability = {"float32_vs_64": float32_vs_64, "gain_1dn": gain_1dn}
    row = {**key, **fields, "mode": _mode(levels, found), **stability}
    return {name: row[name] for name in BREAKDOWN_COLUMNS}


def _mode(levels: Sequence[float], found: EdgeMap) -> str:
    """Mode of failure at the first level with half of the elements failed, otherwise at the worst level over 10 %."""
    ordered = found.ordered(levels)
    rates = [failure_rate(found.trials[level,]) for level in ordered]
    for level, rate in zip(ordered, rates, strict=True):
        if rate >= 0.5:
            return mode_of(found.trials[level,])
    worst = int(np.argmax(rates))
    return mode_of(found.trials[ordered[worst],]) if rates[worst] > 0.1 else "none"


def calm_level(levels: Sequence[float], found: EdgeMap) -> float | None:
    """The level at which stability is tested: the last measured one that is below the 10 % edge with certainty, or the first
    level if the seeds are too few for certainty; None if the first level fails already."""
    start = found.edges[0].start
    if not math.isnan(start):
        return start
    return levels[0] if failure_rate(found.trials[levels[0],]) < found.edges[0].target else None


def _float(kind: str) -> Any:
    def change(hidden: xr.Dataset) -> xr.Dataset:
        name = layout_of(hidden.attrs["modality"]).data
        return hidden.assign({name: hidden[name].astype(kind)}).assign_attrs(averaged=1)

    return change


def _one_more(hidden: xr.Dataset) -> xr.Dataset:
    name = layout_of(hidden.attrs["modality"]).data
    data = hidden[name]
    top = np.iinfo(data.dtype).max if data.dtype.kind in "iu" else np.inf
    return hidden.assign({name: data.copy(data=np.where(data.values < top, data.values + 1, data.values))})


def _as_is(hidden: xr.Dataset) -> xr.Dataset:
    return hidden


#: Versions of a capture whose estimates are compared: float32 with float64, and counts + 1 DN with the unchanged counts.
VARIANTS: dict[str, Any] = {
    "float32": _float("float32"), "float64": _float("float64"), "as-is": _as_is, "one-more": _one_more,
}  # fmt: skip


def change_in_bounds(a: Outcome, b: Outcome, truths: Mapping[str, Truth], bounds: Mapping[str, Bound]) -> float:
    """The rms difference of two estimates of the main quantity over unmixed elements with truth, in units of the rms bound;
    NaN if an estimate is missing."""
    if a.status != "ok" or b.status != "ok":
        return math.nan
    quantity = a.stage.gives[0]
    truth, bound = truths[quantity.name], bounds[quantity.name]
    (first, _, valid), (second, _, also) = (
        aligned(outcome.arrays, outcome.stage, quantity, truth.value.shape) for outcome in (a, b)
    )
    chosen = single_valued(truth) & np.isfinite(bound.sigma)
    both = chosen & valid & also
    one = chosen & (valid ^ also)
    if not (both | one).any():
        return math.nan
    square = np.zeros(truth.value.shape)
    square[both] = (first[both] - second[both]) ** 2
    square[one] = bound.prior**2
    counted = both | one
    return float(np.sqrt(square[counted].mean() / (np.minimum(bound.sigma, bound.prior)[counted] ** 2).mean()))


def map_rows(key: Mapping[str, str], found: EdgeMap) -> list[dict[str, Any]]:
    """failure_map.csv: one row per measured point and scene, and one per point over all scenes (scene "all").

    Main arguments:
        key: modality, suite, estimator, axis, unit, axis2, unit2, condition. `lo`, `hi`: 95 % interval of the rate at that point,
        from its own trials.
    """
    spread = dispersion(found.trials.values())
    rows = []
    for point, trials in sorted(found.trials.items()):
        scenes = sorted({t.scene for t in trials})
        groups = [(scene, [t for t in trials if t.scene == scene]) for scene in scenes]
        for scene, group in [*groups, ("all", trials)] if len(scenes) > 1 else groups:
            low, high = rate_bounds(group, spread, _Z95_ONE_SIDED)
            row = {
                **key, "level": point[0], "level2": point[1] if len(point) > 1 else math.nan, "scene": scene,
                "seeds": len({t.seed for t in group}), "n": sum(t.n for t in group),
                "failure_rate": failure_rate(group), "lo": low, "hi": high,
                **{name: sum(getattr(t, name) for t in group) for name in ("bias", "outlier", "refusal", "crash")},
            }  # fmt: skip
            rows.append({name: row[name] for name in MAP_COLUMNS})
    return rows


def write_breakdown(folder: Path, rows: Iterable[Mapping[str, Any]], maps: Iterable[Mapping[str, Any]]) -> None:
    """Write breakdown.csv and failure_map.csv, each completely or not at all."""
    write_text(folder / "breakdown.csv", to_csv([dict(row) for row in rows], BREAKDOWN_COLUMNS))
    write_text(folder / "failure_map.csv", to_csv([dict(row) for row in maps], MAP_COLUMNS))
