"""The report page of a run: one offline file with charts, tables, pictures, failures and the command to repeat it."""

from __future__ import annotations

import json
import shlex
from collections.abc import Mapping
from concurrent.futures import Future
from pathlib import Path
from typing import Any

from ...estimators.labels import split_label
from ..folders.files import write_bytes, write_text
from ..runner.costs import read_costs
from ..runner.jail import NO_JAIL
from ..scores.error_tiles import read_tiles
from ..scores.tables import read_scores
from .above_bound import above_bound
from .apart import Apart, start
from .breakdown import page_section
from .bundled import chart_library
from .cell import Cell, common_noun
from .charts import STILLS, VERDICT_MARKS, still_spec
from .data import base_cells, cells_of, read_run, seeds_of, unit_scale
from .exports import EXPORTS, write_exports
from .front import mark_front
from .numbers import count_text, rate
from .opening import charts_of
from .pairs import pairs_section
from .picture_section import picture_scenes, reliefs_of
from .pictures import DIVERGING, SEQUENTIAL, Picture, read_pictures
from .ranking import ranking_section, read_pairs, read_ranking
from .stress_chart import static_stresses
from .styles import Style, styles_of
from .table import score_table, sorted_cells
from .table_csv import table_csv
from .text import failures_of, rank, skips_of_cells, summary

__all__ = ["write_report"]

_TEMPLATES = Path(__file__).parent / "templates"
_SCRIPTS = ("state.js", "charts.js", "tables.js", "relief.js", "report.js")

#: Names that the bundled libraries provide to the script of the page.
_EXPORTS = "window.vegaEmbed = vegaEmbed;"
#: Facts of run.json that stand beside the verdict; all of them stand at the end of the page.
_PROVENANCE = ("suite", "version", "hash", "split", "seeds", "started", "finished", "isolation")


def write_report(run_dir: str | Path) -> Path:
    """Write `report.html` into the folder of a run and return its path; beside it the same results for other programs.

    These are `report.csv`, `report.md`, `report.tex` with `report.bib`, and the chart `speed-accuracy.png` and `.svg`. Reads
    scores.csv (or .parquet), run.json, pictures/*.npz, captures/*.zarr (what they leave out), and the tables of ranking,
    pairs, breakdown and rungs. The page loads nothing over the network, and its security policy forbids it; names are
    escaped, so that a table from an unknown source is safe to open.

    Raises:
        InputError: no score table, or an unreadable file.
    """
    folder = Path(run_dir)
    table = read_scores(folder)
    folder = folder if folder.is_dir() else folder.parent
    run = read_run(folder)
    pictures = read_pictures(folder / "pictures") if (folder / "pictures").is_dir() else []
    cells = cells_of(table)
    ran = [cell for cell in cells if not cell.skipped]  # those that do not apply have a list of their own
    base = base_cells(cells)
    costs = read_costs(folder)
    mark_front(base, costs, read_tiles(folder))
    styles = styles_of(c.label for c in ran)
    apart = start(still_spec(base, styles), scale=2.0)
    charts = charts_of(folder, base, cells, styles, _folder_name(folder))
    order = [r.label for r in rank(base)]
    suite = str(run.get("suite") or (table["suite"].iloc[0] if len(table) else "run"))
    words = {"title": str(run.get("title") or suite), "command": _command(run)}
    sentences = summary(table, read_pairs(folder))
    content = dict(
        **words, suite=suite, summary=sentences,
        doubts=above_bound(cells),
        counts=_counts(table, cells),
        opening=charts.opening,
        panels=charts.panels,
        stresses=charts.stresses,
        estimators=_legend(ran, order, styles),
        stress_svg=static_stresses(charts.groups, styles),
        table=score_table(ran),
        verdict_marks=VERDICT_MARKS,
        unit=_only([unit_scale(c)[1] for c in cells], ""),
        noun=common_noun(cells),
        scenes=picture_scenes(pictures, order),
        breakdown=page_section(folder),
        failures=_failures(cells, run),
        ranking=ranking_section(folder),
        pairs=pairs_section(folder),
        no_jail=NO_JAIL if any(row.get("jail") == "no" for row in read_ranking(folder)) else "",
        skipped=list(skips_of_cells(cells).items()),
        cached=sum(row["source"] == "cache" for row in costs),
        timed=len(costs),
        **_record(run) | {"stills": STILLS},
        exports=EXPORTS,
        data=_data(charts.specs(), ran, pictures, order),
    )  # fmt: skip
    write_text(folder / "report.html", _render(apart, folder, **content))
    write_exports(folder, **words, sentences=sentences, base=base_cells(ran), shown=sorted_cells(ran))
    return folder / "report.html"


