"""All rows in the order of the document, and the files that `beambench reproduce` writes."""

from __future__ import annotations

import csv
import io
import math
import time
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from ..folders.files import write_atomic, write_json, write_text
from .rows import COLUMNS, DOCUMENTS, Row

__all__ = ["ITEMS", "OTHERS", "WITHOUT_ROWS", "Reproduction", "all_rows", "reproduce", "to_csv"]

#: Items of Guo et al. 2017 that can be computed, in their order. Figures 1, 5, 10 and 12 are diagrams.
ITEMS = (
    *(f"Eq. {n}" for n in range(1, 7)), "Figure 2", "Figure 3", "Figure 4",
    *(f"Eq. {n}" for n in range(7, 14)), "Figure 6", "Figure 7",
    *(f"Eq. {n}" for n in range(14, 26)), "Figure 8", "Figure 9", "Table 1",
    "Eq. 26", "Figure 11", *(f"Eq. {n}" for n in range(27, 35)), *(f"Figure {n}" for n in range(13, 17)),
    "Flow runs", "Phase in radians", "Peak-to-valley",
)  # fmt: skip

#: Items without a row, and why: a row must be able to fail. All are implemented and tested (docs/coverage.csv).
WITHOUT_ROWS = {
    "Eq. 2": "a definition; used in the row of Eq. 1",
    "Eq. 3": "follows from Eq. 1 and 2; see the row of Eq. 1",
    "Eq. 4": "a definition, whose constants K_S, K_D, s and m have no printed values; see Figure 2",
    "Eq. 6": "compared with Eq. 5 in the row of Eq. 5",
    "Eq. 7": "the theorem of Pythagoras",
    "Eq. 8": "an approximation without a stated limit: its relative error is half the square of the angle",
    "Eq. 9": "a definition",
    "Eq. 10": "a definition; Eq. 24 divides where it multiplies",
    "Eq. 11": "a definition",
    "Eq. 13": "the formula is missing in the available text; it is read from Eq. 24, and its exponent k is not given",
    "Eq. 14": "a definition",
    "Eq. 15": "follows from Eq. 14 for photon noise; used in the rows of Eq. 17 and 22",
    "Eq. 18": "a definition",
    "Eq. 20": "Eq. 19 with Eq. 6 put in",
    "Eq. 21": "Eq. 20 with its integrals done",
    "Figure 8": "shapes and reflectivities of the objects below are ours, so nothing can be compared",
    "Figure 9": "shapes, reflectivities and rig of the objects below are ours, so nothing can be compared",
    "Figure 11": "a diagram of Eq. 27",
    "Eq. 29": "Eq. 28 along y",
    "Eq. 31": "a definition; used in the rows of Eq. 32",
}

#: Items of other sources, and of Kusters 1992, which follow.
OTHERS = (
    "Wang 2013, AO 52:7399", "Accuracy of 5 mm at 1 m", "Figure 3.6", "Figure 3.7",
    "Eq. 4.6", "Eq. 4.7", "Figure 4.14", "Figure 4.15", "Table 4.1", "Table 4.2",
    *(f"Figure 5.{n}" for n in range(7, 17)), "Profile selection and resampling", "Detrend, taper and spectrum",
)  # fmt: skip

Progress = Callable[[str], None]


@dataclass(frozen=True)
class Reproduction:
    """Result of a reproduction: folder, rows, page, and duration."""

    out: Path
    rows: list[Row]
    page: Path
    wall_s: float


def all_rows(say: Progress | None = None, only: str | None = None) -> list[Row]:
    """Every row, ordered by item as in the document, those of other sources last. Deterministic: all seeds are fixed.

    `only`: the document whose rows are computed, "000" or "001"; all by default.
    """
    from .accuracy import accuracy_rows
    from .deviation import deviation_rows
    from .illumination import illumination_rows
    from .ladar import ladar_rows
    from .model import model_rows
    from .pixel_patch import pixel_patch_rows
    from .ranger import ranger_rows
    from .reflection import reflection_rows
    from .roughness import roughness_rows
    from .surfaces import figure_2_rows
    from .table_1 import table_1_rows
    from .tank import tank_rows
    from .triangular import triangular_rows
    from .turbulence import turbulence_rows

    kusters: tuple[tuple[str, Callable[[], list[Row]]], ...] = (
        ("Kusters 1992, chapter 3: predicted range errors", pixel_patch_rows),
        ("Kusters 1992, chapter 4: range errors in the tank", tank_rows),
        ("Kusters 1992, chapter 5: roughness of the seafloor", roughness_rows),
    )
    parts: tuple[tuple[str, Callable[[], list[Row]]], ...] = (
        ("Eq. 1-6, 19 and 22: received power", ladar_rows), ("Figure 2: reflection model", figure_2_rows),
        ("Figures 3 and 4: photodetector, reflectivity and incidence", reflection_rows),
        ("Figure 7: photodetector, deviation", deviation_rows),
        ("Figures 3, 4 and 7 on generated waveforms", ranger_rows),
        ("Eq. 12, Figure 6: illumination", illumination_rows),
        ("Eq. 16, 17, 25: accuracy", accuracy_rows), ("Table 1: its readings over plausible rigs", table_1_rows),
        ("Eq. 23 and 24: generated stacks", model_rows),
        ("Eq. 26-34, Figures 13 to 16: the gated sensor of wave slopes", turbulence_rows),
        ("AO 52:7399: triangular against trapezoidal profiles", triangular_rows),
    )  # fmt: skip
    parts = {None: (*parts, *kusters), "000": parts, "001": kusters}[only]
    rows: list[Row] = []
    for name, make in parts:
        if say is not None:
            say(name)
        rows += make()
    return sorted(rows, key=lambda row: (*ITEMS, *OTHERS).index(row.item))


