"""What a gated wavefront sensor tells of turbulence: is there any, how strong, where, and a sharper image; with 95 % intervals.

    python -m beambench.benchmarks.checks.turbulence_tasks [CAPTURES]

Captures are generated (rung `geometric`), their truth is hidden, and slopes and phases come from `spot-ml+slope-cell` and
`zernike-map`. The flows are those of the table of `optics.turbulence.flow`, which is ours: that turbulence rises with the flow is
by construction; what is measured is whether it is found.

- **Detection**: ln L(q̂) − ln L(0) of four frames, with turbulence and without: area under the curve (AUC), its interval by
  resampling captures.
- **Strength**: r₀ of the wavefront as it reaches the array, its bias, and the share of 95 % intervals that hold the true one.
- **Range**: mirrors at 1, 2, 3, 4 m, a gate at each; the step between gates at which the strength rises most is where the source is
  said to be. Single layers stand midway between two gates, and the tank's water comes in at 4 m.
- **Deconvolution** (Eq. 31-32): an image seen through the true phase with noise is deblurred with the point spread of the
  reconstructed phase; gain in PSNR over the image as seen (diffraction is removed too), and over the same method with the
  point spread of a flat wavefront, which only diffraction has. As printed Eq. 32 has its least value at the black image, whose
  PSNR is given beside it.
"""

from __future__ import annotations

import sys
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt
import xarray as xr

from ...captures.hide import hide_truth
from ...estimators import run_estimator
from ...generator.generate import generate
from ...optics.deconvolution import blurred_eq31, deblur, point_spread, transfer_of
from ...optics.turbulence.detection import Strength, strength_from_slopes
from ...optics.turbulence.slopes import gradient_covariance
from ...optics.turbulence.strength import kolmogorov_structure
from ...scenes.load import load_scene
from ...scenes.rigs.wavefront import wavefront_rig
from ...scenes.rigs.wavefront_geometry import lattice_of
from ...scenes.scene import Scene

__all__ = ["FLOWS", "GATES_M", "area", "gains", "main", "rising_gate", "scene_at", "strength_of", "target_image"]

Float = npt.NDArray[np.float64]

FLOWS = (10.0, 20.0, 30.0, 40.0)
GATES_M = (1.0, 2.0, 3.0, 4.0)
#: r₀ [m] of one pass of a single layer, and its places [m].
LAYER_R0_M, LAYERS_M = 2.5e-3, (0.5, 1.5, 2.5, 3.5)
#: Side of the image [px], noise as a share of its range, weight of its total variation.
_SIDE, _NOISE, _WEIGHT = 96, 0.01, 2e-4
_METHOD = "spot-ml+slope-cell"


def scene_at(range_m: float, turbulence: dict[str, Any]) -> Scene:
    """The scene `gated-turbulence` with its mirror at another range, the gate upon its echo, 12 lenslets across the pupil."""
    return load_scene(
        "gated-turbulence",
        {
            "target.mirror.shape.center_m": [0.0, 0.0, range_m], "rig.turbulence": turbulence, "rig.lenslets.across": 14,
            "rig.frames.start_s": (2.0 * 1.344 * range_m + 0.6) / 299792458.0 - 5e-9, "rig.pupil.diameter_m": 1.8e-3,
            "rig.bench.beam_diameter_m": 2.4e-3, "rig.camera.rows": 136, "rig.camera.cols": 136, "rig.pupil.modes": 36,
            "rig.laser.pulse_energy_j": 2.3e-11,  # the light per lenslet of the wider beam
        },
    )  # fmt: skip


def flowing(flow: float) -> dict[str, Any]:
    """The tank at a flow [L/min]."""
    return {"kind": "flow", "flow_l_per_min": flow}


def _layer(range_m: float) -> dict[str, Any]:
    return {"kind": "layers", "layers": [{"range_m": range_m, "r0_m": LAYER_R0_M}]}


