"""Pictures and tables of docs/laser-line.md, from a run of the suite laser-line: python docs/laser_line.py RUN_FOLDER.

The tables are written into the page, between the comments `table:NAME` and `end:NAME`.
"""

from __future__ import annotations

import shutil
import sys
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
import pandas as pd
from marked import write_tables

from beambench.benchmarks.report.page import write_report
from beambench.benchmarks.report.pictures import png
from beambench.generator.generate import generate
from beambench.scenes.load import load_scene

GREY = ("#000000", "#ffffff")


def pictures(folder: Path) -> None:
    """Frames of the scenes: the line alone, and in water that scatters, each by the root of its light."""
    coastal = {"name": "coastal", "index": {"kind": "water", "temperature_c": 15.0, "salinity_psu": 33.0},
               "water_type": {"source": "petzold1972", "type": "coastal", "wavelength_m": 532e-9}}  # fmt: skip
    scenes = {
        "laser-line": load_scene("spotscan-wall"),
        "laser-line-coastal": load_scene("spotscan-wall", {"medium": coastal}),
    }
    for name, scene in scenes.items():
        capture = generate(scene, seed=1, fidelity="scatter", truth_electrons=True)
        shown = np.sqrt(np.maximum(capture["truth_electrons"].values[0].astype(float) - 5.0, 0.0))
        (folder / f"{name}.png").write_bytes(png(shown, 0.0, float(np.sqrt(400.0)), GREY))


def waters(run: Path) -> str:
    """Errors and failures in air and in every water at full light, matched and calibrated, as Markdown."""
    scores = pd.read_csv(run / "scores.csv")
    scores = scores[scores.level.isna()]
    scenes = list(dict.fromkeys(scores.scene))
    lines = ["| estimator | condition | unit | " + " | ".join(scenes) + " |", "|---" * (len(scenes) + 3) + "|"]
    for (stage, name, condition), rows in scores.groupby(["stage", "estimator", "condition"], sort=False):
        factor, unit = (1.0, "px") if stage == "line" else (1e3, "mm")
        cells = []
        for scene in scenes:
            own = rows[rows.scene == scene]
            cells.append(f"{factor * np.sqrt((own.rmse**2).mean()):.3g} ({own.failure_rate.mean():.0%})")
        lines.append(f"| `{name}` | {condition} | {unit} | " + " | ".join(cells) + " |")
    return "\n".join(lines)


def table(run: Path) -> str:
    """Errors at full light and at a tenth of it in fresh water, matched, as Markdown."""
    scores = pd.read_csv(run / "scores.csv")
    scores = scores[(scores.scene == "fresh") & (scores.condition == "matched")]
    lines = [
        "| estimator | unit | rmse | bound | z | CPU µs per row | rmse at a tenth of the light | refused or failed there |"
    ]
    lines.append("|---" * 8 + "|")
    for (stage, name), rows in scores.groupby(["stage", "estimator"], sort=False):
        factor, unit = (1.0, "px") if stage == "line" else (1e3, "mm")
        full, weak = rows[rows.level.isna()], rows[rows.level == 0.1]

        def rms(values: pd.Series, factor: float = factor) -> str:
            return f"{factor * np.sqrt((values**2).mean()):.3g}"

        # Two frames of 256 rows.
        cells = [unit, rms(full.rmse), rms(full.bound), f"{full.z_rms.mean():.2f}", f"{full.cpu_s.mean() / 512 * 1e6:.1f}",
                 rms(weak.rmse), f"{weak.failure_rate.mean():.1%}"]  # fmt: skip
        lines.append(f"| `{name}` | " + " | ".join(cells) + " |")
    return "\n".join(lines)


def chart(run: Path, out: Path) -> None:
    """Error against CPU time in fresh and coastal water, the rig matched: the report's own chart of these rows."""
    scores = pd.read_csv(run / "scores.csv")
    with TemporaryDirectory() as name:
        kept = scores[scores.scene.isin(["fresh", "coastal"]) & (scores.condition == "matched")]
        kept.to_csv(Path(name) / "scores.csv", index=False)
        write_report(name)
        shutil.copy(Path(name) / "speed-accuracy.png", out)


def main(run: Path) -> None:
    """Write docs/pictures/laser-line*.png and the tables of docs/laser-line.md."""
    folder = Path(__file__).parent
    pictures(folder / "pictures")
    chart(run, folder / "pictures" / "laser-line-speed-accuracy.png")
    wide = (
        "The same rig in air and in all waters: rms error (share of rows that fail), matched and calibrated.\n\n"
        f"{waters(run)}\n\n![error against CPU time in fresh and in coastal water, matched](pictures/laser-line-speed-accuracy.png)"
    )
    write_tables(folder / "laser-line.md", {"finders": table(run), "waters": wide})


if __name__ == "__main__":
    main(Path(sys.argv[1]))
