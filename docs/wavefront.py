"""The tables of docs/wavefront.md: python docs/wavefront.py FOLDER, of sweeps or of `beambench run wavefront`.

A folder of sweeps holds one folder per sweep (`beambench sweep stress-wavefront-flux -o FOLDER/flux`) and gives the table of
breakdown; a run gives those of centroids and chains. With `--add`, python docs/wavefront.py --add FOLDER, only the rows of the
sweeps that the folder holds are written, and the others of the table stay as they are. Tables are written between the comments
`table:NAME` and `end:NAME`.
"""

from __future__ import annotations

import sys
from pathlib import Path

import pandas as pd
from marked import write_tables

#: Levels of light of the suite `wavefront` that are shown, and their photoelectrons of a spot.
ELECTRONS = {1.0: "3,100", 0.1: "310", 0.03: "94"}
#: Frames of a capture, which CPU times are of.
FRAMES = 4


def breakdown(sweeps: list[Path]) -> str:
    """The level at which 10 % of each estimator's elements fail, its interval, and how they fail, as Markdown; one row per axis."""
    rows = pd.concat([pd.read_csv(folder / "breakdown.csv") for folder in sweeps], ignore_index=True)
    names = list(dict.fromkeys(rows.estimator))
    lines = ["| axis | " + " | ".join(f"`{name}`" for name in names) + " |", "|---" * (len(names) + 1) + "|"]
    for (suite, axis), own in rows.groupby(["suite", "axis"], sort=False):
        cells = [_cell(own[own.estimator == name]) for name in names]
        unit = "" if own.unit.isna().all() or str(own.unit.iloc[0]) == "1" else f" [{own.unit.iloc[0]}]"
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


def centroids(summary: pd.DataFrame, electrons: dict[float, str]) -> str:
    """rms errors [px] of the centroids at the levels `electrons` (level: heading), z and CPU time of a frame at the first one."""
    own = summary[(summary.quantity == "spot") & (summary.condition == "matched")]
    first = next(iter(electrons))
    best = own[own.level == first].sort_values("rmse")
    lines = ["| centroid | " + " | ".join(f"{name} e⁻" for name in electrons.values()) + " | z | CPU, ms |"]
    lines.append("|---" * (len(electrons) + 3) + "|")
    for name in best.estimator:
        at = own[own.estimator == name].set_index("level")
        errors = " | ".join(f"{at.rmse[level]:.3g}" for level in electrons)
        lines.append(f"| `{name}` | {errors} | {at.z_rms[first]:.2f} | {1e3 * at.cpu_s[first] / FRAMES:.2g} |")
    bounds = own.groupby("level").bound.min()
    return "\n".join([*lines, "| bound | " + " | ".join(f"{bounds[level]:.3g}" for level in electrons) + " | | |"])


def chains(summary: pd.DataFrame) -> str:
    """rms errors [rad] of coefficients and phase of the chains at full light, and z."""
    own = summary[(summary.condition == "matched") & (summary.level == 1.0)]
    coefficient, phase = (own[own.quantity == name].set_index("estimator") for name in ("zernike", "phase"))
    lines = ["| chain | coefficients | z | phase | z |", "|---|---|---|---|---|"]
    for name in coefficient.sort_values("rmse").index:
        one, other = coefficient.loc[name], phase.loc[name]
        lines.append(f"| `{name}` | {one.rmse:.2g} | {one.z_rms:.2f} | {other.rmse:.3g} | {other.z_rms:.2f} |")
    bound = f'| noise of 65 modes alone ("quasi" bound) | {coefficient.bound.min():.2g} | | {phase.bound.min():.2g} | |'
    return "\n".join([*lines, bound])


def added(table: str, page: Path) -> str:
    """The table of breakdown of a page, with the rows of `table` in place of those of the same suites, or in their order."""
    old = (
        page.read_text(encoding="utf-8")
        .partition("<!-- table:breakdown -->\n")[2]
        .partition("<!-- end:breakdown -->")[0]
    )
    head, line, *rows = table.splitlines()
    old_head, _, *others = old.splitlines()
    if head != old_head:
        raise SystemExit(f"the sweeps have other estimators than the table: {head}, not {old_head}")
    kept = {row.partition(":")[0]: row for row in others} | {row.partition(":")[0]: row for row in rows}
    return "\n".join([head, line, *(kept[name] for name in sorted(kept))])


def main(folder: Path, *, add: bool = False) -> None:
    """Write the tables of docs/wavefront.md from a run, or from every sweep in the folder that is complete."""
    page = Path(__file__).parent / "wavefront.md"
    if (folder / "summary.csv").is_file():
        summary = pd.read_csv(folder / "summary.csv")
        write_tables(page, {"centroids": centroids(summary, ELECTRONS), "chains": chains(summary)})
        return
    sweeps = sorted(path.parent for path in folder.glob("*/breakdown.csv"))
    if not sweeps:
        raise SystemExit(
            f"{folder} holds no sweep with a breakdown.csv; run: beambench sweep stress-wavefront-flux -o {folder}/flux"
        )
    table = breakdown(sweeps)
    write_tables(page, {"breakdown": added(table, page) if add else table})


if __name__ == "__main__":
    main(Path(sys.argv[-1]), add="--add" in sys.argv[1:-1])
