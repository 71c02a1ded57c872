"""A picture of a capture or of a run: what notebooks draw, and what is written to files and terminals."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from html import escape
from pathlib import Path
from typing import TYPE_CHECKING

import xarray as xr

from ...captures.store.faces import open_captures
from ...scenes.errors import InputError
from ..report.charts import Spec, svg_of
from . import look_of
from .panel import Curves, Image

if TYPE_CHECKING:
    import altair

__all__ = ["Shown", "shown_capture", "shown_run"]

_SCALE = 1.5
_PAGE = """<!doctype html>
<html lang="en"><meta charset="utf-8"><title>{title}</title>
<style>body{{margin:2rem;background:#fff}}svg{{max-width:100%;height:auto}}</style>
{svg}
</html>
"""


@dataclass(frozen=True, eq=False)
class Shown:
    """A picture. In a notebook it draws itself.

    Main arguments:
        title: of all. panels: images and curves, with their values.
    Other arguments:
        charts: further charts, before the panels. file: where it was written. page: of a run, where there is one.
    """

    title: str
    panels: tuple[Image | Curves, ...]
    charts: tuple[Spec, ...] = ()
    file: Path | None = None
    page: Path | None = None

    @cached_property
    def spec(self) -> Spec:
        """The chart as a Vega-Lite spec."""
        from .chart import chart_of

        return chart_of([*self.charts, *self.panels], self.title)

    def chart(self) -> altair.TopLevelMixin:
        """The chart as Altair's, to be changed, joined and saved."""
        import altair

        return altair.ConcatChart.from_dict(self.spec)

    def svg(self) -> str:
        """The text of an SVG file."""
        return svg_of(self.spec)

    def png(self) -> bytes:
        """The bytes of a PNG file."""
        import vl_convert

        image: bytes = vl_convert.svg_to_png(self.svg(), scale=_SCALE)
        return image

    def html(self) -> str:
        """A page of one picture, which loads nothing."""
        return _PAGE.format(title=escape(self.title), svg=self.svg())

    def _repr_png_(self) -> bytes:
        return self.png()


def shown_capture(data: str | Path | xr.Dataset, capture: int, element: int | None) -> Shown:
    """The picture of a capture of a store, or of one in memory. Raises InputError: no store, no such capture or element."""
    if isinstance(data, xr.Dataset):
        one, name = data, "capture"
    else:
        captures = open_captures(data)
        if not 0 <= capture < len(captures):
            raise InputError(
                "The store has no such capture.", where="capture", value=capture, allowed=f"0 … {len(captures) - 1}",
                next_step=f"beambench data status {data}",
            )  # fmt: skip
        one, name = captures[capture], f"{Path(data).name}, capture {capture}"
    panels = look_of(one.attrs.get("modality"))(one, element)
    return Shown(name, tuple(panels))


def shown_run(folder: Path) -> Shown:
    """The picture of a run. Raises InputError where it has no table of scores."""
    from .run import run_look

    charts, panels = run_look(folder)
    page = folder / "report.html"
    return Shown(folder.name, tuple(panels), tuple(charts), page=page if page.is_file() else None)
