"""How near to its bound maximum likelihood of a spot comes, over light: captures in closed form, and of the rung `isolated`.

    python -m beambench.benchmarks.checks.spot_likelihood

In closed form spots have the declared shape and are moved by .08 px rms, as by d/r0 = .1; the light of neighbours is there.
In `isolated` Kolmogorov turbulence of d/r0 also changes the shape of spots, which no fit knows: beside what is measured
stands what `optics.lenslets.place_limit` predicts for a fit of the flat wave's spot, and the least error of any reading of
the image. Efficiencies are over the bound of a known shape. Guo's optics, 64 lenslets, no tube, 3 e of read noise, a
reference of 400 exposures.
"""

from __future__ import annotations

import sys
import warnings
from collections.abc import Sequence
from typing import Any

import numpy as np
import xarray as xr

from ...captures.hide import hide_truth
from ...estimators import run_estimator
from ...generator.generate import generate
from ...optics.lenslets.place_limit import PlaceLimit, place_limit
from ...scenes.load import load_scene
from ...scenes.rigs.wavefront import wavefront_rig
from ...scenes.rigs.wavefront_geometry import spot_px
from ...scenes.scene import Scene
from ..judges.bound import bounds_of, truths_of
from ..written.wavefront import written_capture

__all__ = ["FLUXES", "closed_form", "isolated", "limit_of", "main", "measured_of"]

FLUXES = (300.0, 1e3, 3e3, 1e4, 3e4, 1e5)
ESTIMATORS = ("spot-ml[neighbours=false]", "spot-ml", "spot-joint")
#: Size of the closed form's moves, and background of a pixel [photoelectrons].
_MOVED_PX, _BACKGROUND = 0.08, 1.0
_READ_NOISE_E = 3.0
#: Least efficiency in closed form, and how far z may be from 1.
LEAST, WITHIN = 0.95, 0.05


def _scene(frames: int, flux: float, **changes: Any) -> Scene:
    bare: dict[str, Any] = {
        "lenslets.across": 8, "pupil.shape": "square", "pupil.diameter_m": 1.2e-3, "pupil.modes": 10, "pupil.samples": 16,
        "camera.rows": 80, "camera.cols": 80, "detector.intensifier": None, "detector.read_noise_e": _READ_NOISE_E,
        "detector.gain_dn_per_e": 0.5 if flux > 3e4 else 1.0, "detector.adc_bits": 16, "detector.full_well_e": 1e6,
        "detector.dark_current_e_per_s": 0.0, "frames.reference_exposures": 400, "frames.count": frames,
        "propagation": "phase-screens",
    }  # fmt: skip
    return load_scene("gated-turbulence", {f"rig.{name}": value for name, value in (bare | changes).items()})


def closed_form(flux: float, frames: int, seed: int = 5) -> xr.Dataset:
    """Spots of the declared shape, moved by .08 px rms, of `flux` photoelectrons."""
    scene = _scene(frames, flux)
    rig = wavefront_rig(scene)
    per_px = rig.camera.pixel_pitch_m / rig.lenslets.focal_length_m
    moved = _MOVED_PX * per_px * np.random.default_rng(seed).standard_normal((frames, 64, 2))
    return written_capture(scene, flux, _BACKGROUND, moved, seed=seed)


def isolated(flux: float, d_over_r0: float, frames: int, seed: int = 5) -> xr.Dataset:
    """A capture of the rung `isolated` through turbulence of d/r0 at the array."""
    base = _scene(1, flux)
    rig = wavefront_rig(base)
    # A mirror's light passes twice, with 2² the strength.
    layer = {"range_m": 3.0, "r0_m": 4.0**0.6 * rig.lenslets.pitch_m / d_over_r0}
    water: dict[str, Any] = {"turbulence": {"kind": "layers", "layers": [layer]}}
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # scintillation is left out here
        full = float(generate(base, seed=1, fidelity="geometric")["truth_flux"].values.mean())
        energy = rig.laser.pulse_energy_j * flux / full
        scene = _scene(frames, flux, **water, **{"laser.pulse_energy_j": energy})
        return generate(scene, seed=seed, fidelity="isolated")


def limit_of(capture: xr.Dataset, scene: Scene, d_over_r0: float) -> PlaceLimit:
    """What `place_limit` predicts for the spots of a capture."""
    rig = wavefront_rig(scene)
    cell = 0.5 * rig.lenslets.pitch_m / rig.camera.pixel_pitch_m
    return place_limit(
        float(capture["truth_flux"].values.mean()), d_over_r0, width_px=spot_px(rig), half_px=cell,
        background=float(capture["truth_background"].values.mean()), read_noise_e=_READ_NOISE_E,
    )  # fmt: skip


def measured_of(capture: xr.Dataset, label: str) -> tuple[float, float, float]:
    """(rms error [px], efficiency over the bound of a known shape, error over the stated one, rms)."""
    found = run_estimator(label, hide_truth(capture))
    valid = found["valid"].values
    error = (found["spot"].values - truths_of(capture)["spot"].value)[valid]
    bound = bounds_of(capture)["spot"].sigma[valid]
    rms = float(np.sqrt((error**2).mean()))
    return (
        rms,
        float(1.0 / ((error / bound) ** 2).mean()),
        float(np.sqrt(((error / found["sigma"].values[valid]) ** 2).mean())),
    )


def main(arguments: Sequence[str]) -> int:
    """Print both tables; 1 where `spot-ml` is off its bound or its stated error in closed form."""
    frames = int(arguments[0]) if arguments else 48
    print(f"closed form, moved by .08 px: efficiency, z; {128 * frames} values, ± {np.sqrt(2 / (128 * frames)):.3f}")
    print("| photoelectrons | " + " | ".join(f"`{name}`" for name in ESTIMATORS) + " |")
    passed = True
    for flux in FLUXES:
        capture = closed_form(flux, frames)
        rows = [measured_of(capture, name)[1:] for name in ESTIMATORS]
        passed = passed and rows[1][0] >= LEAST and abs(rows[1][1] - 1.0) <= WITHIN
        print(f"| {flux:g} | " + " | ".join(f"{efficiency:.2f}, {z:.2f}" for efficiency, z in rows) + " |", flush=True)
    for ratio in (0.1, 0.05):
        print(f"isolated, d/r0 = {ratio:g}: px rms, efficiency over the bound of a known shape")
        print("| photoelectrons | `spot-ml` | predicted for it | bound of a known shape | least of any reading |")
        for flux in FLUXES:
            capture = isolated(flux, ratio, frames)
            limit = limit_of(capture, _scene(1, flux), ratio)
            rms, efficiency, _ = measured_of(capture, "spot-ml")
            cells = [f"{one:.4f}, {(limit.bound / one) ** 2:.2f}" for one in (limit.fitted, limit.bound, limit.least)]
            print(f"| {flux:g} | {rms:.4f}, {efficiency:.2f} | " + " | ".join(cells) + " |", flush=True)
    return 0 if passed else 1


if __name__ == "__main__":
    raise SystemExit(main(sys.argv[1:]))