def _saved(drawn: Apart, folder: Path) -> str:
    """Write the drawings of the first chart into the folder; returns the SVG that the page shows without scripts."""
    write_bytes(folder / "speed-accuracy.png", drawn.png)
    write_text(folder / "speed-accuracy.svg", drawn.svg)
    return drawn.svg


def _only(words: list[str], otherwise: str) -> str:
    """The word, where all are the same."""
    return words[0] if len(set(words)) == 1 else otherwise


def _folder_name(folder: Path) -> str:
    """The folder's name for commands. A run that replaces another is in its folder `unfinished` until it is complete."""
    path = folder.resolve()
    return shlex.quote(path.parent.name if path.name == "unfinished" else path.name)


def _data(specs: dict[str, Any], cells: list[Cell], pictures: list[Picture], order: list[str]) -> dict[str, str]:
    """What the page's script reads, as JSON by element id: charts, the table as CSV text, reliefs with their colours."""
    reliefs = {"scenes": reliefs_of(pictures, order), "value": SEQUENTIAL, "error": DIVERGING}
    return {
        name: _script_json(value)
        for name, value in (("charts", specs), ("csv", table_csv(sorted_cells(cells))), ("reliefs", reliefs))
    }


def _legend(ran: list[Cell], order: list[str], styles: Mapping[str, Style]) -> list[dict[str, str]]:
    """The estimators with colour and mark, the most accurate first."""
    labels = sorted({c.label for c in ran}, key=lambda n: (order.index(n) if n in order else len(order), n))
    return [{"label": n, "colour": styles[n][0], "shape": styles[n][1]} for n in labels]


def _record(run: dict[str, Any]) -> dict[str, list[tuple[str, str]]]:
    """The facts of run.json: those beside the verdict, and all of them in three groups."""
    rest = {k: v for k, v in run.items() if k not in {"machine", "versions", "failures", "command"}}
    return {
        "provenance": _provenance(run),
        "machine": _facts(run.get("machine")),
        "versions": _facts(run.get("versions")),
        "facts": _facts(rest),
    }


def _provenance(run: dict[str, Any]) -> list[tuple[str, str]]:
    """The facts that identify a run: suite and its hash, seeds, times, machine and versions."""
    facts = _facts({name: run.get(name) for name in _PROVENANCE})
    machine = run.get("machine") or {}
    versions = run.get("versions") or {}
    facts += [(name, str(machine[name])) for name in ("processor", "cpu", "device_class") if machine.get(name)]
    return facts + [(name, str(versions[name])) for name in ("beambench", "python") if versions.get(name)]


def _render(apart: Future[Apart], folder: Path, **content: Any) -> str:
    """The page; waits for the drawings, and writes their files."""
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
        "script": "\n".join((_TEMPLATES / name).read_text(encoding="utf-8") for name in _SCRIPTS),
        "vega": chart_library(_EXPORTS).replace("</script", "<\\/script"),
    }
    return environment.get_template("report.html.j2").render(
        chart_svg=_saved(apart.result(), folder), **content, **trusted
    )


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
    counts = [(str(count), name if count == 1 else name + "s") for name, count in counted.items()]
    return [*counts, (count_text(elements), f"{common_noun(cells)}s with truth")]


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
    if not run:
        return "# run.json is missing: the command that made these tables is not known"
    if isinstance(command, list) and command:
        return shlex.join(["beambench" if i == 0 else str(part) for i, part in enumerate(command)])
    return str(command) if command else f"beambench run {shlex.quote(str(run.get('suite', 'SUITE')))}"
