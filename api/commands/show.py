"""The command `show`."""

from __future__ import annotations

import sys
from typing import TYPE_CHECKING, Any

from ..console import print_lines
from .build import Arguments, View, command

if TYPE_CHECKING:
    from ..benchmarks.looks.panel import Curves, Image
    from ..benchmarks.looks.shown import Shown

__all__ = ["SHOW"]


def _facts(panel: Image | Curves) -> dict[str, Any]:
    from ..benchmarks.looks.panel import Image

    if isinstance(panel, Image):
        rows, cols = panel.values.shape
        return {
            "title": panel.title,
            "rows": rows,
            "cols": cols,
            "low": panel.low,
            "high": panel.high,
            "unit": panel.unit,
        }
    return {
        "title": panel.title,
        "x": panel.x,
        "y": panel.y,
        "curves": list(dict.fromkeys(c.name for c in panel.lines)),
    }


def _json(shown: Shown, given: Arguments) -> dict[str, Any]:
    return {
        "title": shown.title,
        "file": None if shown.file is None else str(shown.file),
        "page": None if shown.page is None else str(shown.page),
        "panels": [_facts(panel) for panel in shown.panels],
    }


def _text(shown: Shown, given: Arguments) -> None:
    from ..coloured import drawn, told

    nowhere = shown.file is None and not given["browser"]
    if given["terminal"] or (nowhere and sys.stdout.isatty()):
        for line in drawn(shown.panels):
            print(line)
    else:
        print_lines(*(told(panel) for panel in shown.panels))
        if nowhere:
            print_lines("next     -o picture.png, --terminal or --browser draws it")
    if shown.page is not None:
        from .run import closing_of

        print_lines(*closing_of(given["data"]), f"page     {shown.page.resolve()}")
    if shown.file is not None:
        print_lines(f"picture  {shown.file}")


SHOW = command(
    "show",
    "show:show",
    View(_text, _json),
    examples="""Examples:
  beambench show step.zarr
  beambench show step.zarr --capture 2 --element 30 -o slice-30.png
  beambench show beambench-runs/quickstart-20260102-030405 --browser""",
)
