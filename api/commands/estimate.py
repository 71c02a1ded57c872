"""The commands `estimate`, `score` and `export`."""

from __future__ import annotations

from pathlib import Path
from shlex import quote
from typing import TYPE_CHECKING, Any

from ..console import print_lines, print_table, score_records, size_text
from .build import Arguments, View, command

if TYPE_CHECKING:
    import pandas as pd

    from ..benchmarks.report.cell import Cell

__all__ = ["ESTIMATE", "EXPORT", "SCORE"]


def _estimate_json(folder: Path, given: Arguments) -> dict[str, Any]:
    from ..benchmarks.datasets.estimate import asked_of

    return {
        "out": str(folder),
        "files": sorted(str(path) for path in folder.glob("*.h5")),
        "estimators": asked_of(folder),
    }


def _estimate_text(folder: Path, given: Arguments) -> None:
    from ..benchmarks.datasets.estimate import asked_of

    for label, told in asked_of(folder).items():
        if told["reason"]:
            missed = told["captures"] - told["answered"]
            print_lines(f"failed    {label}, {missed} of {told['captures']} captures: {told['reason']}")
    print_lines(f"estimates {folder}", f"next      beambench score {quote(str(given['data']))} {quote(str(folder))}")


def _estimate_code(folder: Path) -> int:
    """1 where no estimator answered any capture."""
    from ..benchmarks.datasets.estimate import asked_of

    return int(not any(told["answered"] for told in asked_of(folder).values()))


ESTIMATE = command(
    "estimate",
    "estimate:estimate",
    View(_estimate_text, _estimate_json, _estimate_code),
    options=("estimators",),
    examples="""Examples:
  beambench estimate step.zarr -e poisson-ml -o estimates
  beambench estimate step.zarr -e peak -e 'weighted-average[background=subtract]'
  beambench estimate step.zarr -e poisson-ml -e peak -o estimates --resume

Exit code 1 where every estimator failed on every capture; the reasons are shown.""",
)


def _score_json(table: pd.DataFrame, given: Arguments) -> dict[str, Any]:
    return {"out": table.attrs["folder"], "rows": score_records(table.to_dict(orient="records"))}


def _score_text(table: pd.DataFrame, given: Arguments) -> None:
    from ..benchmarks.report.cell import common_noun
    from ..benchmarks.report.data import by_quantity, cells_of, unit_scale
    from ..benchmarks.report.text import closing_lines

    cells, folder = cells_of(table), table.attrs["folder"]
    groups = by_quantity(cells)
    for name, group in groups.items():
        factor, unit = unit_scale(group[0])
        of = f"{name}: " if len(groups) > 1 else ""
        numbers = (
            f"{of}RMSE, {unit}", "coverage", f"bias, {unit}", f"bound, {unit}", "failed", f"CPU per {common_noun(group)}",
        )  # fmt: skip
        print_table(
            ("estimator", "where", *numbers, "status"), [_scored(cell, factor) for cell in group], right=numbers
        )
        print_lines("")
    print_lines(
        *closing_lines(table), f"tables   {folder}/scores.csv", f"next     beambench report {quote(str(folder))}"
    )


def _scored(cell: Cell, factor: float) -> tuple[str, ...]:
    from ..benchmarks.report.numbers import number, rate, time_text

    return (
        cell.label,
        cell.place,
        number(cell.rmse_full * factor),
        rate(cell.coverage),
        number(cell.bias * factor),
        number(cell.bound * factor),
        rate(cell.failure_rate),
        time_text(cell.cpu_per_element_s),
        cell.status,
    )


SCORE = command(
    "score",
    "score:score",
    View(_score_text, _score_json),
    examples="Example:\n  beambench score step.zarr estimates -o scores",
)


#: How a format is read, in one line.
_READ = {
    "hdf5": "next     beambench score {data} ESTIMATES.h5",
    "netcdf": "read     xarray.open_dataset({file!r})",
    "exr": "read     OpenEXR.File({file!r}, separate_channels=True)",
    "tiff": "read     tifffile.imread({file!r})",
    "webdataset": "read     webdataset.WebDataset({file!r}).decode()",
    "croissant": "read     mlcroissant.Dataset({file!r}).records('samples')",
}


def _export_json(path: Path, given: Arguments) -> dict[str, Any]:
    from ..captures.exports.place import exported

    told = exported(path)
    return {"out": str(path)} | ({"captures": told["captures"], "files": len(told["files"])} if told else {})


def _export_text(path: Path, given: Arguments) -> None:
    from ..captures.exports.place import EXPORT, exported

    told = exported(path)
    ends = {"netcdf": ".nc", "exr": ".exr", "tiff": ".tif", "webdataset": ".tar", "croissant": "croissant.json"}
    files = [name for name in told.get("files", {}) if name.endswith(ends.get(given["to"], ""))]
    if told:
        size = size_text(sum(size for size, _ in told["files"].values()))
        print_lines(
            f"folder   {path}: {told['captures']} captures, {len(told['files'])} files, {size}; {EXPORT} lists them"
        )
    else:
        print_lines(f"file     {path}")
    print_lines(_READ[given["to"]].format(data=quote(str(given["data"])), file=str(path / files[0]) if files else ""))


EXPORT = command(
    "export",
    "export:export",
    View(_export_text, _export_json),
    examples="""Examples:
  beambench export gated-1k --to webdataset -o gated-1k-wds
  beambench export gated-1k --to netcdf --part test --variables counts --variables truth_range -o test-set
  beambench export gated-1k --to croissant -o gated-1k-croissant --resume
  beambench export captures.zarr --to exr --no-truth -o pictures
Estimates by any program:
  beambench export captures.zarr -o captures.h5
  my-program captures.h5 estimates.h5
  beambench score captures.zarr estimates.h5""",
)
