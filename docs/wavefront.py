"""Pictures of docs/wavefront.md: spot fields, and the true and the estimated wavefront on one scale: python docs/wavefront.py."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from beambench.benchmarks.report.pictures import png
from beambench.captures.hide import hide_truth
from beambench.estimators import run_estimator
from beambench.generator.generate import generate
from beambench.scenes.load import load_scene

GREY = ("#000000", "#ffffff")
SIGNED = ("#2166ac", "#f7f7f7", "#b2182b")
CHAIN = "spot-joint+slope-cell+zernike-map"
#: Turbulence that moves spots by a good part of a pixel, and light enough to see their side lobes.
CHANGE = {
    "rig.frames.count": 1, "rig.laser.pulse_energy_j": 1e-9,
    "rig.turbulence": {"kind": "layers", "layers": [{"range_m": 3.0, "r0_m": 1e-3}]},
}  # fmt: skip


def pictures(folder: Path) -> str:
    """Spot fields of the reference and of a frame, by the root of their light, and wavefronts with their difference, rad; returns the
    figures of the caption."""
    scene = load_scene("gated-turbulence", CHANGE)
    still = load_scene("gated-turbulence", CHANGE | {"rig.turbulence": {"kind": "none"}})
    capture = generate(scene, seed=1, fidelity="coherent", rtol=0.02, truth_electrons=True)
    flat = generate(still, seed=1, fidelity="coherent", rtol=0.02, truth_electrons=True)
    top = float(np.sqrt(flat["truth_electrons"].max()))
    for name, shown in (("reference", flat), ("turbulence", capture)):
        light = np.sqrt(np.maximum(shown["truth_electrons"].values[0].astype(float), 0.0))
        (folder / f"wavefront-spots-{name}.png").write_bytes(png(np.kron(light, np.ones((2, 2))), 0.0, top, GREY))
    truth = capture["truth_phase"].values[0]
    found = run_estimator(CHAIN, hide_truth(capture))["phase"].values[0]
    found = np.where(np.isfinite(truth), found, np.nan)
    limit = float(np.nanmax(np.abs(truth)))
    for name, shown in (("true", truth), ("estimated", found), ("error", found - truth)):
        picture = png(np.kron(shown, np.ones((2, 2))), -limit, limit, SIGNED)
        (folder / f"wavefront-phase-{name}.png").write_bytes(picture)
    rms = [float(np.sqrt(np.nanmean(values**2))) for values in (truth, found - truth)]
    return f"scale ±{limit:.1f} rad; rms of the wavefront {rms[0]:.2f} rad, of the estimate's error {rms[1]:.2f} rad"


if __name__ == "__main__":
    print(pictures(Path(__file__).parent / "pictures"))
