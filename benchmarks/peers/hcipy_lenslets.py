"""Spot fields of `optics.lenslets` against HCIPy's microlens array and Fresnel propagator: agreement and time.

Both see the same pupil phase: none, random pistons and tilts per lenslet, or Kolmogorov turbulence given on 16 × 16 cells a
lenslet. The reference is HCIPy with 96 samples across a lenslet; judged are HCIPy with 16 samples, our finest setting, and
our fast one. Images are summed to 8 × 8 pixels a lenslet. HCIPy's light beyond the array's edge is lost or comes back, so
that the two outermost rows of lenslets are left out. Times are medians of forward frames of 32 × 32 lenslets in one process,
one thread (OPENBLAS_NUM_THREADS=1 OMP_NUM_THREADS=1), whose order alternates; they are given as a ratio only, beside the
error of both.

    pip install hcipy && python -m beambench.benchmarks.peers.hcipy_lenslets
"""

from __future__ import annotations

import argparse
import json
import sys
import time
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...optics.lenslets.coherent import Detector, Lenslet
from ...optics.lenslets.lattice import LensletArray, cells_of_phase, regular_array
from ...optics.turbulence.screens import kolmogorov_screen

__all__ = ["agreement", "array_of", "our_frame", "peer_frame", "pupil_phase", "time_ratio"]

Float = NDArray[np.float64]

WAVELENGTH_M, FOCAL_M, PITCH_M = 532e-9, 6.7e-3, 150e-6
SAMPLES, FINE, PIXELS = 16, 96, 8
LIMIT = 0.01

#: (cells, lattice points per pitch, neighbours): the finest setting, and the fast one that is timed.
FINEST, FAST = (16, 32, 2), (2, 16, 1)


