"""Make the README's pictures from a run of the quickstart: python docs/pictures.py RUN_FOLDER."""

from __future__ import annotations

import shutil
import sys
from pathlib import Path

import numpy as np

from beambench.benchmarks.pictures import DIVERGING, SEQUENTIAL, png, range_limits, read_pictures
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
    low, high = range_limits(best.truth)
    (folder / "truth.png").write_bytes(png(best.truth, low, high, SEQUENTIAL))
    for name, picture in (("poisson-ml", best), ("weighted-average", plain)):
        (folder / f"{name}-error.png").write_bytes(png(picture.error, -0.01, 0.01, DIVERGING))


if __name__ == "__main__":
    main(Path(sys.argv[1]))
