"""The chart of fidelity: the rungs' error against cost where they were measured, else what the run's captures leave out."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from ...captures import open_captures
from ...scenes.errors import InputError
from ..scores.tables import read_numbers
from .charts import finished
from .layout import HEIGHT, WIDTH, log_domain, log_ticks
from .styles import PALETTE, SHAPES
from .text import listed, rate

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


def rungs_spec(rows: list[dict[str, Any]], *, page: bool) -> dict[str, Any] | None:
    """Relative error against CPU time of every scene and rung, with 95 % intervals; None without a measured rung."""
    import altair as alt

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
    x, y = (
        _log("cost", "CPU time of a capture, s", data, ("cost",)),
        _log("error", "relative error", data, ("lo", "hi")),
    )
    colour = alt.Color(
        "rung:N", scale=alt.Scale(domain=rungs, range=list(PALETTE[: len(rungs)])),
        legend=alt.Legend(title=None, orient="top"),
    )  # fmt: skip
    shapes = alt.Scale(domain=rungs, range=list(SHAPES[: len(rungs)]))
    shape = alt.Shape("rung:N", scale=shapes, legend=alt.Legend(title=None, orient="top"))
    base = alt.Chart(alt.InlineData(values=data)).encode(x=x, color=colour)
    dots = base.mark_point(size=60, filled=True).encode(
        y=y, shape=shape, tooltip=[alt.Tooltip(f"{k}:N") for k in ("scene", "rung", "shown")]
    )
    layers = alt.layer(base.mark_rule(opacity=0.5).encode(y=alt.Y("lo:Q"), y2="hi:Q"), dots)
    return finished(layers.properties(width="container" if page else WIDTH, height=HEIGHT), page=page)


def _log(name: str, title: str, data: list[dict[str, Any]], spans: tuple[str, ...]) -> Any:
    import altair as alt

    cls = alt.X if name == "cost" else alt.Y
    lo, hi = log_domain([p[k] for p in data for k in spans])
    scale = alt.Scale(type="log", domain=[lo, hi], nice=False)
    return cls(f"{name}:Q", title=title, scale=scale, axis=alt.Axis(format="~g", values=log_ticks(lo, hi)))


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


def effects_spec(record: Mapping[str, Any], *, page: bool) -> dict[str, Any] | None:
    """Chart of a capture's effects by predicted size relative to the signal, modelled ones apart from neglected ones.

    The dashed line is the tolerance. None without an effect of known size.
    """
    sized = [e for e in record["effects"] if _size(e) > 0]
    return _effects_chart(sized, record.get("rtol"), page=page) if sized else None


def _effects_chart(sized: list[dict[str, Any]], rtol: object, *, page: bool) -> dict[str, Any]:
    import altair as alt

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
    scale = alt.Scale(type="log", domain=[lo, hi], nice=False)
    axis = alt.Axis(format="~%" if lo > 1e-5 else "~e", values=log_ticks(lo, hi), labelOverlap=True)
    x = alt.X("size:Q", title="predicted size, share of the signal", scale=scale, axis=axis)
    y = alt.Y("name:N", title=None, sort=None, axis=alt.Axis(labelLimit=150))
    kinds = ["neglected", "modelled"]
    looks = (_NEGLECTED, _MODELLED)
    colour = alt.Color(
        "what:N",
        scale=alt.Scale(domain=kinds, range=[c for c, _ in looks]),
        legend=alt.Legend(title=None, orient="top"),
    )
    shape = alt.Shape(
        "what:N",
        scale=alt.Scale(domain=kinds, range=[s for _, s in looks]),
        legend=alt.Legend(title=None, orient="top"),
    )
    base = alt.Chart(alt.InlineData(values=data)).encode(y=y, color=colour)
    tips = [alt.Tooltip(f"{k}:N", title=t) for k, t in (("name", "effect"), ("shown", "size"), ("basis", "basis"))]
    layers: list[Any] = [
        base.mark_rule(opacity=0.4, strokeWidth=2).encode(x=alt.X("from:Q", scale=scale), x2="size:Q"),
        base.mark_point(size=80, filled=True, opacity=1).encode(x=x, shape=shape, tooltip=tips),
    ]
    if limit:
        rule = alt.Chart(alt.InlineData(values=[{"limit": limit[0]}]))
        layers.append(
            rule.mark_rule(strokeDash=[5, 4]).encode(x=alt.X("limit:Q", scale=scale), color=alt.value("#8a8f98"))
        )
    chart = alt.layer(*layers).properties(width="container" if page else WIDTH, height=HEIGHT)
    return finished(chart, page=page)


def _size(effect: Mapping[str, Any]) -> float:
    size = effect.get("predicted_relative_size")
    return float(size) if isinstance(size, int | float) else math.nan
