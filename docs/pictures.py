"""Make the README's pictures from a run of the quickstart, and print its table: python docs/pictures.py RUN_FOLDER."""

from __future__ import annotations

import shutil
import sys
from pathlib import Path

import numpy as np
import pandas as pd

from beambench.benchmarks.report.pictures import DIVERGING, SEQUENTIAL, png, read_pictures, value_limits
from beambench.captures import open_captures

GREY = ("#000000", "#ffffff")


def main(run: Path) -> None:
    """Write docs/pictures/*.png."""
    folder = Path(__file__).parent / "pictures"
    shutil.copy(run / "speed-accuracy.png", folder / "speed-accuracy.png")
    store = next((run / "captures").glob("relief-tank*"))
    counts = open_captures(store)[0]["counts"].values
    brightest = counts[int(counts.reshape(len(counts), -1).sum(axis=1).argmax())].astype(float)
    (folder / "slice.png").write_bytes(png(brightest, 100.0, float(np.percentile(brightest, 99.8)), GREY))
    chosen = {p.estimator: p for p in read_pictures(run / "pictures") if p.scene == "relief-tank"}
    best, plain = chosen["poisson-ml"], chosen["weighted-average"]
    low, high = value_limits(best.truth, 0.01)
    (folder / "truth.png").write_bytes(png(best.truth, low, high, SEQUENTIAL))
    for name, picture in (("poisson-ml", best), ("weighted-average", plain)):
        (folder / f"{name}-error.png").write_bytes(png(picture.error, -0.01, 0.01, DIVERGING))


def table(run: Path) -> str:
    """The matched condition as a Markdown table: RMSE over all pixels in mm, beside it the coverage; CPU as a ratio.

    The efficiency is the harmonic mean over all scenes: 1/efficiency is a mean square; a scene without one leaves it out.
    """
    scores = pd.read_csv(run / "scores.csv", dtype={"level": str})
    scores = scores[(scores.condition == "matched") & (scores.quantity == "range") & scores.bound.notna()]
    scores["name"] = [
        e if not isinstance(p, str) or p in ("", "{}") else f"{e} ({p})"
        for e, p in zip(scores.estimator, scores.params, strict=True)
    ]
    scenes = sorted(scores.scene.unique())
    fastest = scores.groupby("name").cpu_s.mean().min()
    lines = ["| estimator | " + " | ".join(f"{s}, mm" for s in scenes) + " | efficiency | CPU ratio |"]
    lines.append("|---" * (len(scenes) + 3) + "|")
    bound = scores.groupby("scene").bound.first()
    lines.append("| *bound* | " + " | ".join(f"*{bound[s] * 1e3:.2f}*" for s in scenes) + " | *1* | |")
    for name, rows in sorted(scores.groupby("name"), key=lambda item: item[1].rmse_full.mean()):
        by = rows.set_index("scene")
        cells = [f"{by.rmse_full[s] * 1e3:.3g} ({by.coverage[s]:.0%})" for s in scenes]
        efficiency = np.nan if by.efficiency.reindex(scenes).isna().any() else len(rows) / (1 / rows.efficiency).sum()
        shown = "–" if np.isnan(efficiency) else f"{efficiency:.2f}"
        lines.append(f"| `{name}` | " + " | ".join(cells) + f" | {shown} | {rows.cpu_s.mean() / fastest:.0f} |")
    return "\n".join(lines)


if __name__ == "__main__":
    main(Path(sys.argv[1]))
    print(table(Path(sys.argv[1])))
