"""The breakdown table of docs/wavefront.md, from sweeps of the suites stress-wavefront-*: python docs/wavefront.py FOLDER.

FOLDER holds one folder per sweep (`beambench sweep stress-wavefront-flux -o FOLDER/flux`). The table is written into the page,
between the comments `table:breakdown` and `end:breakdown`.
"""

from __future__ import annotations

import sys
from pathlib import Path

import pandas as pd
from marked import write_tables


def breakdown(sweeps: list[Path]) -> str:
    """The level at which 10 % of each estimator's elements fail, its interval, and how they fail, as Markdown; one row per axis."""
    rows = pd.concat([pd.read_csv(folder / "breakdown.csv") for folder in sweeps], ignore_index=True)
    names = list(dict.fromkeys(rows.estimator))
    lines = ["| axis | " + " | ".join(f"`{name}`" for name in names) + " |", "|---" * (len(names) + 1) + "|"]
    for (suite, axis), own in rows.groupby(["suite", "axis"], sort=False):
        cells = [_cell(own[own.estimator == name]) for name in names]
        unit = "" if own.unit.isna().all() or own.unit.iloc[0] == "1" else f" [{own.unit.iloc[0]}]"
        lines.append(f"| `{suite.removeprefix('stress-wavefront-')}`: {axis}{unit} | " + " | ".join(cells) + " |")
    return "\n".join(lines)


def _cell(row: pd.DataFrame) -> str:
    if row.empty:
        return "not run"
    one = row.iloc[0]
    if pd.isna(one.level10):
        return "never" if one["mode"] == "none" else f"? ({one['mode']})"
    low, high = ("…" if pd.isna(value) else f"{value:.3g}" for value in (one.lo, one.hi))
    return f"{one.level10:.3g} [{low}, {high}] {one['mode']}"


def main(folder: Path) -> None:
    """Write the table of docs/wavefront.md from every sweep in the folder that is complete."""
    sweeps = sorted(path.parent for path in folder.glob("*/breakdown.csv"))
    if not sweeps:
        raise SystemExit(
            f"{folder} holds no sweep with a breakdown.csv; run: beambench sweep stress-wavefront-flux -o {folder}/flux"
        )
    write_tables(Path(__file__).parent / "wavefront.md", {"breakdown": breakdown(sweeps)})


if __name__ == "__main__":
    main(Path(sys.argv[1]))