def pupil_phase(kind: str, lenslets: int, rng: np.random.Generator, samples: int = SAMPLES) -> Float:
    """Phase [rad] (samples·lenslets, samples·lenslets): "plane", "pistons" with tilts up to 1 mrad, or "turbulence" of d/r₀
    = .3."""
    n = lenslets * samples
    if kind == "plane":
        return np.zeros((n, n))
    if kind == "turbulence":
        cells = kolmogorov_screen(PITCH_M / 0.3, (lenslets * SAMPLES,) * 2, PITCH_M / SAMPLES, rng)
        return np.asarray(np.kron(cells, np.ones((samples // SAMPLES,) * 2)))
    x = PITCH_M / samples * (np.arange(samples) - 0.5 * (samples - 1))
    slope = 2 * np.pi / WAVELENGTH_M * rng.uniform(-1e-3, 1e-3, (2, lenslets, lenslets, 1, 1))
    block = rng.uniform(0, 2 * np.pi, (lenslets, lenslets, 1, 1)) + slope[0] * x[:, None] + slope[1] * x
    return np.asarray(block.transpose(0, 2, 1, 3).reshape(n, n))


def peer_frame(lenslets: int, samples: int = SAMPLES) -> Callable[[Float], Float]:
    """A function from the phase to HCIPy's light per pixel (8·lenslets, 8·lenslets), in |u|² m². Needs the package `hcipy`."""
    import hcipy

    grid = hcipy.make_pupil_grid(lenslets * samples, lenslets * PITCH_M)
    centre = PITCH_M * (np.arange(lenslets) - 0.5 * (lenslets - 1))
    lenses = hcipy.MicroLensArray(grid, hcipy.CartesianGrid(hcipy.SeparatedCoords((centre, centre))), FOCAL_M)
    optics = hcipy.ShackHartmannWavefrontSensorOptics(grid, lenses)

    def frame(phase: Float) -> Float:
        wave = hcipy.Wavefront(hcipy.Field(np.exp(1j * phase.ravel()), grid), WAVELENGTH_M)
        light = np.asarray(optics(wave).power).reshape(phase.shape)
        size = samples // PIXELS
        return np.asarray(light.reshape(lenslets * PIXELS, size, -1, size).sum(axis=(1, 3)))

    return frame


def array_of(lenslets: int, setting: tuple[int, int, int]) -> LensletArray:
    """Our plan of `lenslets` × `lenslets` at a setting (cells, lattice points per pitch, neighbours), 8 × 8 pixels each."""
    cells, points, neighbours = setting
    pixel = PITCH_M / PIXELS
    first = -0.5 * (lenslets * PIXELS - 1) * pixel
    detector = Detector((lenslets * PIXELS,) * 2, pixel, (first, first))
    return regular_array(
        Lenslet(PITCH_M, FOCAL_M, WAVELENGTH_M), (lenslets, lenslets), PITCH_M, detector, cells=cells, samples=points,
        neighbours=neighbours,
    )  # fmt: skip


def our_frame(lenslets: int, setting: tuple[int, int, int]) -> Callable[[Float], Float]:
    """A function from the phase (16 samples a lenslet) to our light per pixel; means over cells and a plane fit per lenslet."""
    cells, array = setting[0], array_of(lenslets, setting)

    def frame(phase: Float) -> Float:
        return array.image(*cells_of_phase(phase, (lenslets, lenslets), cells, PITCH_M, WAVELENGTH_M))

    return frame


def agreement(lenslets: int = 10, seed: int = 1) -> dict[str, dict[str, dict[str, float]]]:
    """Per kind of phase and per program: the largest difference of a pixel from the reference over the brightest, the rms
    difference over the rms, and the rms difference of spots' centres of gravity in widths λf/d, without the two outermost
    rows of lenslets."""
    programs = {
        "hcipy-16": peer_frame(lenslets),
        "ours-finest": our_frame(lenslets, FINEST),
        "ours-fast": our_frame(lenslets, FAST),
    }
    reference = peer_frame(lenslets, FINE)
    rows: dict[str, dict[str, dict[str, float]]] = {}
    for kind in ("plane", "pistons", "turbulence"):
        phase = pupil_phase(kind, lenslets, np.random.default_rng(seed))
        inner = (slice(2 * PIXELS, -2 * PIXELS),) * 2
        want = reference(pupil_phase(kind, lenslets, np.random.default_rng(seed), FINE))[inner]
        width = WAVELENGTH_M * FOCAL_M / PITCH_M / (PITCH_M / PIXELS)
        rows[kind] = {}
        for name, program in programs.items():
            got = program(phase)[inner]
            rows[kind][name] = {
                "pixel_over_brightest": float(np.abs(got - want).max() / want.max()),
                "rms": float(np.sqrt(((got - want) ** 2).sum() / (want**2).sum())),
                "gravity_widths_rms": float(np.sqrt(((_gravity(got) - _gravity(want)) ** 2).mean()) / width),
            }
    return rows


def time_ratio(lenslets: int = 32, repeats: int = 9) -> float:
    """HCIPy's time (16 samples a lenslet) over that of our fast setting, both from the phase."""
    phase = pupil_phase("turbulence", lenslets, np.random.default_rng(2))
    peer, ours = peer_frame(lenslets), our_frame(lenslets, FAST)
    for program in (peer, ours):
        program(phase)
    return _ratio(lambda: peer(phase), lambda: ours(phase), repeats)


def _gravity(light: Float) -> Float:
    n = light.shape[0] // PIXELS
    block, i = light.reshape(n, PIXELS, n, PIXELS), np.arange(PIXELS)
    total = block.sum(axis=(1, 3))
    return np.stack([np.einsum("rgch,h->rc", block, i) / total, np.einsum("rgch,g->rc", block, i) / total])


def _ratio(one: Callable[[], Any], other: Callable[[], Any], repeats: int) -> float:
    times: tuple[list[float], list[float]] = ([], [])
    for _ in range(repeats):
        for work, spent in zip((one, other), times, strict=True):
            start = time.process_time()
            work()
            spent.append(time.process_time() - start)
    return float(np.median(times[0]) / np.median(times[1]))


def main(arguments: Sequence[str] | None = None) -> int:
    """Print the comparison as JSON; 1 where a pixel of our finest setting differs by more than 1 % of the brightest."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--lenslets", type=int, default=10)
    rows = agreement(parser.parse_args(arguments).lenslets)
    print(json.dumps({"agreement": rows, "hcipy_time_over_ours_fast": time_ratio()}, indent=2))
    return int(any(row["ours-finest"]["pixel_over_brightest"] > LIMIT for row in rows.values()))


if __name__ == "__main__":
    sys.exit(main())
