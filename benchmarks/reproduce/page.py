"""The page of the reproduction: every item with its rows and pictures, in one offline HTML file."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from ..report.pictures import data_uri
from .rows import VERDICTS, Row

__all__ = ["MEANINGS", "render_page"]

MEANINGS = {
    "arithmetic": "follows by calculation from what is printed alone, and agrees with a printed number; or two printed "
    "expressions agree with each other",
    "predicted": "a model that was not fitted to the number gives it within the tolerance, and a guess without a model does not",
    "fitted": "a parameter was chosen to give the number: not evidence",
    "by-construction": "follows from our own choices, with no printed value to compare: not evidence",
    "trend": "no number is printed; the stated direction holds for every value of the unspecified parameters that is possible "
    "with the printed ones",
    "undetermined": "so much is unspecified that agreement and disagreement are both possible; or the agreement has no power; "
    "or the result depends on a choice of ours",
    "contradicted": "does not follow from the document's own equations or data, or a calculation gives another value; for a "
    "reading of Table 1: not under that reading",
}
assert tuple(MEANINGS) == VERDICTS

_CAPTIONS = {
    "Figure 2": "Eq. 4 against angle for four surfaces. Parameters are ours.",
    "Figure 3": "Bars: one experiment of 30 measurements. Red: expected from the noise.",
    "Figure 4": "Dots: 30 measurements each. Lines: expected from the noise. Legend: reflectivity.",
    "Figure 6": "Light on a flat wall against radius in the image.",
    "Figure 7": "Mean of 30 measurements by weighted average, in five experiments that might correspond to the figure.",
    "Table 1": "Diamonds: published. Bars: predictions of a reading over rigs that the document does not exclude; tick: median.",
}


def _text(value: float) -> str:
    if math.isnan(value):
        return "–"
    return f"{value:.4g}" if value == 0.0 or 1e-3 <= abs(value) < 1e5 else f"{value:.2e}"


def render_page(
    rows: Sequence[Row], charts: dict[str, bytes], objects: dict[str, tuple[str, bytes]], names: Sequence[str],
    without: dict[str, str],
) -> str:  # fmt: skip
    """HTML of rows by item, with charts (item -> PNG) and pictures of the objects (name -> (caption, PNG)).

    `names` are the items in their order; `without` says of each that has no row why.
    """
    from jinja2 import Environment, FileSystemLoader, StrictUndefined

    items = []
    for name in names:
        pictures = [{"uri": data_uri(charts[name]), "caption": _CAPTIONS[name]}] if name in charts else []
        pictures += [{"uri": data_uri(image), "caption": caption} for caption, image in objects.values()
                     if caption.startswith(f"{name}:")]  # fmt: skip
        mine = [_shown(row) for row in rows if row.item == name]
        slug = name.lower().replace(" ", "-").replace(".", "")
        items.append({"name": name, "slug": slug, "pictures": pictures, "rows": mine,
                      "why": "" if mine else without[name]})  # fmt: skip
    environment = Environment(
        loader=FileSystemLoader(Path(__file__).parent / "templates"), autoescape=True, undefined=StrictUndefined,
        trim_blocks=True, lstrip_blocks=True,
    )  # fmt: skip
    counts = [(verdict, sum(row.verdict == verdict for row in rows)) for verdict in VERDICTS]
    template = environment.get_template("reproduction.html.j2")
    return template.render(items=items, counts=counts, meanings=list(MEANINGS.items()))


def _shown(row: Row) -> dict[str, Any]:
    return {
        "quantity": row.quantity, "unit": row.unit, "published": _text(row.published), "verdict": row.verdict,
        "reproduced": _text(row.reproduced), "tolerance": _text(row.tolerance), "note": row.note,
        "free": row.free_parameters,
    }  # fmt: skip
