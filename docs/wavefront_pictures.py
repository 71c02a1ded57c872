"""Pictures of docs/wavefront.md: python docs/wavefront_pictures.py [RUN_FOLDER of the suite wavefront]."""

from __future__ import annotations

import shutil
import sys
import warnings
from pathlib import Path

import numpy as np
import vl_convert as vlc
import xarray as xr

from beambench.benchmarks.report.pictures import lut
from beambench.benchmarks.reproduce.phase_surface import beside, phase_svg
from beambench.captures.hide import hide_truth
from beambench.estimators import run_estimator
from beambench.estimators.rig import read_rig
from beambench.generator.generate import generate
from beambench.scenes.load import load_scene

#: Lenslets of the part of the spot field that is shown, pixels of a pixel, and how much longer than life slopes are drawn.
LENSLETS, ZOOM, LONGER = 8, 7, 15.0


def surfaces(capture: xr.Dataset) -> str:
    """True and reconstructed phase and their difference, of the first frame, on one scale; the difference on a scale of its own."""
    found = run_estimator("spot-ml+slope-cell+zernike-map", hide_truth(capture))["phase"].values[0]
    true = capture["truth_phase"].values[0]
    inside = np.isfinite(found) & np.isfinite(true)
    true, found = (np.where(inside, phase - phase[inside].mean(), np.nan)[2::4, 2::4] for phase in (true, found))
    error = found - true
    top, small = float(np.nanmax(np.abs(true))), float(np.nanmax(np.abs(error)))
    rms = float(np.sqrt(np.nanmean(error**2)))
    return beside(
        [
            phase_svg(true, top, f"true, ±{top:.1f} rad"),
            phase_svg(found, top, "reconstructed, the same scale"),
            phase_svg(error, small, f"error, ±{small:.2f} rad; {rms:.2f} rad rms"),
        ],
        3,
    )


def spot_field(capture: xr.Dataset) -> str:
    """Part of the first frame by the root of its light, and the slopes that were read, 15 times longer."""
    rig = read_rig(capture, "wavefront")
    slope = run_estimator("spot-ml+slope-cell", hide_truth(capture))
    col, row = (rig.numbers(f"lenslets.{name}") for name in ("col_px", "row_px"))
    pitch = rig.number("lenslets.pitch_m") / rig.number("camera.pixel_pitch_m")
    per_px = rig.number("camera.pixel_pitch_m") / rig.number("lenslets.focal_length_m")
    counts = capture["counts"].values[0].astype(float)
    side = round(LENSLETS * pitch)
    first = [(size - side) // 2 for size in counts.shape]
    part = counts[first[0] : first[0] + side, first[1] : first[1] + side]
    light = np.sqrt(np.maximum(part - np.median(part), 0.0))
    shade = lut(("#000000", "#ffffff"), 256)[np.clip(light / np.percentile(light, 99.5) * 255, 0, 255).astype(int)]
    parts = [f'<svg xmlns="http://www.w3.org/2000/svg" width="{side * ZOOM}" height="{side * ZOOM}">']
    parts += [
        f'<rect x="{j * ZOOM}" y="{i * ZOOM}" width="{ZOOM}" height="{ZOOM}" fill="#{r:02x}{g:02x}{b:02x}"/>'
        for i, line in enumerate(shade)
        for j, (r, g, b) in enumerate(line)
    ]
    found, valid = slope["slope"].values[0] / per_px, slope["valid"].values[0]
    valid = valid.all(axis=-1) if valid.ndim == 2 else valid
    for x, y, moved, good in zip(col - first[1] + 0.5, row - first[0] + 0.5, found, valid, strict=True):
        if good and 0 <= x < side and 0 <= y < side:
            end = (x + LONGER * moved[0], y + LONGER * moved[1])
            parts.append(
                f'<line x1="{x * ZOOM:.1f}" y1="{y * ZOOM:.1f}" x2="{end[0] * ZOOM:.1f}" y2="{end[1] * ZOOM:.1f}" '
                'stroke="#ff7f0e" stroke-width="2"/>'
                f'<circle cx="{x * ZOOM:.1f}" cy="{y * ZOOM:.1f}" r="2.5" fill="none" stroke="#56b4e9" stroke-width="1.5"/>'
            )
    return "".join([*parts, "</svg>"])


def main(run: Path | None) -> None:
    """Write docs/pictures/wavefront-*.png."""
    folder = Path(__file__).parent / "pictures"
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # that scintillation is left out stands on the page
        capture = generate(
            load_scene("gated-turbulence", {"rig.propagation": "phase-screens"}), seed=1, fidelity="coherent"
        )
    (folder / "wavefront-surfaces.png").write_bytes(vlc.svg_to_png(surfaces(capture), scale=0.9))
    (folder / "wavefront-spots.png").write_bytes(vlc.svg_to_png(spot_field(capture), scale=1.0))
    if run is not None:
        shutil.copy(run / "speed-accuracy.png", folder / "wavefront-speed-accuracy.png")


if __name__ == "__main__":
    main(Path(sys.argv[1]) if len(sys.argv) > 1 else None)