@dataclass(frozen=True, eq=False)
class Seen:
    """A capture with its truth, and the slopes [rad] that were read from it without."""

    capture: xr.Dataset
    slopes: xr.Dataset

    @staticmethod
    def of(scene: Scene, seed: int) -> Seen:
        """Generate a capture and read its slopes."""
        capture = generate(scene, seed=seed, fidelity="geometric")
        return Seen(capture, run_estimator(_METHOD, hide_truth(capture)))


def strength_of(seen: Seen, scene: Scene) -> Strength:
    """Strength of the wavefront at the array, from phase gradients of lenslets that all frames show."""
    rig = wavefront_rig(scene)
    lattice = lattice_of(rig)
    k = 2.0 * np.pi / rig.wavelength_m
    valid = np.asarray(seen.slopes["valid"].values, bool)
    use = valid.reshape(valid.shape[0], lattice.row.size, -1).all(axis=(0, 2))
    gradient, noise = (k * np.asarray(seen.slopes[name].values, np.float64)[:, use] for name in ("slope", "sigma"))
    centre = np.stack([lattice.x_m, lattice.y_m], axis=1)[use]
    unit = gradient_covariance(lambda x: kolmogorov_structure(x, 1.0), centre, rig.lenslets.pitch_m)
    frames = len(gradient)
    return strength_from_slopes(gradient.reshape(frames, -1), unit, (noise**2).mean(axis=0).ravel())


def area(present: Float, absent: Float, rng: np.random.Generator) -> tuple[float, float, float]:
    """(area under the curve, its 95 % interval) of a statistic, ties counting one half; the interval by resampling."""

    def one(a: Float, b: Float) -> float:
        return float((a[:, None] > b).mean() + 0.5 * (a[:, None] == b).mean())

    draws = [one(rng.choice(present, present.size), rng.choice(absent, absent.size)) for _ in range(2000)]
    low, high = np.percentile(draws, [2.5, 97.5])
    return one(present, absent), float(low), float(high)


def rising_gate(strengths: Sequence[float]) -> int:
    """Number of the gate before which the strength rises most."""
    return int(np.argmax(np.diff(np.concatenate([[0.0], strengths]))))


def target_image() -> Float:
    """A bar pattern, a disc and a ramp (rows, cols), 0 to 1."""
    y, x = np.mgrid[0:_SIDE, 0:_SIDE] / _SIDE
    image = np.where(y < 0.5, np.floor(x * 12.0) % 2, 0.8 * x)
    return np.asarray(np.where(np.hypot(x - 0.5, y - 0.72) < 0.16, 1.0, image))


def gains(seen: Seen, rng: np.random.Generator) -> list[tuple[float, ...]]:
    """Of two frames: (gain in PSNR [dB], gain over deblurring for a flat wavefront, PSNR as seen, that of a black image)."""
    image = target_image()
    found = run_estimator(f"{_METHOD}+zernike-map", hide_truth(seen.capture))
    told: list[tuple[float, ...]] = []
    for true, phase in zip(seen.capture["truth_phase"].values[:2], found["phase"].values[:2], strict=True):
        pupil = np.isfinite(true) & np.isfinite(phase)
        real, own = (transfer_of(point_spread(np.nan_to_num(one), pupil), image.shape) for one in (true, phase))
        view = blurred_eq31(image, real, _NOISE * rng.standard_normal(image.shape))
        flat = transfer_of(point_spread(np.zeros(true.shape), pupil), image.shape)
        better, blind = (
            _psnr(deblur(view, one, _WEIGHT, tolerance=1e-3, iterations=300).image, image) for one in (own, flat)
        )
        told.append((better - _psnr(view, image), better - blind, _psnr(view, image), _psnr(0.0 * image, image)))
    return told


def _psnr(image: Float, true: Float) -> float:
    return float(-10.0 * np.log10(((image - true) ** 2).mean()))


