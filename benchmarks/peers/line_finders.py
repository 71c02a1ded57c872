"""Laser-line finders against `np.argmax` and against other packages, on the same frames with truth, side by side in one run.

    python -m beambench.benchmarks.peers.line_finders

Tables: a frame found and triangulated by the cheapest chain and by the most precise one, in times of `np.argmax(frame, axis=1)`, at
four sizes, and the exponents of the cost against the number of pixels; every finder before the exact triangulation at two
sizes; speed and error beside OpenCV's filters and `ridge-detection` (`line_peers.py`); what smoothing along the line costs in
resolution. Times are CPU seconds of one process, the least of several calls that take turns.
"""

from __future__ import annotations

import os
import time
from collections.abc import Callable, Mapping
from importlib.util import find_spec
from typing import Any

import numpy as np
import numpy.typing as npt
import xarray as xr

from ..written.laser_line import written_capture
from .along_line import rise_rows
from .line_peers import PEERS

__all__ = ["against_argmax", "against_peers", "finders_against_argmax", "exponents", "frame_of", "least_times"]

#: Exact refraction behind the finder that costs least, and behind the one that is most precise.
CHEAPEST = "line-parabola+triangulate-refractive"
CHAIN = "line-ml+triangulate-refractive"
#: All finders that read a row alone.
ROW_FINDERS = (
    "line-peak", "line-parabola", "line-log-gaussian", "line-blais-rioux", "line-centroid", "line-window-centroid", "line-erf",
    "line-ml",
)  # fmt: skip
FINDERS = ("line-ml", "line-erf", "line-log-gaussian", "line-steger")
SIZES = ((256, 192), (480, 640), (768, 960), (1024, 1280))
#: σ of the line [px], photoelectrons of it per row, and smoothing of the peers [px].
WIDTH_PX, ELECTRONS, SCALE_PX = 0.75, 2e4, 0.9


def frame_of(rows: int, cols: int, *, seed: int = 1) -> xr.Dataset:
    """A capture of one frame: a line of .75 px, 20,000 electrons a row, slightly slanted, 12 bits, read noise 10 electrons.

    The field of view is the same at every size.
    """
    from ...scenes.load import load_scene

    scene = load_scene(
        "spotscan-wall",
        {
            "rig.frames.lit": 1, "rig.camera.rows": rows, "rig.camera.cols": cols,
            "rig.camera.pixel_pitch_m": 57.8125e-6 * 192 / cols, "rig.laser.waist_m": 1e-5, "rig.laser.divergence_rad": 1e-5,
            "rig.lens_sigma_px": WIDTH_PX, "rig.detector.adc_bits": 12, "rig.detector.gain_dn_per_e": 0.05,
            "rig.detector.offset_dn": 100.0, "rig.detector.read_noise_e": 10.0,
        },
    )  # fmt: skip
    column = 0.6 * cols + np.linspace(-4.0, 4.0, rows)[None, :]
    return written_capture(scene, ELECTRONS, WIDTH_PX, 20.0, column, seed=seed)


def least_times(calls: Mapping[str, Callable[[], Any]], *, turns: int = 15) -> dict[str, float]:
    """Least CPU seconds of each call, after one that is not counted; they take turns, each three times in a row."""
    best = dict.fromkeys(calls, float("inf"))
    for call in calls.values():
        call()
    for _ in range(turns):
        for name, call in calls.items():
            for _ in range(3):
                begin = time.process_time()
                call()
                best[name] = min(best[name], time.process_time() - begin)
    return best


def against_argmax(sizes: tuple[tuple[int, int], ...] = SIZES, *, turns: int = 15) -> list[dict[str, float]]:
    """A row per size: rows, cols, CPU seconds of `np.argmax`, of `line-ml`, of the chain behind it and of the cheapest one."""
    from ...captures.hide import hide_truth
    from ...estimators import get_estimator

    finder, chain, cheapest = (get_estimator(name) for name in ("line-ml", CHAIN, CHEAPEST))
    table = []
    for rows, cols in sizes:
        capture = hide_truth(frame_of(rows, cols))
        frame = np.ascontiguousarray(capture["counts"].values[0])
        calls: dict[str, Callable[[], Any]] = {
            "argmax": lambda f=frame: np.argmax(f, axis=1),  # type: ignore[misc]
            "line-ml": lambda c=capture: finder(c),  # type: ignore[misc]
            "chain": lambda c=capture: chain(c),  # type: ignore[misc]
            "cheapest": lambda c=capture: cheapest(c),  # type: ignore[misc]
        }
        table.append({"rows": rows, "cols": cols} | least_times(calls, turns=turns))
    return table


def finders_against_argmax(rows: int, cols: int, *, turns: int = 10) -> dict[str, tuple[float, float]]:
    """{finder: (times of `np.argmax` that it and the exact triangulation take, rms error [px])} of one frame."""
    from ...captures.hide import hide_truth
    from ...estimators import get_estimator

    capture = frame_of(rows, cols)
    truth, hidden = capture["truth_column"].values[0, :, 0], hide_truth(capture)
    frame = np.ascontiguousarray(capture["counts"].values[0])
    calls: dict[str, Callable[[], Any]] = {"argmax": lambda: np.argmax(frame, axis=1)}
    for name in ROW_FINDERS:
        chain = get_estimator(f"{name}+triangulate-refractive")
        calls[name] = lambda e=chain: e(hidden)  # type: ignore[misc]
    seconds = least_times(calls, turns=turns)
    made = {}
    for name in ROW_FINDERS:
        error = get_estimator(name)(hidden)["column"].values[0, :, 0] - truth
        made[name] = seconds[name] / seconds["argmax"], float(np.sqrt(np.nanmean(error**2)))
    return made


