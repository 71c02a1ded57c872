"""The three charts on which the page opens: speed against accuracy, breakdown under stress, and fidelity."""

from __future__ import annotations

import tomllib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial
from itertools import islice
from pathlib import Path
from typing import Any

from ...estimators.builtin import BUILTIN
from ...estimators.labels import links_of, split_label
from ...estimators.registry import get_estimator
from .cell import common_noun
from .charts import panel_title, panels_of, speed_accuracy_spec, svg_of
from .data import Cell, unit_scale
from .fidelity_chart import effects_of, effects_spec, effects_words, read_rungs, rungs_spec
from .numbers import number, time_text
from .stress_chart import stress_groups, stress_spec
from .styles import Style
from .text import listed

__all__ = ["Charts", "charts_of"]

_LIBRARY = Path(__file__).parents[1] / "suites" / "library"


@dataclass
class Charts:
    """The charts of a page.

    `panels`, `stresses`: charts of every scene and of every stress, as {id, title, spec, plain, alt}; `plain` gives the spec of
    the picture for readers without scripts. `opening`: the three places
    {title, note, choices, missing, command}; `choices` are such charts, and without one `command` makes what is `missing`.
    """

    panels: list[dict[str, Any]]
    stresses: list[dict[str, Any]]
    opening: list[dict[str, Any]]
    groups: dict[str, list[Cell]] = field(default_factory=dict)

    def specs(self) -> dict[str, Any]:
        """All specs by id."""
        all_charts = [*self.panels, *self.stresses, *(c for place in self.opening for c in place["choices"])]
        return {chart["id"]: chart["spec"] for chart in all_charts}


def charts_of(folder: Path, base: list[Cell], cells: list[Cell], styles: Mapping[str, Style], name: str) -> Charts:
    """The charts of a run's folder.

    Main arguments:
        base, cells: unstressed cells, and all. styles: of the estimators. name: of the folder, for commands.
    """
    groups = {
        f"{scene}, {axis}" + (f" ({condition})" if condition else ""): group
        for (scene, condition, axis), group in stress_groups(cells).items()
    }
    panels, stresses = _panels(base, styles), _stresses(groups, styles)
    noun = common_noun(base)
    opening = [
        _place("Speed against accuracy", f"CPU time per {noun} against error; lower left is better.", panels, "", ""),
        _place(
            "Breakdown", f"Share of failed {noun}s as a stress grows; lower is better.", stresses,
            "This run applies no stress at two levels or more. This command measures where its estimators fail:",
            "" if any(chart["spec"] for chart in stresses) else f"beambench sweep {_stress_suite(cells)}",
        ),
        _fidelity(folder, cells, name),
    ]  # fmt: skip
    return Charts(panels, stresses, opening, groups)


def _place(title: str, note: str, choices: list[dict[str, Any]], missing: str, command: str) -> dict[str, Any]:
    drawn = [chart for chart in choices if chart["spec"] is not None]
    return {
        "title": title,
        "note": note,
        "choices": drawn,
        "static": svg_of(drawn[0]["plain"]()) if drawn else "",
        "missing": "" if drawn else missing or "No estimator gave a result.",
        "command": "" if drawn else command,
    }


def _panels(cells: list[Cell], styles: Mapping[str, Style]) -> list[dict[str, Any]]:
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
                "spec": speed_accuracy_spec(group, page=True, styles=styles) if drawn else None,
                "plain": partial(speed_accuracy_spec, group, page=False, styles=styles),
                "alt": f"CPU time per {common_noun(group)} against RMSE, scene {panel[0]}: " + "; ".join(words),
            }
        )
    return result


def _stresses(groups: Mapping[str, list[Cell]], styles: Mapping[str, Style]) -> list[dict[str, Any]]:
    return [
        {
            "id": f"stress-{position}",
            "title": title,
            "spec": stress_spec(group, page=True, styles=styles) if any(not c.skipped for c in group) else None,
            "plain": partial(stress_spec, group, page=False, styles=styles),
            "alt": f"Share of failed {common_noun(group)}s against {group[0].stress}, scene {group[0].scene}",
        }
        for position, (title, group) in enumerate(groups.items())
    ]


def _fidelity(folder: Path, cells: list[Cell], name: str) -> dict[str, Any]:
    """Measured rungs where the folder has them, else the effects of its captures."""
    rows = read_rungs(folder)
    modality = cells[0].modality if cells else ""
    if rows and (spec := rungs_spec(rows, page=True)):
        rungs = listed(list(dict.fromkeys(str(row["rung"]) for row in rows)), 6)
        chart = {"id": "fidelity-0", "title": "measured rungs", "spec": spec,
                 "plain": partial(rungs_spec, rows, page=False),
                 "alt": f"Relative error against CPU time of the rungs {rungs}"}  # fmt: skip
        return _place("Fidelity", "Error of the generator's rungs against their cost.", [chart], "", "")
    choices = []
    for position, (scene, record) in enumerate(effects_of(folder).items()):
        spec, words = effects_spec(record, page=True), effects_words(record)
        choices.append({"id": f"fidelity-{position}", "title": scene, "spec": spec, "words": words,
                        "plain": partial(effects_spec, record, page=False),
                        "alt": f"Predicted size of the effects in captures of {scene}. {words}"})  # fmt: skip
    return _place(
        "Fidelity", "Predicted size of each effect in the captures; the dashed line is the tolerance.", choices,
        "The folder holds no captures that state their effects. This command measures the error of the generator's rungs:",
        f"beambench fidelity --modality {modality} -o {name}/fidelity",
    )  # fmt: skip


def _stress_suite(cells: list[Cell]) -> str:
    """The suite of stresses in the library that shares most estimators with the run, and reads captures of its modality."""
    labels, modality = {cell.label for cell in cells}, cells[0].modality if cells else ""
    held = {
        path.stem: tomllib.loads(path.read_text(encoding="utf-8")).get("estimators", [])
        for path in sorted(_LIBRARY.glob("stress-*.toml"))
    }
    shared = {suite: len(labels & set(names)) for suite, names in held.items()}
    best = [suite for suite in held if shared[suite] == max(shared.values())]
    # To know the modality of an estimator is to import it: only ties are asked for it.
    same = (suite for suite in best if len(best) > 1 and _reads(held[suite], modality))
    return next(same, best[0] if best else "SUITE")


def _reads(labels: Sequence[str], modality: str) -> bool:
    """Whether the first built-in estimator of the labels reads captures of the modality."""
    known = (first for label in labels if (first := links_of(split_label(label)[0])[0]) in BUILTIN)
    return any(get_estimator(first).modality == modality for first in islice(known, 1))
