"""Errors of line finders over the width of the line and the signal to noise of its peak, in units of the bound.

    python -m beambench.benchmarks.checks.line_accuracy

SNR is that of the brightest pixel of a line in the middle of a pixel: p/√(p + B + σ²), p its photoelectrons. Rows that are refused,
or err by more than 2 px (five bounds, where that is more), are outliers, as in scores; the other rows give the error over the
bound, its bias, and the rms of error over stated error.
"""

from __future__ import annotations

import numpy as np

from ...captures.hide import hide_truth
from ...estimators import run_estimator
from ...optics.sheet import gaussian_mean
from ...scenes.load import load_scene
from ...scenes.scene import Scene
from ..judges.bound import bounds_of
from ..written.laser_line import written_capture

__all__ = ["SNRS", "WIDTHS_PX", "line_errors"]

WIDTHS_PX = (0.3, 0.5, 0.75, 1.2, 2.0)
SNRS = (3.0, 5.0, 10.0, 20.0, 50.0)
_FINDERS = ("line-ml", "line-erf", "line-log-gaussian", "line-blais-rioux", "line-centroid", "line-steger")
_BACKGROUND, _READ_NOISE, _COLS = 20.0, 10.0, 64


def _scene(width_px: float, electrons: float) -> Scene:
    """Two frames of 256 rows; a converter of 12 bits whose top is above twice the peak."""
    gain = min(0.5, 1500.0 / (electrons * float(gaussian_mean(-0.5, 0.5, width_px)) + 400.0))
    return load_scene(
        "spotscan-wall",
        {
            "rig.camera.cols": _COLS, "rig.lens_sigma_px": float(np.sqrt(max(width_px**2 - 0.14**2, 1e-6))),
            "rig.detector.adc_bits": 12, "rig.detector.gain_dn_per_e": gain, "rig.detector.offset_dn": 100.0,
            "rig.detector.read_noise_e": _READ_NOISE, "rig.detector.full_well_e": 1e7,
        },
    )  # fmt: skip


def line_errors(label: str, width_px: float, snr: float, *, seeds: int = 4) -> dict[str, float]:
    """{outliers: share of rows; ratio: rms error over rms bound; bias: over rms error; z_rms} of 512 lines per seed.

    Main arguments:
        label: of a finder. width_px: 1 σ of the line. snr: of its brightest pixel.
    """
    floor = _BACKGROUND + _READ_NOISE**2
    peak = 0.5 * (snr**2 + np.sqrt(snr**4 + 4.0 * snr**2 * floor))
    electrons = float(peak / gaussian_mean(-0.5, 0.5, width_px))
    scene = _scene(width_px, electrons)
    column = _COLS / 2 + np.linspace(-0.5, 0.5, 512, endpoint=False).reshape(2, 256)
    errors, over, bounds, rows = [], [], [], 0
    for seed in range(seeds):
        capture = written_capture(scene, electrons, width_px, _BACKGROUND, column, seed=seed)
        found = run_estimator(label, hide_truth(capture))
        bound = bounds_of(capture)["column"].sigma[..., 0]
        error = (found["column"] - capture["truth_column"]).values[..., 0]
        with np.errstate(invalid="ignore"):
            near = np.abs(error) <= np.maximum(2.0, np.minimum(5.0 * bound, 4.0))
        rows += near.size
        errors.append(error[near])
        over.append(error[near] / found["sigma"].values[..., 0][near])
        bounds.append(bound[near])
    e, z, b = (np.concatenate(part) for part in (errors, over, bounds))
    if not e.size:
        return {"outliers": 1.0, "ratio": float("nan"), "bias": float("nan"), "z_rms": float("nan")}
    rms = float(np.sqrt((e**2).mean()))
    return {
        "outliers": 1.0 - e.size / rows, "ratio": rms / float(np.sqrt((b**2).mean())), "bias": float(e.mean()) / rms,
        "z_rms": float(np.sqrt((z**2).mean())),
    }  # fmt: skip


def main() -> None:
    """Print a table per finder: outliers, error over bound, rms of error over stated error."""
    for label in _FINDERS:
        print(f"{label}: outliers %, error/bound, z rms")
        print("   s [px]  " + "".join(f"{f'SNR {snr:g}':>22s}" for snr in SNRS))
        for width in WIDTHS_PX:
            cells = []
            for snr in SNRS:
                got = line_errors(label, width, snr)
                cells.append(f"{got['outliers']:9.1%} {got['ratio']:6.2f} {got['z_rms']:5.2f}")
            print(f"   {width:<8g}" + "".join(cells))


if __name__ == "__main__":
    main()