def exponents(table: list[dict[str, float]], name: str) -> tuple[float, float, float]:
    """(p of cost ~ pixels^p by least squares of the logarithms; seconds per row; seconds per pixel of cost = rows a + pixels b)."""
    rows, cols, cost = (np.array([entry[key] for entry in table]) for key in ("rows", "cols", name))
    power = float(np.polyfit(np.log(rows * cols), np.log(cost), 1)[0])
    share = np.stack([rows, rows * cols], axis=1) / cost[:, None]
    per_row, per_pixel = np.linalg.lstsq(share, np.ones(len(cost)), rcond=None)[0]
    return power, float(per_row), float(per_pixel)


def against_peers(rows: int, cols: int, *, slow: bool = True, turns: int = 5) -> dict[str, dict[str, float]]:
    """{name: CPU seconds per frame, rms error [px], share of rows found} of ours and of each peer that is installed.

    `slow`: peers in plain Python too. Errors are those of rows that are found, without the ten at either end.
    """
    from ...captures.hide import hide_truth
    from ...estimators import get_estimator

    capture = frame_of(rows, cols)
    truth, hidden = capture["truth_column"].values[0, :, 0], hide_truth(capture)
    frame = np.ascontiguousarray(capture["counts"].values[0])
    calls: dict[str, Callable[[], npt.NDArray[Any]]] = {}
    for name in FINDERS:
        chosen = get_estimator(name)
        calls[name] = lambda e=chosen: e(hidden)["column"].values[0, :, 0]  # type: ignore[misc]
    for name, (module, _, finder) in PEERS.items():
        if find_spec(module) is not None and (slow or name != "ridge-detection"):
            calls[name] = lambda f=finder: f(frame, SCALE_PX)  # type: ignore[misc]
    quick = {name: call for name, call in calls.items() if name != "ridge-detection"}
    seconds = least_times(quick, turns=turns)
    table = {}
    for name, call in calls.items():
        begin = time.process_time()
        error = (call() - truth)[10:-10]
        took = seconds.get(name, time.process_time() - begin)
        found = np.isfinite(error)
        table[name] = {
            "cpu_s": took, "rms_px": float(np.sqrt((error[found] ** 2).mean())), "found": float(found.mean()),
        }  # fmt: skip
    return table


def _print_argmax() -> None:
    table = against_argmax()
    print(f"One frame, line of {WIDTH_PX} px; CPU time over that of np.argmax(frame, axis=1), and per pixel")
    for entry in table:
        size = f"{entry['rows']:.0f} x {entry['cols']:.0f}"
        ratios = "  ".join(
            f"{name} {entry[name] / entry['argmax']:5.1f} x" for name in ("line-ml", "chain", "cheapest")
        )
        pixels = entry["rows"] * entry["cols"]
        each, cheap, plain = (entry[name] / pixels * 1e9 for name in ("chain", "cheapest", "argmax"))
        print(f"{size:<12s} {ratios}  {each:6.2f} and {cheap:.2f} ns per pixel (argmax {plain:.2f})")
    for name in ("argmax", "line-ml", "chain", "cheapest"):
        power, per_row, per_pixel = exponents(table, name)
        print(f"{name:<8s} ~ pixels^{power:.2f}; {per_row * 1e6:.2f} us per row + {per_pixel * 1e9:.2f} ns per pixel")


def _print_finders() -> None:
    sizes = ((256, 192), (1024, 1280))
    small, large = (finders_against_argmax(*size) for size in sizes)
    print("finder, then the exact triangulation: times of np.argmax at 256 x 192, at 1024 x 1280; rms error there")
    for name in ROW_FINDERS:
        print(f"{name:<22s} {small[name][0]:6.1f} x  {large[name][0]:6.1f} x  {large[name][1]:.4f} px")


def main() -> None:
    """Print the tables, and the names of peers that are not installed."""
    print(f"chain: {CHAIN}; cheapest: {CHEAPEST}")
    _print_argmax()
    _print_finders()
    for rows, cols, slow in ((256, 192, True), (1024, 1280, False)):
        print(f"{rows} x {cols}: CPU ms per frame, rms error, share of rows found, time over that of line-ml")
        table = against_peers(rows, cols, slow=slow)
        for name, row in table.items():
            ratio = row["cpu_s"] / table["line-ml"]["cpu_s"]
            print(f"{name:<18s} {row['cpu_s'] * 1e3:10.3f}  {row['rms_px']:.4f} px  {row['found']:.3f}  {ratio:8.1f} x")
    print("rows from 10 to 90 % of a step of the line")
    for name in FINDERS:
        print(f"{name:<18s} {rise_rows(name):.2f}")
    for name, (module, package, _) in PEERS.items():
        if find_spec(module) is None:
            print(f"{name:<18s} not installed (pip install {package})")


if __name__ == "__main__":
    for _name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "OPENCV_FOR_THREADS_NUM"):
        os.environ.setdefault(_name, "1")
    main()