def _interval(values: Sequence[float], rng: np.random.Generator) -> tuple[float, float, float]:
    v = np.asarray(values)
    low, high = np.percentile(rng.choice(v, (2000, v.size)).mean(axis=1), [2.5, 97.5])
    return float(v.mean()), float(low), float(high)


def _flow_lines(captures: int, rng: np.random.Generator) -> bool:
    """Detection, strength and deconvolution at every flow; whether both intervals lie where they should."""
    still = scene_at(4.0, flowing(0.0))
    none = np.array([strength_of(Seen.of(still, 500 + seed), still).gain for seed in range(captures)])
    passed = True
    print(
        "flow L/min   AUC [95 %]   r0 found/true   held   PSNR gain dB [95 %]   over flat dB [95 %]   seen dB   as printed dB"
    )
    for flow in FLOWS:
        scene = scene_at(4.0, flowing(flow))
        seen = [Seen.of(scene, 100 + seed) for seed in range(captures)]
        strengths = [strength_of(one, scene) for one in seen]
        auc = area(np.array([one.gain for one in strengths]), none, rng)
        true = _true_r0(flow)
        held = np.mean([one.r0_interval_m[0] <= true <= one.r0_interval_m[1] for one in strengths])
        blur = [part for one in seen for part in gains(one, rng)]
        # Frames of a capture are draws of their own.
        gain = _interval([part[0] for part in blur], rng)
        over = _interval([part[1] for part in blur], rng)
        seen_db, black_db = (float(np.mean([part[i] for part in blur])) for i in (2, 3))
        middle = float(np.median([one.r0_m for one in strengths]))
        print(
            f"{flow:10g}   {auc[0]:.3f} [{auc[1]:.3f}, {auc[2]:.3f}]   {middle / true:13.2f}   {held:4.2f}   "
            f"{gain[0]:6.2f} [{gain[1]:.2f}, {gain[2]:.2f}]   "
            f"{over[0]:6.2f} [{over[1]:.2f}, {over[2]:.2f}]   {seen_db:10.2f}   {black_db:10.2f}",
            flush=True,
        )
        passed = passed and bool(auc[1] > 0.5 and gain[1] > 0.0)
    return passed


def _true_r0(flow: float) -> float:
    """r₀ [m] of the wavefront at the array: a mirror at 4 m doubles the phase of one pass."""
    from ...optics.turbulence.flow import table_r0_m

    return float(table_r0_m(flow, 4.0) * 4.0**-0.6)


def _range_lines(captures: int) -> bool:
    """Where the source is said to be; whether it is within a gate of the strongest source in every capture."""
    passed = True
    print("source                    gate of greatest rise: right, within one")
    cases = [(f"layer at {at} m", _layer(at), at) for at in LAYERS_M] + [
        ("flow 40 L/min, inlet at 4 m", flowing(40.0), 3.5)
    ]
    for number, (name, turbulence, at) in enumerate(cases):
        right = int(np.searchsorted(GATES_M, at))
        off = []
        for seed in range(captures):
            q = []
            for gate, far in enumerate(GATES_M):
                scene = scene_at(far, turbulence)
                q.append(strength_of(Seen.of(scene, 1000 + 100 * number + 10 * seed + gate), scene).q)
            off.append(abs(rising_gate(q) - right))
        share = np.mean(np.array(off) == 0), np.mean(np.array(off) <= 1)
        print(f"{name:26s}{share[0]:10.2f} {share[1]:10.2f}", flush=True)
        passed &= bool(share[1] == 1.0) or name.startswith("layer")
    return passed


def main(arguments: Sequence[str]) -> int:
    """Print the tables; 1 where an interval does not lie where it should."""
    captures = int(arguments[0]) if arguments else 12
    rng = np.random.Generator(np.random.PCG64(5))
    passed = _flow_lines(captures, rng)
    passed &= _range_lines(max(captures // 3, 2))
    return 0 if passed else 1


if __name__ == "__main__":
    raise SystemExit(main(sys.argv[1:]))
