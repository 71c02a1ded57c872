"""The chain of a Shack-Hartmann sensor against other programs: frames (makewfs, HCIPy), centroids (AOtools), modes, and memory.

Optics of Guo et al. 2017, 32 × 32 lenslets of 8 × 8 pixels, one thread. Programs take turns in one process; times are the least
CPU seconds of several calls and are given as ratios. Where programs differ in accuracy ours is the fastest setting that errs no
more:

- makewfs adds the spots' light without interference. Its image and ours are compared with our finest (16 cells a lenslet, 32
  points), which is judged by HCIPy in `hcipy_lenslets`; rms over rms, within the pupil, each scaled to the same light.
- AOtools is given the cells that it needs, cut out of the frame, and its centre of gravity about a level that is subtracted.

    pip install 'beambench[sensor-peers]' && python -m beambench.benchmarks.peers.sensor_chain
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...estimators.wavefront.modal import Solver
from ...estimators.wavefront.moment_kernel import centres_of_gravity
from ...optics.lenslets.gradients import mean_gradients, square
from ...optics.lenslets.lattice import LensletArray, cells_of_phase
from .hcipy_lenslets import (
    FINEST,
    FOCAL_M,
    PITCH_M,
    PIXELS,
    SAMPLES,
    WAVELENGTH_M,
    array_of,
    peer_frame,
    pupil_phase,
)

__all__ = [
    "against_aotools",
    "against_hcipy",
    "against_makewfs",
    "least_times",
    "memory_of_a_stream",
    "modes_in_products",
    "stream",
]

Float = NDArray[np.float64]

LENSLETS, MODES = 32, 66
#: Our settings from fast to fine: (cells, lattice points per pitch, neighbours).
SETTINGS = ((2, 16, 0), (2, 16, 1), (4, 16, 0), (4, 16, 1), (4, 24, 1), (8, 24, 1))

_TOML = """schema_version = 1
input = {{ quantity = "opd", unit = "m", shape = [{samples}, {samples}], grid_extent_m = {extent} }}
telescope = {{ pupil_diameter_m = {extent}, central_obscuration_ratio = 0.0 }}
source = {{ kind = "ngs", normalization = "detector_photon_rate", detector_photon_rate_per_s = 1.0e6 }}
sensor = {{ kind = "shack_hartmann", wavelength_m = {wavelength} }}
detector = {{ preset = "generic_cmos", exposure_s = 0.001, temperature_c = 20.0, precision = "float32" }}
numerics = {{ dtype = "float32", fft_oversampling = 2, fft_workers = 1 }}
[shack_hartmann]
lenslets_across_pupil = {lenslets}
pixels_per_subaperture = {pixels}
spot_sampling_pixels_per_lambda_over_d = {sampling}
minimum_illuminated_fraction = 0.1
crosstalk_reach_subapertures = {reach}
"""


def least_times(calls: Mapping[str, Callable[[], Any]], *, turns: int = 15) -> dict[str, float]:
    """Least CPU seconds of each call, after one that is not counted; they take turns."""
    for call in calls.values():
        call()
    best = dict.fromkeys(calls, float("inf"))
    for _ in range(turns):
        for name, call in calls.items():
            begin = time.process_time()
            call()
            best[name] = min(best[name], time.process_time() - begin)
    return best


def _makewfs(reach: int) -> Callable[[Float], Float]:
    """makewfs' light per pixel from a phase [rad]; `reach`: lenslets to each side whose pixels a spot's light falls on."""
    import makewfs

    text = _TOML.format(
        samples=LENSLETS * SAMPLES, extent=LENSLETS * PITCH_M, wavelength=WAVELENGTH_M, lenslets=LENSLETS, pixels=PIXELS,
        sampling=WAVELENGTH_M * FOCAL_M / PITCH_M / (PITCH_M / PIXELS), reach=reach,
    )  # fmt: skip
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "sensor.toml"
        path.write_text(text, encoding="utf-8")
        sensor = makewfs.WavefrontSensor.from_toml(str(path))
    return lambda phase: np.asarray(sensor.photon_rate(phase * (WAVELENGTH_M / (2.0 * np.pi))), np.float64)


def _ours(array: LensletArray, cells: int, phase: Float, apart: bool) -> Float:
    return array.image(*cells_of_phase(phase, (LENSLETS, LENSLETS), cells, PITCH_M, WAVELENGTH_M), apart=apart)


def _error(image: Float, wanted: Float, inside: NDArray[np.bool_]) -> float:
    """rms difference over rms within the pupil, after the best scale."""
    a, b = image[inside], wanted[inside]
    return float(np.sqrt(((a * (a @ b) / (a @ a) - b) ** 2).sum() / (b @ b)))


def against_makewfs() -> dict[str, dict[str, float]]:
    """Per `reach` of makewfs: its error and ours, our setting, and its time over that of our fastest setting that errs no more."""
    phase = pupil_phase("turbulence", LENSLETS, np.random.default_rng(2))
    fine = array_of(LENSLETS, FINEST)
    wanted = _ours(fine, FINEST[0], phase, True)
    t = np.arange(LENSLETS * PIXELS) - 0.5 * (LENSLETS * PIXELS - 1)
    inside = np.hypot(t[:, None], t[None, :]) < (LENSLETS / 2 - 3) * PIXELS
    table: dict[str, dict[str, float]] = {}
    for reach in (0, 1):
        peer = _makewfs(reach)
        theirs = _error(peer(phase), wanted, inside)
        for setting in SETTINGS:
            array = array_of(LENSLETS, setting)
            own = _error(_ours(array, setting[0], phase, True), wanted, inside)
            if own <= theirs:
                break
        calls = {"peer": lambda p=peer: p(phase), "ours": lambda a=array, s=setting: _ours(a, s[0], phase, True)}  # type: ignore[misc]
        spent = least_times(calls)
        table[f"makewfs, reach {reach}"] = {
            "error": theirs, "our_error": own, "cells": setting[0], "points": setting[1], "neighbours": setting[2],
            "time_over_ours": spent["peer"] / spent["ours"],
        }  # fmt: skip
    return table


def against_hcipy() -> float:
    """HCIPy's time (16 samples a lenslet) over that of our fast setting, interference in both; errors in `hcipy_lenslets`."""
    phase = pupil_phase("turbulence", LENSLETS, np.random.default_rng(2))
    peer, array = peer_frame(LENSLETS), array_of(LENSLETS, (2, 16, 1))
    spent = least_times({"peer": lambda: peer(phase), "ours": lambda: _ours(array, 2, phase, False)}, turns=9)
    return spent["peer"] / spent["ours"]


