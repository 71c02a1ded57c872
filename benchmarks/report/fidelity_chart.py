"""The chart of fidelity: the rungs' error against cost where they were measured, else what the run's captures leave out."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from ...captures import open_captures
from ...scenes.errors import InputError
from ..scores.tables import read_numbers
from .charts import Spec, finished, quantitative
from .layout import HEIGHT, WIDTH, log_domain, log_ticks
from .numbers import rate
from .styles import PALETTE, SHAPES
from .text import listed

__all__ = ["effects_of", "effects_spec", "effects_words", "read_rungs", "rungs_spec"]

_NUMBERS = ("cpu_s", "rel_error", "lo", "hi")
_FLOOR = 1e-6  # smaller effects and errors are drawn here, so that a logarithmic axis has an end
_NEGLECTED, _MODELLED = (PALETTE[1], SHAPES[1]), (PALETTE[0], SHAPES[0])


def read_rungs(folder: Path) -> list[dict[str, Any]]:
    """The rows of fidelity.csv in the folder of a run or in its folder `fidelity`; empty without such a file.

    Raises:
        InputError: the file is not such a table.
    """
    for path in (folder / "fidelity.csv", folder / "fidelity" / "fidelity.csv"):
        rows = read_numbers(path, _NUMBERS, "The table of rungs", texts=("scene", "rung"))
        if rows:
            return rows
    return []


def rungs_spec(rows: list[dict[str, Any]], *, page: bool) -> Spec | None:
    """Relative error against CPU time of every scene and rung, with 95 % intervals; None without a measured rung."""
    points: dict[tuple[str, str], dict[str, Any]] = {}
    for row in rows:  # a scene has a row per rung and limit, with the same error
        if 0 < row["cpu_s"] < math.inf and math.isfinite(row["rel_error"]):
            low, high = (row[k] if math.isfinite(row[k]) else row["rel_error"] for k in ("lo", "hi"))
            points[row["scene"], row["rung"]] = {
                "cost": row["cpu_s"], "error": max(row["rel_error"], _FLOOR), "lo": max(low, _FLOOR),
                "hi": max(high, _FLOOR), "rung": row["rung"], "scene": row["scene"], "shown": rate(row["rel_error"]),
            }  # fmt: skip
    if not points:
        return None
    data = list(points.values())
    rungs = list(dict.fromkeys(p["rung"] for p in data))
    x = quantitative("cost", "CPU time of a capture, s") | _log([p["cost"] for p in data])
    y = quantitative("error", "relative error") | _log([p[k] for p in data for k in ("lo", "hi")])
    looks = {name: _legend("rung", rungs, values) for name, values in (("color", PALETTE), ("shape", SHAPES))}
    span = {"field": "lo", "type": "quantitative"}, {"field": "hi"}
    tips = [{"field": k, "type": "nominal"} for k in ("scene", "rung", "shown")]
    place = {"x": x, "color": looks["color"]}
    layers = [
        {"mark": {"type": "rule", "opacity": 0.5}, "encoding": place | {"y": span[0], "y2": span[1]}},
        {"mark": {"type": "point", "size": 60, "filled": True},
         "encoding": place | {"y": y, "shape": looks["shape"], "tooltip": tips}},
    ]  # fmt: skip
    return _drawn(data, layers, page)


def _drawn(data: list[dict[str, Any]], layers: list[Spec], page: bool) -> Spec:
    chart = {"data": {"values": data}, "layer": layers, "width": "container" if page else WIDTH, "height": HEIGHT}
    return finished(chart, page=page)


def _legend(field: str, names: list[str], values: Sequence[str]) -> Spec:
    """A channel that shows the names of a field by these values, and explains them above the chart."""
    scale = {"domain": names, "range": list(values[: len(names)])}
    return {"field": field, "type": "nominal", "scale": scale, "legend": {"title": None, "orient": "top"}}


def _log(values: list[float]) -> Spec:
    lo, hi = log_domain(values)
    scale = {"type": "log", "domain": [lo, hi], "nice": False}
    return {"scale": scale, "axis": {"format": "~g", "values": log_ticks(lo, hi)}}


def effects_of(folder: Path) -> dict[str, dict[str, Any]]:
    """{scene: the record `fidelity` of its capture} (rung, tolerance and catalogued effects) from the run's captures.

    One unstressed capture per scene. A capture that cannot be read, or that was recorded, has no such record; the run's
    tables do not depend on it.
    """
    found: dict[str, dict[str, Any]] = {}
    for path in sorted((folder / "captures").glob("*.zarr")):
        scene, _, rest = path.stem.partition("__")
        if scene in found or not rest.startswith("seed="):
            continue
        try:
            text = open_captures(path).attributes(0).get("fidelity")
            record = json.loads(text) if isinstance(text, str) else None
        except (InputError, ValueError):
            continue
        if isinstance(record, Mapping) and isinstance(record.get("effects"), list):
            found[scene] = dict(record)
    return found


def effects_words(record: Mapping[str, Any]) -> str:
    """The rung of a capture, and the effects without a size: absent ones are zero, of the others no bound is known."""
    absent = sum(_size(e) == 0 for e in record["effects"])
    neglected = [str(e["name"]) for e in record["effects"] if math.isnan(_size(e)) and not e.get("modelled")]
    words = f"Rung {record.get('rung', '')}."
    if absent:
        words += f" {absent} catalogued effects are absent from this scene (size zero)."
    if neglected:
        words += f" Neglected, of unknown size: {listed(neglected, 5)}."
    return words


def effects_spec(record: Mapping[str, Any], *, page: bool) -> Spec | None:
    """Chart of a capture's effects by predicted size relative to the signal, modelled ones apart from neglected ones.

    The dashed line is the tolerance. None without an effect of known size.
    """
    sized = [e for e in record["effects"] if _size(e) > 0]
    return _effects_chart(sized, record.get("rtol"), page=page) if sized else None


def _effects_chart(sized: list[dict[str, Any]], rtol: object, *, page: bool) -> Spec:
    sized = sorted(sized, key=lambda e: -_size(e))[:14]
    data = [
        {
            "name": str(e["name"]), "size": max(_size(e), _FLOOR), "shown": rate(_size(e)),
            "what": "modelled" if e.get("modelled") else "neglected", "basis": str(e.get("basis", "")),
        }
        for e in sized
    ]  # fmt: skip
    limit = [float(rtol)] if isinstance(rtol, int | float) and rtol > 0 else []
    lo, hi = log_domain([max(_size(e), _FLOOR) for e in sized] + limit)
    data = [point | {"from": lo} for point in data]
    scale = {"type": "log", "domain": [lo, hi], "nice": False}
    axis = {"format": "~%" if lo > 1e-5 else "~e", "values": log_ticks(lo, hi), "labelOverlap": True}
    x = quantitative("size", "predicted size, share of the signal") | {"scale": scale, "axis": axis}
    y = {"field": "name", "type": "nominal", "title": None, "sort": None, "axis": {"labelLimit": 150}}
    kinds = ["neglected", "modelled"]
    colour, shape = (_legend("what", kinds, values) for values in zip(_NEGLECTED, _MODELLED, strict=True))
    tips = [{"field": k, "type": "nominal", "title": t}
            for k, t in (("name", "effect"), ("shown", "size"), ("basis", "basis"))]  # fmt: skip
    span = {"x": {"field": "from", "type": "quantitative", "scale": scale}, "x2": {"field": "size"}}
    place = {"y": y, "color": colour}
    layers: list[Spec] = [
        {"mark": {"type": "rule", "opacity": 0.4, "strokeWidth": 2}, "encoding": place | span},
        {"mark": {"type": "point", "size": 80, "filled": True, "opacity": 1},
         "encoding": place | {"x": x, "shape": shape, "tooltip": tips}},
    ]  # fmt: skip
    if limit:
        at = {"field": "limit", "type": "quantitative", "scale": scale}
        layers.append({
            "data": {"values": [{"limit": limit[0]}]}, "mark": {"type": "rule", "strokeDash": [5, 4]},
            "encoding": {"x": at, "color": {"value": "#8a8f98"}},
        })  # fmt: skip
    return _drawn(data, layers, page)


def _size(effect: Mapping[str, Any]) -> float:
    size = effect.get("predicted_relative_size")
    return float(size) if isinstance(size, int | float) else math.nan
