"""`poisson-ml` against compiled fitters, in CPU seconds per pixel, on the same stacks and from the same starting values.

    python -m beambench.benchmarks.peers.compiled_fit

Peers, each given the closed form of the Gaussian response, which `poisson-ml` is not given:
- MINPACK `lmder` in C (package cminpack-numba), called in a compiled loop over pixels with a compiled model and analytic
  Jacobian: no Python between pixels. Weighted least squares, weights from the start's expected variance.
- Minuit's MIGRAD in C++ (package iminuit) with a compiled Poisson likelihood and gradient; it can only be called pixel by
  pixel from Python.
- SciPy's `curve_fit` is in `curve_fit.py`. Cpufit is not available as a package.
"""

from __future__ import annotations

import os
import time
from collections.abc import Callable
from importlib.util import find_spec

import numpy as np
import numpy.typing as npt

from ...optics.constants import C_M_PER_S
from ...optics.jit import c_callback, kernel
from ..written.gated_stack import GaussianRig, poisson_bound, stack_capture
from .curve_fit import starts

__all__ = ["PEERS", "compare"]

Float = npt.NDArray[np.float64]
Fit = Callable[[GaussianRig, Float, Float], tuple[Float, float]]


def _minpack(rig: GaussianRig, data: Float, start: Float) -> tuple[Float, float]:
    """τ [ns] of every row of data (pixel, slice) by lmder, and CPU seconds per pixel."""
    from cminpack_numba import CminpackSignature, lmder, lmder_sig  # type: ignore[import-not-found, import-untyped, unused-ignore]

    n = rig.slices
    # udata: σ, height, slices; then delay + centre, count, 1/σ_y of every slice.
    pointer = lmder_sig.args[3]

    @c_callback(CminpackSignature.lmder(udata_type=pointer))  # type: ignore[untyped-decorator]
    def model(user, m, count, x, fvec, fjac, stride, flag):  # type: ignore[no-untyped-def]
        for k in range(m):
            u = (x[0] - user[2 + k]) / user[0]
            w = user[2 + 2 * m + k]
            r = user[1] * np.exp(-0.5 * u * u)
            if flag == 1:
                fvec[k] = (x[1] * r + x[2] - user[2 + m + k]) * w
            else:
                fjac[k] = -x[1] * r * u / user[0] * w
                fjac[k + stride] = r * w
                fjac[k + 2 * stride] = w
        return 0

    address = model.address

    @kernel(cache=False)  # type: ignore[untyped-decorator]
    def run(address, data, start, fixed, found):  # type: ignore[no-untyped-def]
        n = data.shape[1]
        user = np.empty(2 + 3 * n)
        user[: 2 + n] = fixed
        for p in range(data.shape[0]):
            for k in range(n):
                u = (start[p, 0] - fixed[2 + k]) / fixed[0]
                mean = start[p, 1] * fixed[1] * np.exp(-0.5 * u * u) + start[p, 2]
                user[2 + n + k] = data[p, k]
                user[2 + 2 * n + k] = 1 / np.sqrt(max(mean, 1.0))
            found[p] = lmder(address, n, start[p], 1e-6, 1e-6, 0.0, 200, None, 1, 100.0, 0, user)[0][0]

    fixed = np.concatenate(
        [[rig.sigma_s * 1e9, rig.part_s / rig.sigma_s], (rig.delay_s + rig.centre_s) * 1e9]
    )  # fmt: skip
    found = np.empty(data.shape[0])
    run(address, data[:2], start[:2], fixed, found[:2])
    assert fixed.size == 2 + n
    t0 = time.process_time()
    run(address, data, start, fixed, found)
    return found, (time.process_time() - t0) / data.shape[0]


@kernel(error_model="numpy")
def _misfit(t, y, sigma, height, tau, a, b):  # type: ignore[no-untyped-def]
    total = 0.0
    for k in range(t.size):
        u = (tau - t[k]) / sigma
        mean = a * height * np.exp(-0.5 * u * u) + b
        total += mean - y[k] * np.log(mean) if mean > 0 else 1e30
    return total


@kernel(error_model="numpy")
def _misfit_gradient(t, y, sigma, height, tau, a, b, out):  # type: ignore[no-untyped-def]
    out[:] = 0.0
    for k in range(t.size):
        u = (tau - t[k]) / sigma
        r = height * np.exp(-0.5 * u * u)
        g = 1 - y[k] / (a * r + b)
        out[0] -= g * a * r * u / sigma
        out[1] += g * r
        out[2] += g