def _frame(seed: int) -> tuple[NDArray[np.uint16], Float]:
    """A frame [DN] of 32 × 32 spots 8.427 pixels apart, 3,000 photoelectrons each, and the spots' places [px]."""
    from ...optics.lenslets.spots import isolated_image

    rng, pitch, side = np.random.default_rng(seed), 8.427, 276
    middle = (np.arange(LENSLETS) - 0.5 * (LENSLETS - 1)) * pitch + 0.5 * (side - 1)
    place = np.stack([a.ravel() for a in np.meshgrid(middle, middle)], axis=1)
    at = place + 0.1 * rng.standard_normal(place.shape)
    light = isolated_image(at[:, 0], at[:, 1], np.full(len(at), 3000.0), 1.335, (side, side))
    return rng.poisson(light + 2.0).astype(np.uint16) + np.uint16(100), place


def against_aotools() -> dict[str, float]:
    """AOtools' time over that of our kernel from a frame to positions (ours also finds the level, variances and which cells are
    sound), and the rms difference of both [px]."""
    from aotools.image_processing.centroiders import centre_of_gravity

    frame, place = _frame(1)
    near = np.rint(place).astype(int)
    step = np.arange(-4, 5)
    row, col = near[:, 1, None] + step, near[:, 0, None] + step
    whole = np.ones(len(place), bool)

    def ours() -> Float:
        return centres_of_gravity(
            frame[None], place, 0.5 * 8.427, 2.9, whole, (100.0, 1.0, 0.0, 65535.0), 0.0, 1.0, 5.0
        )[0]

    def theirs() -> Float:
        cells = frame[row[:, :, None], col[:, None, :]].astype(np.float64) - 102.0
        return np.asarray(centre_of_gravity(cells).T - 4.0 + near - place)

    spent = least_times({"peer": theirs, "ours": ours}, turns=40)
    return {
        "rms_difference_px": float(np.sqrt(((ours() - theirs()) ** 2).mean())),
        "time_over_ours": spent["peer"] / spent["ours"],
    }


