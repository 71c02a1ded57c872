"""The report page of a run: one offline file with charts, tables, pictures, failures and the command to repeat it."""

from __future__ import annotations

import json
import shlex
from pathlib import Path
from typing import Any

from ...estimators.labels import split_label
from ..folders.files import write_text
from ..runner.costs import read_costs
from ..scores.error_tiles import read_tiles
from ..scores.tables import read_scores
from .above_bound import above_bound
from .breakdown import page_section
from .charts import panel_title, panels_of, save_charts, speed_accuracy_spec, stress_groups, stress_spec
from .data import Cell, base_cells, cells_of, read_run, seeds_of, unit_scale
from .front import mark_front
from .pictures import (
    DIVERGING,
    SEQUENTIAL,
    Picture,
    css_gradient,
    data_uri,
    error_limit,
    png,
    read_pictures,
    value_limits,
)
from .ranking import ranking_section
from .table import score_table
from .text import failures_of, number, rank, rate, skips_of_cells, summary, time_text

__all__ = ["write_report"]

_TEMPLATES = Path(__file__).parent / "templates"

#: Names that the bundled libraries provide to the script of the page.
_EXPORTS = "window.vegaEmbed = vegaEmbed;"


def write_report(run_dir: str | Path) -> Path:
    """Write `report.html`, `speed-accuracy.png` and `.svg` into the folder of a run and return the path of the page.

    Reads scores.csv (or .parquet), run.json and pictures/*.npz. The page loads nothing over the network, and its security
    policy forbids it; names are escaped, so that a table from an unknown source is safe to open.

    Raises:
        InputError: no score table, or an unreadable file.
    """
    folder = Path(run_dir)
    table = read_scores(folder)
    folder = folder if folder.is_dir() else folder.parent
    run = read_run(folder)
    pictures = read_pictures(folder / "pictures") if (folder / "pictures").is_dir() else []
    cells = cells_of(table)
    base = base_cells(cells)
    costs = read_costs(folder)
    mark_front(base, costs, read_tiles(folder))
    chart = save_charts(base, folder / "speed-accuracy.png", folder / "speed-accuracy.svg")
    page = _render(
        title=str(run.get("suite") or (table["suite"].iloc[0] if len(table) else "run")),
        summary=summary(table),
        doubts=above_bound(cells),
        counts=_counts(table, cells),
        panels=_panels(base),
        stresses=_stresses(cells),
        chart_svg=chart,
        table=score_table(cells),
        unit=unit_scale(base[0])[1] if base else "",
        noun=base[0].noun if base else "element",
        scenes=_scenes(pictures, [r.label for r in rank(base)]),
        breakdown=page_section(folder),
        failures=_failures(cells, run),
        ranking=ranking_section(folder),
        skipped=list(skips_of_cells(cells).items()),
        cached=sum(row["source"] == "cache" for row in costs),
        timed=len(costs),
        machine=_facts(run.get("machine")),
        versions=_facts(run.get("versions")),
        facts=_facts({k: v for k, v in run.items() if k not in {"machine", "versions", "failures", "command"}}),
        command=_command(run),
    )
    path = folder / "report.html"
    write_text(path, page)
    return path


