"""What a gated wavefront sensor tells of turbulence: is there any, how strong, where, and a sharper image; with 95 % intervals.

    python -m beambench.benchmarks.checks.turbulence_tasks [CAPTURES] [split-step]

Captures of the scene `turbulent-tank`, a frame for each of four gates, are generated (rung `geometric`), their truth is hidden, and
`spot-ml+slope-cell+turbulence-ml` and `spot-ml+slope-cell+zernike-map+deblur-tv` read them. The flows are those of the table of
`optics.turbulence.flow`, which is ours: that turbulence rises with the flow, and toward the inlet, is by construction; what is
measured is whether it is found.

With "split-step" light is propagated and scintillates, as the scene has it; without, phases of layers add in the pupil, for which
the estimators are made.

- **Detection**: probability of turbulence at the nearest and farthest gate, with and without a flow: area under the curve (AUC).
  Its interval is that of resampled captures, and no tighter than as many right answers tell.
- **Strength**: r0 at the farthest gate over the true one, and the share of captures whose 95 % interval holds it.
- **Range**: error of the source layer, in gates (1 m), for single layers midway between gates and for the tank, whose strongest
  layer is at 4 m, in the plane of the last mirror: of four answers only "between 3 and 4 m" is within one gate of it.
- **Deconvolution** (Eq. 31-32), of the farthest gate: gain in PSNR over the image as seen; the same with both shifted to fit the
  chart best, so that it is no registration; and over the same method with the point spread of a flat wavefront, which only
  diffraction has. As printed Eq. 32 has its least value at the black image, whose PSNR is given beside it.
"""

from __future__ import annotations

import sys
import warnings
from collections.abc import Sequence
from typing import Any, Literal

import numpy as np
import numpy.typing as npt
import xarray as xr
from scipy.fft import fft2, ifft2, irfft2, rfft2
from scipy.stats import beta

from ...captures.hide import hide_truth
from ...estimators import get_estimator, run_estimator
from ...estimators.rig import read_rig
from ...generator.generate import generate
from ...scenes.load import load_scene
from ...scenes.scene import Scene
from ..judges.bound import truths_of

__all__ = ["FLOWS", "area", "gains", "layer_at", "main", "psnr", "registered", "share", "tank"]

Float = npt.NDArray[np.float64]

Propagation = Literal["phase-screens", "split-step"]

FLOWS = (10.0, 20.0, 30.0, 40.0)
#: r0 [m] of one pass of a single layer, and its places [m].
LAYER_R0_M, LAYERS_M = 2.5e-3, (0.5, 1.5, 2.5, 3.5)
#: Steps of a pixel in which the shift of an image is looked for.
_FINE = 16
_SLOPES = "spot-ml+slope-cell"


def tank(flow: float, propagation: Propagation = "phase-screens") -> Scene:
    """The scene `turbulent-tank` at a flow [L/min]; with "split-step", as the scene has it, its light scintillates."""
    return load_scene("turbulent-tank", {"rig.turbulence.flow_l_per_min": flow, "rig.propagation": propagation})


def layer_at(range_m: float) -> Scene:
    """The scene `turbulent-tank` with one layer of Kolmogorov turbulence in place of the flow."""
    layer = {"range_m": range_m, "r0_m": LAYER_R0_M}
    water = {"kind": "layers", "layers": [layer]}
    return load_scene("turbulent-tank", {"rig.turbulence": water, "rig.propagation": "phase-screens"})


def _captured(scene: Scene, seed: int) -> xr.Dataset:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # that scintillation is left out stands on the page
        return generate(scene, seed=seed, fidelity="geometric")


def _told(capture: xr.Dataset) -> xr.Dataset:
    return run_estimator(f"{_SLOPES}+turbulence-ml", hide_truth(capture))


def area(present: Float, absent: Float, rng: np.random.Generator) -> tuple[float, float, float]:
    """(area under the curve, its 95 % interval) of a statistic, ties counting one half.

    The interval is that of resampled captures; its ends are at least as far out as n answers that are all right (or wrong) leave
    open, .025^{1/n} and the complement, n the smaller number of captures: resampling of a perfect separation varies by nothing.
    """

    def one(a: Float, b: Float) -> float:
        return float((a[:, None] > b).mean() + 0.5 * (a[:, None] == b).mean())

    draws = [one(rng.choice(present, present.size), rng.choice(absent, absent.size)) for _ in range(2000)]
    low, high = np.percentile(draws, [2.5, 97.5])
    open_end = 0.025 ** (1.0 / min(present.size, absent.size))
    return one(present, absent), float(min(low, open_end)), float(max(high, 1.0 - open_end))


def share(right: int, of: int) -> tuple[float, float, float]:
    """(share, its 95 % interval by Clopper and Pearson, Biometrika 26:404, 1934)."""
    low = float(beta.ppf(0.025, right, of - right + 1)) if right else 0.0
    high = float(beta.ppf(0.975, right + 1, of - right)) if right < of else 1.0
    return right / of, low, high


def psnr(image: Float, true: Float) -> float:
    """10 log10(1/mean square error) [dB] of an image whose white is 1."""
    return float(-10.0 * np.log10(((image - true) ** 2).mean()))