def modes_in_products() -> dict[str, float]:
    """Time of a frame's 66 modes from slopes with known noise, as `zernike-ls` computes them, over that of one product of a matrix
    (65, 2·lenslets) with a vector: the coefficients alone, and with their variances (a second product)."""
    middle = (np.arange(LENSLETS) - 0.5 * (LENSLETS - 1)) * PITCH_M
    x, y = (a.ravel() for a in np.meshgrid(middle, middle))
    radius = 0.5 * LENSLETS * PITCH_M
    used = np.hypot(x, y) <= radius
    slope = mean_gradients(range(2, MODES + 1), np.stack([x[used], y[used]], axis=1), square(PITCH_M), radius)
    solver = Solver.of(slope.reshape(-1, MODES - 1), np.ones(2 * int(used.sum())))
    assert solver is not None, "66 modes of 32 × 32 lenslets are told apart"
    rng = np.random.default_rng(0)
    size = solver.inverse.shape
    matrix, s = rng.standard_normal(size), rng.standard_normal((int(size[1]),))
    v = rng.uniform(1, 2, (int(size[1]),))
    spent = least_times(
        {
            "product": lambda: [matrix @ s for _ in range(20)],
            "modes": lambda: [solver.inverse @ s for _ in range(20)],
            "variances": lambda: [solver.modes(s, v) for _ in range(20)],
        },
        turns=40,
    )
    return {name: spent[name] / spent["product"] for name in ("modes", "variances")}


def stream(frames: int) -> None:
    """Phases, light and positions of so many frames, one after the other."""
    array, place = array_of(LENSLETS, (2, 16, 1)), _frame(1)[1] * (PIXELS / 8.427)
    whole = np.ones(len(place), bool)
    for seed in range(frames):
        light = _ours(array, 2, pupil_phase("turbulence", LENSLETS, np.random.default_rng(seed)), False)
        scale = (0.0, float(light.max()), -1.0, np.inf)
        centres_of_gravity(light[None], place, 0.5 * PIXELS, 2.9, whole, scale, 0.0, 1.0, 0.0)


def memory_of_a_stream(frames: tuple[int, ...] = (10, 100)) -> dict[str, float]:
    """Peak resident memory [MB] of processes that stream so many frames, one process each: {frames: peak}. Linux only."""
    code = (
        "import sys; from beambench.benchmarks.peers.sensor_chain import stream; stream(int(sys.argv[1]));"
        "print([line.split()[1] for line in open('/proc/self/status') if line.startswith('VmHWM')][0])"
    )
    found: dict[str, float] = {}
    for number in (1, *frames):  # the first one compiles what is not in the cache
        done = subprocess.run([sys.executable, "-c", code, str(number)], capture_output=True, text=True, check=True)
        found[str(number)] = float(done.stdout) / 1024.0
    del found["1"]
    return found


def main() -> int:
    """Print the comparisons as JSON."""
    from importlib.util import find_spec

    table: dict[str, Any] = {"modes_in_products": modes_in_products(), "memory_of_a_stream_mb": memory_of_a_stream()}
    for package, call in (("makewfs", against_makewfs), ("aotools", against_aotools), ("hcipy", against_hcipy)):
        there = find_spec(package) is not None
        table[package] = call() if there else f"not installed: pip install {package}"  # type: ignore[operator]
    print(json.dumps(table, indent=2))
    return 0


if __name__ == "__main__":
    if os.environ.get("OMP_NUM_THREADS") != "1":
        # Threads of NumPy's libraries are counted when they load: start anew with one.
        one = dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"), "1")
        os.execve(sys.executable, [sys.executable, "-m", "beambench.benchmarks.peers.sensor_chain"], os.environ | one)
    sys.exit(main())