def _render(**content: Any) -> str:
    import vl_convert as vlc
    from jinja2 import Environment, FileSystemLoader, StrictUndefined

    environment = Environment(
        loader=FileSystemLoader(_TEMPLATES),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    # Only our own files and the bundled library are trusted; everything from the run is inserted as data and escaped.
    trusted = {
        "css": (_TEMPLATES / "report.css").read_text(encoding="utf-8"),
        "script": (_TEMPLATES / "report.js").read_text(encoding="utf-8"),
        "vega": vlc.javascript_bundle(_EXPORTS).replace("</script", "<\\/script"),
    }
    charts = {panel["id"]: panel["spec"] for panel in [*content["panels"], *content["stresses"]]}
    return environment.get_template("report.html.j2").render(**content, **trusted, charts=_script_json(charts))


def _script_json(value: object) -> str:
    """JSON that cannot end the script element in which it stands."""
    text = json.dumps(value, allow_nan=False)
    for character in "<>&\u2028\u2029":
        text = text.replace(character, f"\\u{ord(character):04x}")
    return text


def _counts(table: Any, cells: list[Cell]) -> list[tuple[str, str]]:
    counted = {
        "estimator": len({c.label for c in cells if not c.skipped}),
        "scene": len({c.scene for c in cells}),
        "condition": len({c.condition for c in cells}),
        "seed": len(seeds_of(table)),
    }
    elements = table.groupby(["scene", "seed", "stress", "level", "stress2", "level2", "quantity"])["n"].max().sum()
    noun = cells[0].noun if cells else "element"
    counts = [(str(count), name if count == 1 else name + "s") for name, count in counted.items()]
    return [*counts, (f"{elements / 1e6:.2f} M", f"{noun}s with truth")]


def _panels(cells: list[Cell]) -> list[dict[str, Any]]:
    panels = panels_of(cells)
    result = []
    for position, (panel, group) in enumerate(panels.items()):
        factor, unit = unit_scale(group[0])
        drawn = [c for c in group if c.ok and c.cpu_per_element_s > 0 and c.rmse_full > 0]
        words = [f"{c.label} {number(c.rmse_full * factor)} {unit} at {time_text(c.cpu_per_element_s)}" for c in drawn]
        result.append(
            {
                "id": f"chart-{position}",
                "title": panel_title(panel, panels),
                "spec": speed_accuracy_spec(group, page=True) if drawn else None,
                "alt": f"CPU time per {group[0].noun} against RMSE, scene {panel[0]}: " + "; ".join(words),
            }
        )
    return result


def _stresses(cells: list[Cell]) -> list[dict[str, Any]]:
    return [
        {
            "id": f"stress-{position}",
            "title": f"{scene}, {axis}" + (f" ({condition})" if condition else ""),
            "spec": stress_spec(group, page=True),
            "alt": f"Share of failed {group[0].noun}s against {axis}, scene {scene}",
        }
        for position, ((scene, condition, axis), group) in enumerate(stress_groups(cells).items())
    ]


def _scenes(pictures: list[Picture], order: list[str]) -> list[dict[str, Any]]:
    scenes: dict[tuple[str, str], list[Picture]] = {}
    for picture in pictures:
        scenes.setdefault((picture.scene, picture.condition), []).append(picture)
    result = []
    for (scene, condition), group in scenes.items():
        group.sort(key=lambda p: order.index(p.estimator) if p.estimator in order else len(order))
        first = group[0]
        factor, unit = first.shown
        lo, hi = value_limits(first.truth, 10.0 / factor)
        limit = error_limit(group)
        entries = []
        for picture in group:
            due = picture.truth == picture.truth
            answered = ~(due & ~picture.valid)
            beyond = abs(picture.error[due & picture.valid]) > limit
            share = float(beyond.mean()) if beyond.size else 0.0
            entries.append(
                {
                    "label": picture.estimator,
                    "value": data_uri(png(_where(picture.value, picture.valid), lo, hi, SEQUENTIAL, answered=answered)),
                    "error": data_uri(
                        png(_where(picture.error, picture.valid), -limit, limit, DIVERGING, answered=answered)
                    ),
                    "invalid": rate(float((due & ~picture.valid).sum() / max(1, due.sum()))),
                    "beyond": rate(share),
                }
            )
        result.append(
            {
                "name": scene,
                "condition": condition,
                "truth": data_uri(png(group[0].truth, lo, hi, SEQUENTIAL)),
                "entries": entries,
                "quantity": first.quantity,
                "unit": first.unit,
                "error_unit": unit,
                "value_bar": css_gradient(SEQUENTIAL),
                "error_bar": css_gradient(DIVERGING),
                "value_ticks": _value_ticks(lo, hi),
                "error_ticks": [f"−{limit * factor:g}", "0", f"+{limit * factor:g}"],
            }
        )
    return result


def _where(values: Any, valid: Any) -> Any:
    import numpy as np

    return np.where(valid, values, np.nan)


def _value_ticks(lo: float, hi: float) -> list[str]:
    digits = 4 if hi - lo < 0.1 else 3 if hi - lo < 1 else 2
    return [f"{lo:.{digits}f}", f"{(lo + hi) / 2:.{digits}f}", f"{hi:.{digits}f}"]


def _failures(cells: list[Cell], run: dict[str, Any]) -> list[dict[str, Any]]:
    notes = [note for note in run.get("failures") or [] if isinstance(note, dict)]
    result = []
    for label, places in failures_of(cells).items():
        for cell in places:
            said = [
                str(n.get("message", ""))
                for n in notes
                if str(n.get("estimator", "")) in {label, split_label(label)[0]}
                and str(n.get("scene", cell.scene)) == cell.scene
            ]
            word, _, message = cell.status.partition(":")
            result.append(
                {
                    "label": label,
                    "place": cell.place,
                    "status": word,
                    "failed": rate(cell.failure_rate) if cell.ok else "–",
                    "coverage": rate(cell.coverage) if cell.ok else "–",
                    "message": "" if cell.ok else (said[0] if said else message.strip()),
                }
            )
    return result


def _facts(value: Any, prefix: str = "") -> list[tuple[str, str]]:
    """Nested data as flat (name, text) pairs for a definition list."""
    if not isinstance(value, dict):
        return []
    facts: list[tuple[str, str]] = []
    for key, item in value.items():
        name = f"{prefix}{key}"
        if isinstance(item, dict):
            facts += _facts(item, f"{name}.")
        elif item is not None and item != "" and item != []:
            plain = isinstance(item, list) and all(isinstance(i, str | int | float) for i in item)
            facts.append(
                (name, ", ".join(map(str, item)) if plain else item if isinstance(item, str) else json.dumps(item))
            )
    return facts


def _command(run: dict[str, Any]) -> str:
    command = run.get("command")
    if isinstance(command, list) and command:
        return shlex.join(["beambench" if i == 0 else str(part) for i, part in enumerate(command)])
    return str(command) if command else f"beambench run {shlex.quote(str(run.get('suite', 'SUITE')))}"