def registered(image: Float, true: Float) -> Float:
    """The image, shifted (periodically) by the sixteenths of a pixel that fit `true` best: of the greatest correlation."""
    spectrum = rfft2(image - image.mean()) * np.conj(rfft2(true - true.mean()))
    shape = tuple(_FINE * size for size in image.shape)
    padded = np.zeros((shape[0], shape[1] // 2 + 1), complex)
    rows, cols = image.shape[0] // 2, image.shape[1] // 2
    padded[:rows, :cols], padded[-rows:, :cols] = spectrum[:rows, :cols], spectrum[-rows:, :cols]
    peak = np.unravel_index(int(np.argmax(irfft2(padded, s=shape))), shape)
    back = [
        np.exp(2j * np.pi * np.fft.fftfreq(size) * at / _FINE)
        for size, at in zip(image.shape, map(int, peak), strict=True)
    ]
    return np.asarray(ifft2(fft2(image) * back[0][:, None] * back[1][None, :]).real)


def gains(capture: xr.Dataset) -> tuple[float, ...]:
    """Of the last frame [dB]: gain in PSNR, gain after both are registered, registered gain over deblurring for a flat wavefront,
    PSNR as seen, and that of the black image."""
    one = capture.isel(frame=[capture.sizes["frame"] - 1])
    hidden, rig = hide_truth(one), read_rig(capture)
    true = truths_of(one)["image"].value[0]
    seen = np.asarray(one["image"].values[0], np.float64) / rig.number("imager.photoelectrons")
    phase = run_estimator(f"{_SLOPES}+zernike-map", hidden)
    deblur: Any = get_estimator("deblur-tv").function
    better, flat = (
        np.asarray(deblur(held, hidden, rig)["image"].values[0])
        for held in (phase, phase.assign(phase=0.0 * phase["phase"]))
    )
    fitted = {
        name: psnr(registered(image, true), true) for name, image in (("seen", seen), ("own", better), ("flat", flat))
    }
    return (
        psnr(better, true) - psnr(seen, true), fitted["own"] - fitted["seen"], fitted["own"] - fitted["flat"], psnr(seen, true),
        psnr(0.0 * true, true),
    )  # fmt: skip


def _interval(values: Sequence[float], rng: np.random.Generator) -> tuple[float, float, float]:
    """(mean, its 95 % interval by resampling)."""
    v = np.asarray(values)
    low, high = np.percentile(rng.choice(v, (2000, v.size)).mean(axis=1), [2.5, 97.5])
    return float(v.mean()), float(low), float(high)


def _shown(value: tuple[float, float, float], digits: int) -> str:
    return f"{value[0]:.{digits}f} [{value[1]:.{digits}f}, {value[2]:.{digits}f}]"


def _flow_lines(captures: int, rng: np.random.Generator, propagation: Propagation) -> bool:
    """Detection, strength, range and deconvolution at every flow; whether the intervals lie where they should."""
    still = [_told(_captured(tank(0.0, propagation), 500 + seed)) for seed in range(captures)]
    absent = np.array([one["present"].values for one in still])
    print(f"no flow: called turbulent (P > .5) at gate 1 to 4: {(absent > 0.5).mean(axis=0)}")
    print(
        "L/min | AUC gate 1 | AUC gate 4 | r0 found/true, held | source within a gate | PSNR gain dB | registered | over flat | "
        "seen, black dB"
    )
    passed = True
    for flow in FLOWS:
        seen = [_captured(tank(flow, propagation), 100 + seed) for seed in range(captures)]
        told = [_told(one) for one in seen]
        near, far = (
            area(np.array([one["present"].values[gate] for one in told]), absent[:, gate], rng) for gate in (0, 3)
        )
        true = float(seen[0]["truth_r0"].values[3])
        r0, sigma = (np.array([one[name].values[3] for one in told]) for name in ("r0", "sigma"))
        held = float((np.abs(r0 - true) <= 1.96 * sigma).mean())
        within = _within(told, float(seen[0]["truth_source"].values[0]))
        blur = np.array([gains(one) for one in seen])
        gain, fitted, over = (_interval(blur[:, at].tolist(), rng) for at in range(3))
        print(
            f"{flow:g} | {_shown(near, 3)} | {_shown(far, 3)} | {np.median(r0) / true:.2f}, {held:.2f} | {_shown(within, 2)} | "
            f"{_shown(gain, 1)} | {_shown(fitted, 1)} | {_shown(over, 1)} | {blur[:, 3].mean():.1f}, {blur[:, 4].mean():.1f}",
            flush=True,
        )
        passed = passed and near[1] > 0.5 and far[1] > 0.5 and fitted[1] > 0.0
    return passed and within[1] > 0.25


def _within(told: Sequence[xr.Dataset], true_m: float) -> tuple[float, float, float]:
    """Share of captures whose source lies within one gate, 1 m, of the true one; an invalid answer is wrong."""
    error = np.array([abs(float(one["source"].values[0]) - true_m) for one in told])
    return share(int((error <= 1.0).sum()), error.size)


def _layer_lines(captures: int) -> None:
    """How often a single layer is told to lie in its own interval between gates, and within one gate of it."""
    print("layer at | found in its interval | within one gate")
    for number, at in enumerate(LAYERS_M):
        told = [_told(_captured(layer_at(at), 1000 + 100 * number + seed)) for seed in range(captures)]
        error = np.array([abs(float(one["source"].values[0]) - at) for one in told])
        print(
            f"{at:g} m | {_shown(share(int((error < 0.5).sum()), error.size), 2)} | {_shown(_within(told, at), 2)}",
            flush=True,
        )


def main(arguments: Sequence[str]) -> int:
    """Print the tables; 1 where an interval does not lie where it should."""
    numbers = [int(one) for one in arguments if one.isdigit()]
    captures = numbers[0] if numbers else 24
    rng = np.random.Generator(np.random.PCG64(5))
    if "split-step" in arguments:
        return 0 if _flow_lines(captures, rng, "split-step") else 1
    passed = _flow_lines(captures, rng, "phase-screens")
    _layer_lines(captures)
    return 0 if passed else 1


if __name__ == "__main__":
    raise SystemExit(main(sys.argv[1:]))
