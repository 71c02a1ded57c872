"""The look of a run: its charts of speed against accuracy, and the truth, the best estimate and its error of one scene."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from ..report.charts import Spec, panel_title, panels_of, speed_accuracy_spec
from ..report.data import base_cells, cells_of
from ..report.front import mark_front
from ..report.pictures import DIVERGING, SEQUENTIAL, Picture, error_limit, read_pictures, value_limits
from ..report.styles import styles_of
from ..report.text import rank
from ..runner.costs import read_costs
from ..scores.error_tiles import read_tiles
from ..scores.tables import read_scores
from .panel import Curves, Image

__all__ = ["run_look"]

#: Charts that are shown; the page has all.
_MOST = 3


def run_look(folder: Path) -> tuple[list[Spec], list[Image | Curves]]:
    """The first charts as parts of a spec, and the panels of one scene. Raises InputError as `report` does."""
    base = base_cells(cells_of(read_scores(folder)))
    mark_front(base, read_costs(folder), read_tiles(folder))
    styles = styles_of(cell.label for cell in base if not cell.skipped)
    panels = panels_of([cell for cell in base if not cell.skipped])
    charts = []
    for panel, cells in list(panels.items())[:_MOST]:
        spec = speed_accuracy_spec(cells, page=False, styles=styles) | {"title": panel_title(panel, panels)}
        charts.append({name: part for name, part in spec.items() if name not in ("$schema", "config")})
    pictures = read_pictures(folder / "pictures") if (folder / "pictures").is_dir() else []
    return charts, _scene(pictures, [one.label for one in rank(base)])


def _scene(pictures: list[Picture], order: list[str]) -> list[Image | Curves]:
    """Truth, estimate and error of the first scene with pictures, by the estimator that ranks first among those drawn."""
    if not pictures:
        return []
    first = pictures[0]
    key = (first.scene, first.condition, first.quantity)
    group = [one for one in pictures if (one.scene, one.condition, one.quantity) == key]
    best = min(group, key=lambda one: order.index(one.estimator) if one.estimator in order else len(order))
    factor, unit = best.shown
    low, high = value_limits(best.truth, 10.0 / factor)
    limit = error_limit(group)
    value, error = (np.where(best.valid, array, np.nan).astype(np.float64) for array in (best.value, best.error))
    return [
        Image(f"{best.scene}: true {best.quantity}", best.truth.astype(np.float64), best.unit, low, high, SEQUENTIAL),
        Image(best.estimator, value, best.unit, low, high, SEQUENTIAL),
        Image(f"error of {best.estimator}", error * factor, unit, -limit * factor, limit * factor, DIVERGING),
    ]