def _minuit(rig: GaussianRig, data: Float, start: Float) -> tuple[Float, float]:
    """τ [ns] of every row of data (pixel, slice) by MIGRAD, and CPU seconds per pixel."""
    from iminuit import Minuit

    t = (rig.delay_s + rig.centre_s) * 1e9
    sigma, height = rig.sigma_s * 1e9, rig.part_s / rig.sigma_s
    out = np.empty(3)

    def one(y: Float, s: Float) -> float:
        def cost(tau: float, a: float, b: float) -> float:
            return float(_misfit(t, y, sigma, height, tau, a, b))

        def gradient(tau: float, a: float, b: float) -> Float:
            _misfit_gradient(t, y, sigma, height, tau, a, b, out)
            return out

        fit = Minuit(cost, *s, grad=gradient)
        fit.errordef = Minuit.LIKELIHOOD
        fit.limits = [None, (1e-3, None), (1e-3, None)]
        fit.strategy = 0
        fit.migrad()
        return float(fit.values[0])

    one(data[0], start[0])
    found = np.empty(data.shape[0])
    t0 = time.process_time()
    for i in range(data.shape[0]):
        found[i] = one(data[i], start[i])
    return found, (time.process_time() - t0) / data.shape[0]


#: name: (package that must be installed, the fit)
PEERS: dict[str, tuple[str, Fit]] = {
    "minpack-lmder": ("cminpack_numba", _minpack),
    "minuit-migrad": ("iminuit", _minuit),
}


def compare(
    *, signal_e: float = 1e4, background_e: float = 15.0, rows: int = 64, cols: int = 512, peer_pixels: int = 2000,
    seed: int = 1,
) -> dict[str, dict[str, float]]:  # fmt: skip
    """{name: {"cpu_s" per pixel, "efficiency", "ratio" to poisson-ml}} for `poisson-ml` and each peer that is installed.

    Echoes at random delays; peers run on `peer_pixels` of the pixels (Minuit on a tenth of them) from the start of the
    matched filter, whose cost is not counted.
    """
    from ...estimators import run_estimator

    rig = GaussianRig()
    rng = np.random.default_rng(seed)
    tau = rig.start_s + rig.centre_s + rig.step_s * (rig.slices - 1) * rng.uniform(0.25, 0.75, (rows, cols))
    counts = rng.poisson(rig.electrons(tau, signal_e, background_e)).astype(np.uint16)
    capture = stack_capture(rig, counts)
    run_estimator("poisson-ml", capture)
    runs = []
    for _ in range(7):
        t0 = time.process_time()
        result = run_estimator("poisson-ml", capture)
        runs.append(time.process_time() - t0)
    ours = float(np.median(runs)) / (rows * cols)
    half_c = C_M_PER_S / 2 / rig.group_index
    bound = poisson_bound(rig, tau, signal_e, background_e)
    error = (result["range"].values - tau * half_c) / bound
    table = {"poisson-ml": {"cpu_s": ours, "efficiency": float(1 / np.mean(error**2)), "ratio": 1.0}}
    chosen = rng.choice(rows * cols, peer_pixels, replace=False)
    start = np.ascontiguousarray(starts(rig, counts).reshape(-1, 3)[chosen])
    data = np.ascontiguousarray(counts.reshape(rig.slices, -1).T[chosen].astype(np.float64))
    for name, (package, fit) in PEERS.items():
        if find_spec(package) is None:
            continue
        n = peer_pixels if package != "iminuit" else max(1, peer_pixels // 10)
        found, cost = fit(rig, data[:n], start[:n])
        error = (found * 1e-9 - tau.reshape(-1)[chosen[:n]]) * half_c / bound.reshape(-1)[chosen[:n]]
        table[name] = {"cpu_s": cost, "efficiency": float(1 / np.mean(error**2)), "ratio": cost / ours}
    return table


def main() -> None:
    """Print the comparison, and the names of peers that are not installed."""
    table = compare()
    print("64 slices, 10000 photoelectrons, 15 background per slice, random delays; CPU seconds per pixel, one thread")
    for name, row in table.items():
        print(f"{name:<16s} {row['cpu_s'] * 1e6:9.3f} us  efficiency {row['efficiency']:.3f}  {row['ratio']:8.1f} x")
    for name, (package, _fit) in PEERS.items():
        if name not in table:
            print(f"{name:<16s} not installed (pip install {package.replace('_', '-')})")


if __name__ == "__main__":
    os.environ.setdefault("OMP_NUM_THREADS", "1")
    main()
