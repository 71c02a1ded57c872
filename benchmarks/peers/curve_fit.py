"""`poisson-ml` against scipy's `curve_fit`, in CPU seconds per pixel, on the same stacks.

    python -m beambench.benchmarks.peers.curve_fit

The peer gets the closed form of the Gaussian response with its analytic Jacobian, the same start (that of the matched
filter, whose cost is not counted), weights from the expected variance at the start, and Levenberg-Marquardt.
"""

from __future__ import annotations

import os
import time
from typing import Any

import numpy as np
import numpy.typing as npt
import xarray as xr

from ...optics.constants import C_M_PER_S
from ..written.gated_stack import GaussianRig, poisson_bound, stack_capture

__all__ = ["compare", "starts"]

Float = npt.NDArray[np.float64]


def starts(rig: GaussianRig, counts: npt.NDArray[Any]) -> Float:
    """Start of every pixel by matched filter, (τ [ns], A, B), (row, col, 3): as in the general path of the estimator."""
    from ...estimators.gated.tools.design import design_of
    from ...estimators.gated.tools.poisson_fit import start
    from ...estimators.gated.tools.stack import read_stack

    stack = read_stack(stack_capture(rig, counts))
    d = design_of(stack)
    running = np.empty(stack.groups + 1)
    shift = stack.count * stack.instrument.floor_var
    out = np.empty((*counts.shape[1:], 3))
    for index in np.ndindex(*counts.shape[1:]):
        z = (counts[(slice(None), *index)] - rig.offset_dn) / rig.gain_dn_per_e
        x, a, b = start(
            z, stack.exposure, shift, d.table, d.first, d.last, d.candidates, d.box, d.mean, d.norm, running
        )
        out[index] = (d.origin_s + d.step_s * x) * 1e9, a, b
    return out


def compare(
    *, signal_e: float = 1e4, background_e: float = 15.0, rows: int = 64, cols: int = 512, peer_pixels: int = 400,
    smooth: bool = True, seed: int = 1,
) -> dict[str, Any]:  # fmt: skip
    """CPU seconds per pixel and efficiency of both. `smooth`: a tilted wall; otherwise random delays per pixel.

    Returns sizes, seconds per pixel, their ratio and the efficiency (bound/error)² of both on the peer's pixels.
    """
    rig = GaussianRig()
    rng = np.random.default_rng(seed)
    place = (
        np.linspace(0.25, 0.75, rows * cols).reshape(rows, cols) if smooth else rng.uniform(0.25, 0.75, (rows, cols))
    )
    tau = rig.start_s + rig.centre_s + rig.step_s * (rig.slices - 1) * place
    counts = rng.poisson(rig.electrons(tau, signal_e, background_e)).astype(np.uint16)
    capture = stack_capture(rig, counts)
    result, seconds = _ours(capture)
    ours = seconds / (rows * cols)

    chosen = rng.choice(rows * cols, peer_pixels, replace=False)
    begin = starts(rig, counts).reshape(-1, 3)[chosen]
    data = counts.reshape(rig.slices, -1).T[chosen].astype(np.float64)
    found, peer = _peer(rig, begin, data)

    truth = tau.reshape(-1)[chosen]
    bound = poisson_bound(rig, truth, signal_e, background_e)
    half_c = C_M_PER_S / 2 / rig.group_index
    estimate = result["range"].values.reshape(-1)[chosen]
    return {
        "slices": rig.slices, "pixels": rows * cols, "peer_pixels": peer_pixels, "signal_e": signal_e,
        "background_e": background_e, "smooth": smooth, "poisson_ml_cpu_s": ours, "curve_fit_cpu_s": peer,
        "ratio": peer / ours, "valid": float(result["valid"].values.mean()),
        "poisson_ml_efficiency": float(1 / np.mean(((estimate - truth * half_c) / bound) ** 2)),
        "curve_fit_efficiency": float(1 / np.mean(((found * 1e-9 - truth) * half_c / bound) ** 2)),
    }  # fmt: skip


def _ours(capture: xr.Dataset) -> tuple[xr.Dataset, float]:
    """The estimate of `poisson-ml`, and the median CPU seconds of five calls after a first one."""
    from ...estimators import run_estimator

    run_estimator("poisson-ml", capture)
    runs = []
    for _ in range(5):
        t0 = time.process_time()
        result = run_estimator("poisson-ml", capture)
        runs.append(time.process_time() - t0)
    return result, float(np.median(runs))


def _peer(rig: GaussianRig, begin: Float, data: Float) -> tuple[Float, float]:
    """Times in ns by `curve_fit` from the starts `begin`, one pixel after the other, and CPU seconds per pixel."""
    from scipy.optimize import curve_fit

    t, sigma, height = rig.delay_s * 1e9, rig.sigma_s * 1e9, rig.part_s / rig.sigma_s
    centre = rig.centre_s * 1e9

    def model(t: Float, tau: float, a: float, b: float) -> Float:
        u = (tau - t - centre) / sigma
        return np.asarray(a * height * np.exp(-0.5 * u * u) + b)

    def jacobian(t: Float, tau: float, a: float, b: float) -> Float:
        u = (tau - t - centre) / sigma
        r = height * np.exp(-0.5 * u * u)
        out = np.empty((t.size, 3))
        out[:, 0], out[:, 1], out[:, 2] = -a * r * u / sigma, r, 1.0
        return out

    errors = [np.sqrt(np.maximum(model(t, *s), 1.0)) for s in begin]
    found = np.empty(len(data))
    t0 = time.process_time()
    for i in range(len(data)):
        found[i] = curve_fit(model, t, data[i], p0=begin[i], sigma=errors[i], jac=jacobian, absolute_sigma=True)[0][0]
    return found, (time.process_time() - t0) / len(data)


def main() -> None:
    """Print the comparison for a smooth wall and for delays at random."""
    for smooth in (True, False):
        f = compare(smooth=smooth)
        light = f"{f['signal_e']:g} photoelectrons, {f['background_e']:g} background per slice"
        where = "tilted wall" if smooth else "random delays"
        print(f"{f['slices']} slices, {light}, {where}; CPU seconds per pixel")
        for name, pixels in (("curve_fit", f["peer_pixels"]), ("poisson_ml", f["pixels"])):
            cost, efficiency = f[f"{name}_cpu_s"] * 1e6, f[f"{name}_efficiency"]
            print(f"{name:<12s} {cost:9.3f} us  efficiency {efficiency:.3f}  ({pixels} pixels)")
        print(f"ratio        {f['ratio']:9.0f}")


if __name__ == "__main__":
    os.environ.setdefault("OMP_NUM_THREADS", "1")
    main()