def _field(value: Any) -> str:
    if isinstance(value, float):
        return "" if math.isnan(value) else f"{value + 0.0:.6g}"
    return str(value)


def to_csv(rows: Iterable[Row]) -> str:
    """Text of reproduction.csv: numbers with six significant digits, NaN as an empty field, lines ended by a line feed."""
    buffer = io.StringIO()
    writer = csv.writer(buffer, lineterminator="\n")
    writer.writerow(COLUMNS)
    writer.writerows([_field(getattr(row, name)) for name in COLUMNS] for row in rows)
    return buffer.getvalue()


def _write_parquet(path: Path, rows: list[Row]) -> None:
    import pyarrow as pa
    import pyarrow.parquet as pq

    numbers = ("published", "reproduced", "tolerance")
    arrays = [pa.array([getattr(row, name) for row in rows], type=pa.float64() if name in numbers else pa.string())
              for name in COLUMNS]  # fmt: skip
    pq.write_table(pa.Table.from_arrays(arrays, names=list(COLUMNS)), path)


def reproduce(
    out: Path, *, only: str | None = None, pictures: bool = True, say: Progress | None = None
) -> Reproduction:
    """Compute all rows and write reproduction.csv, .parquet and .html, run.json, and pictures/ into the folder `out`.

    Other arguments:
        only: the document whose rows are computed, "000" or "001".
        pictures: add charts and pictures of the objects of "000"; without them the page has only tables.
        say: called with the name of each part.
    Raises:
        InputError: the folder cannot be written.
    """
    from ..folders.record import machine, versions
    from .page import render_page

    start = time.perf_counter()
    rows = all_rows(say, only)
    pictures = pictures and only != "001"
    charts: dict[str, bytes] = {}
    objects: dict[str, tuple[str, bytes]] = {}
    if pictures:
        import vl_convert as vlc

        from .charts import chart_svgs
        from .surface_picture import object_pictures
        from .turbulence_frames import turbulence_pictures

        if say is not None:
            say("charts and pictures")
        charts = {item: vlc.svg_to_png(svg, scale=1.5) for item, svg in chart_svgs().items()}
        objects = object_pictures() | turbulence_pictures()
    out.mkdir(parents=True, exist_ok=True)
    write_text(out / "reproduction.csv", to_csv(rows))
    write_atomic(out / "reproduction.parquet", lambda path: _write_parquet(path, rows))
    if pictures:
        (out / "pictures").mkdir(exist_ok=True)
        named = {item.lower().replace(" ", "-"): image for item, image in charts.items()}
        for name, image in (named | {name: image for name, (_, image) in objects.items()}).items():
            _write_bytes(out / "pictures" / f"{name}.png", image)
    page = out / "reproduction.html"
    there = {row.item for row in rows}
    names = [name for name in (*ITEMS, *OTHERS) if name in there or (only != "001" and name in WITHOUT_ROWS)]
    write_text(page, render_page(rows, charts, objects, names, WITHOUT_ROWS))
    wall = time.perf_counter() - start
    document = only or ", ".join(DOCUMENTS)
    write_json(out / "run.json", {"verb": "reproduce", "document": document, "wall_s": round(wall, 3), "rows": len(rows),
                                  "machine": machine(), "versions": versions()})  # fmt: skip
    return Reproduction(out, rows, page, wall)


def _write_bytes(path: Path, data: bytes) -> None:
    def write(partial: Path) -> None:
        partial.write_bytes(data)

    write_atomic(path, write)
