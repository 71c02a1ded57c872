"""Numbers of a data set: what was drawn against what was asked, counts, saturation, and the quantity that is estimated."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from ...captures.exports.planes import planes_of
from ...captures.layouts import layout_of
from ...captures.store.shard_set import ShardedSet
from ...scenes.datasets.distributions import Choice, Expressed, Grid
from ...scenes.datasets.spec import Dataset
from ...scenes.json_keys import read_json
from ..folders.progress import Progress
from ..looks.panel import brightest

__all__ = ["Drawn", "GroupFigures", "Sample", "drawn_of", "group_figures"]

Array = np.ndarray[Any, Any]
#: Captures of a group that are read for its figures, evenly placed.
MOST = 200
_BINS = 24
#: Quantiles that give the asked distribution.
_QUANTILES = (np.arange(20_000) + 0.5) / 20_000


@dataclass(frozen=True)
class Drawn:
    """A parameter: what was drawn, in bins or by value, beside what was asked.

    Main arguments:
        name, kind: of the parameter. labels: of the values, or () for bins. edges: of the bins, or empty.
        found, asked: captures in each bin, drawn and expected; `asked` is empty for an expression.
        distance: of Kolmogorov and Smirnov, NaN where it does not apply. limit: what it exceeds in one of 100 sound data sets.
    """

    name: str
    kind: str
    labels: tuple[str, ...]
    edges: Array
    found: Array
    asked: Array
    log: bool = False
    distance: float = float("nan")
    limit: float = float("nan")


def drawn_of(data: Dataset, rows: Mapping[str, list[Any]]) -> list[Drawn]:
    """Every parameter of a data set. `rows`: the columns of the index, with what was drawn as p.<name>."""
    found = []
    for name, one in data.parameters.items():
        values = [value for value in rows.get(f"p.{name}", []) if value is not None]
        if not values:
            continue
        if isinstance(one, Choice | Grid):
            found.append(_counted(name, one, values))
        else:
            found.append(_binned(name, one, np.array(values, float), data.repeats))
    return found


def _counted(name: str, one: Choice | Grid, values: list[Any]) -> Drawn:
    import json

    def text(value: Any) -> str:
        return value if isinstance(value, str) else json.dumps(value, sort_keys=True)

    wanted = [text(float(v) if isinstance(v, int) and not isinstance(v, bool) else v) for v in one.values]
    given = [text(value) for value in values]
    weights = np.array(getattr(one, "weights", ()) or [1.0] * len(wanted), float)
    return Drawn(
        name, one.kind, tuple(wanted), np.empty(0), np.array([given.count(label) for label in wanted], float),
        weights / weights.sum() * len(values),
    )  # fmt: skip


def _binned(name: str, one: Any, values: Array, repeats: int) -> Drawn:
    asked = np.empty(0) if isinstance(one, Expressed) else np.array([one.value(u) for u in _QUANTILES], float)
    both = np.concatenate([values, asked])
    low, high = float(both.min()), float(both.max())
    log = one.kind == "log_uniform" or (one.kind != "integers" and low > 0 and high > 100 * low)
    if one.kind == "integers":
        edges = np.arange(low, high + 2) - 0.5 if high - low < 40 else np.linspace(low - 0.5, high + 0.5, _BINS + 1)
    else:
        high = high if high > low else low + max(abs(low), 1.0) * 1e-6
        edges = np.geomspace(low, high, _BINS + 1) if log else np.linspace(low, high, _BINS + 1)
        edges[0], edges[-1] = low, high
    expected = np.histogram(asked, edges)[0] * (values.size / asked.size) if asked.size else asked
    distance = limit = float("nan")
    if one.continuous:
        distance = _distance(values[::repeats], asked)
        # Kolmogorov's distribution: 1.63/√n is exceeded in 1 of 100 (Massey, J. Am. Stat. Assoc. 46:68, 1951).
        limit = 1.63 / np.sqrt(len(values[::repeats]))
    return Drawn(
        name, one.kind, (), edges, np.histogram(values, edges)[0].astype(float), expected, log, distance, limit
    )


def _distance(values: Array, asked: Array) -> float:
    """sup |F − F₀|, F₀ by the quantiles."""
    ordered = np.sort(values)
    expected = np.searchsorted(asked, ordered, side="right") / asked.size
    steps = np.arange(ordered.size + 1) / ordered.size
    return float(max(np.max(steps[1:] - expected), np.max(expected - steps[:-1])))


@dataclass(frozen=True)
class Sample:
    """A sample picture: the plane of the measured variable with most light, and of a truth; (row, col)."""

    capture: int
    part: str
    base: str
    title: str
    values: Array
    unit: str


@dataclass
class GroupFigures:
    """Figures of one modality, of `read` captures of `count`; `edges`, `found`: histogram of the quantity."""

    name: str
    count: int
    read: int = 0
    sizes: dict[str, int] = field(default_factory=dict)
    measured: str = ""
    unit: str = ""
    low: float = float("inf")
    mean: float = 0.0
    high: float = float("-inf")
    top: float = float("nan")
    saturated: float = float("nan")
    quantity: str = ""
    quantity_unit: str = ""
    edges: Array = field(default_factory=lambda: np.empty(0))
    found: Array = field(default_factory=lambda: np.empty(0))
    samples: list[Sample] = field(default_factory=list)


def group_figures(captures: ShardedSet, tell: Progress) -> GroupFigures:
    """Figures of one group. Raises InputError for a damaged capture."""
    layout = layout_of(captures.modality)
    truths = [q for q in layout.quantities if f"truth_{q.name}" in captures.variables]
    found = GroupFigures(captures.group, len(captures), measured=layout.data)
    chosen = np.unique(np.linspace(0, len(captures) - 1, min(MOST, len(captures))).round().astype(int)).tolist()
    names = [layout.data, *(f"truth_{q.name}" for q in truths[:1])]
    values: list[Array] = []
    total = saturated = 0.0
    shown: set[str] = set()
    for done, place in enumerate(chosen, 1):
        capture = captures.load(place, names)
        counts = np.asarray(capture[layout.data].values)
        found.sizes = {str(dim): int(size) for dim, size in capture[layout.data].sizes.items()}
        found.unit = str(capture[layout.data].attrs.get("units", ""))
        found.top = _top(capture.attrs)
        found.low, found.high = min(found.low, float(counts.min())), max(found.high, float(counts.max()))
        found.mean += float(counts.mean(dtype=float))
        saturated += float(np.mean(counts >= found.top)) if np.isfinite(found.top) else float("nan")
        total += 1
        if truths:
            truth = np.asarray(capture[names[1]].values, float)
            values.append(truth[np.isfinite(truth)])
        facts = captures.index(place)
        kind = f"{facts.get('part')} {facts.get('base')}"
        if kind not in shown and len(found.samples) < 12:
            shown.add(kind)
            found.samples += list(_samples(capture, names, facts))
        tell("figures", done, len(chosen), captures.group)
    found.read, found.mean, found.saturated = len(chosen), found.mean / total, saturated / total
    if truths:
        found.quantity, found.quantity_unit = truths[0].name, truths[0].unit
        every = np.concatenate(values)
        if every.size:
            found.found, found.edges = np.histogram(every, _BINS)
    return found


def _top(attrs: Mapping[str, Any]) -> float:
    """The highest value of the converter of the declared rig, DN; NaN where it states none."""
    try:
        rig = read_json(str(attrs.get("rig", "")))
    except ValueError:
        return float("nan")
    bits = list(_bits(rig))
    return float(2 ** bits[0] - 1) if bits else float("nan")


def _bits(node: Any) -> Iterator[int]:
    if isinstance(node, dict):
        for key, value in node.items():
            if key == "adc_bits" and isinstance(value, int) and 0 < value < 64:
                yield value
            else:
                yield from _bits(value)


def _samples(capture: Any, names: list[str], facts: Mapping[str, Any]) -> Iterator[Sample]:
    for name in names:
        variable = capture[name]
        planes = planes_of(name, list(map(str, variable.dims)), np.asarray(variable.values, float))
        best = brightest(planes.values) if name == names[0] else 0
        yield Sample(
            int(facts["capture"]), str(facts.get("part", "")), str(facts.get("base", "")), planes.labels()[best],
            planes.values[best], str(variable.attrs.get("units", "")),
        )  # fmt: skip
