"""Which centroider is best where: error over the bound and CPU time, over light, width of the spot and read noise.

    python -m beambench.benchmarks.checks.centroids [FILE.csv [CHART.png]]

Spots of 52 lenslets in 4 frames move evenly by up to ±.3 pitch in both axes; captures are written from closed forms, on `dev`
seeds and on others. On the first the options of each centroider (its window, threshold, weight, metric) are chosen for least error
in every cell, on the others that choice is measured. Faint spots are not left out (`least_sigmas=0`); one that a
method cannot place counts as reported where the reference puts it, and an error counts up to half a pitch. `left`: the rms
error, over the bound, of an answer that puts every spot there.

`ratio`: rms error over the rms exact bound, with a 95 % interval from resampled frames' lenslets. Below 1 the bound of
unbiased answers does not hold: the answer is drawn to the declared place. `cpu_ms`: process time of a frame of 52 lenslets.
Claims of S. Thomas et al., MNRAS 371:323, 2006 (abstract) are judged by the table, in words of docs/reproduction.md.
"""

from __future__ import annotations

import itertools
import json
import sys
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import xarray as xr

from ...captures.hide import hide_truth
from ...estimators import run_estimator
from ...optics.lenslets.spots import isolated_image
from ...scenes.declared import declared_rig
from ...scenes.load import load_scene
from ...scenes.rigs.wavefront import wavefront_rig
from ...scenes.rigs.wavefront_geometry import lattice_of, spot_px
from ...scenes.scene import Scene
from ..judges.bound import bounds_of
from ..scores.tables import to_csv
from ..written.draw import truth_attributes
from ..written.wavefront import written_capture

__all__ = ["COLUMNS", "OPTIONS", "Cell", "chosen", "claims", "errors_of", "main", "rows_of", "scene_of"]

Float = npt.NDArray[np.float64]

COLUMNS = ("width_px", "read_noise_e", "flux", "estimator", "label", "lost", "rms_px", "bound_px", "ratio", "ratio_lo", "ratio_hi",
           "left", "cpu_ms")  # fmt: skip
#: Photoelectrons of a spot, zero of its sinc² from the middle [px], read noise [e].
FLUX, WIDTH_PX, READ_NOISE = (10.0, 30.0, 300.0, 10000.0), (1.33, 2.67), (0.3, 3.0)
DEV, TEST = (1,), (101, 102)
#: Exposures of the reference, whose noise counts in the bound too: a hundredth of a frame's.
EXPOSURES = 10_000
#: Part of a pitch by which spots move at most.
_MOVE = 0.3
#: Photoelectrons of background in a pixel.
_BACKGROUND = 0.1
#: Options that are tried, as labels in brackets.
OPTIONS: dict[str, tuple[str, ...]] = {
    "spot-centroid": ("",),
    "spot-threshold": tuple(f"threshold={t},sigmas={s}" for t in (0.05, 0.2, 0.4) for s in (0.0, 3.0)),
    "spot-window": tuple(f"reach={r}" for r in (1, 2, 3, 5)),
    "spot-weighted": tuple(f"width={w}" for w in (1.0, 1.5, 2.0, 3.0)),
    "spot-power": tuple(f"alpha={a}" for a in (1.25, 1.5, 2.0, 3.0)),
    "spot-brightest": tuple(f"pixels={n}" for n in (4, 9, 16, 30)),
    "spot-quad": ("",),
    "spot-correlation": ("metric=product,fit=lines", "metric=product,fit=surface", "metric=square,fit=lines"),
    "spot-matched": ("",),
    "spot-gaussian": ("",),
    "spot-ml": ("",),
    "spot-joint": ("",),
}
#: Least height of a spot, in standard deviations of the dark: none, so that no centroider is spared the faint spots.
_LEAST = 0.0


@dataclass(frozen=True)
class Cell:
    """Conditions of a line of the table."""

    width_px: float
    read_noise_e: float
    flux: float


def scene_of(cell: Cell, *, exposures: int = EXPOSURES) -> Scene:
    """Guo's lenslets before a camera without intensifier, whose pixels give the spot its width; 16 bits without coarse steps."""
    pixel = 17.8e-6 * 1.33 / cell.width_px
    side = int(np.ceil(10 * 150e-6 / pixel)) + 8
    top = cell.flux * 0.6 + 12.0 * cell.read_noise_e + 30.0
    gain = min(20.0, 5.5e4 / top)
    return load_scene(
        "gated-turbulence",
        {
            "rig.lenslets.across": 10, "rig.pupil.diameter_m": 1.2e-3, "rig.pupil.modes": 6, "rig.bench.beam_diameter_m": 1.5e-3,
            "rig.camera.pixel_pitch_m": pixel, "rig.camera.rows": side, "rig.camera.cols": side, "rig.frames.count": 4,
            "rig.frames.reference_exposures": exposures, "rig.detector.intensifier": None,
            "rig.detector.read_noise_e": cell.read_noise_e,
            "rig.detector.dark_current_e_per_s": 0.0, "rig.detector.adc_bits": 16, "rig.detector.full_well_e": 1e6,
            "rig.detector.gain_dn_per_e": gain, "rig.detector.offset_dn": float(np.ceil(8.0 * gain * cell.read_noise_e + 100.0)),
        },
    )  # fmt: skip


def captured(cell: Cell, seed: int) -> xr.Dataset:
    """A capture of a cell, with its truth."""
    scene = scene_of(cell)
    rig = wavefront_rig(scene)
    shape = (rig.frames.count, lattice_of(rig).row.size, 2)
    far = _MOVE * rig.lenslets.pitch_m / rig.lenslets.focal_length_m
    slope = np.random.Generator(np.random.PCG64(seed)).uniform(-far, far, shape)
    few = written_capture(scene_of(cell, exposures=1), cell.flux, _BACKGROUND, slope, seed=seed + 1000)
    return _with_reference(few, scene, cell, np.random.Generator(np.random.PCG64(seed + 2000)))


def _with_reference(capture: xr.Dataset, scene: Scene, cell: Cell, rng: np.random.Generator) -> xr.Dataset:
    """A capture read against the mean of many exposures: its noise is normal, and they need not be drawn one by one."""
    rig = wavefront_rig(scene)
    lattice, noise = lattice_of(rig), rig.detector
    light = np.full(lattice.row.size, cell.flux)
    mean = _BACKGROUND + isolated_image(
        lattice.col_px, lattice.row_px, light, spot_px(rig), (rig.camera.rows, rig.camera.cols)
    )
    # Rounding has the variance of 1/12 DN².
    spread = np.sqrt((mean + cell.read_noise_e**2 + 1.0 / (12.0 * noise.gain_dn_per_e**2)) / EXPOSURES)
    counts = noise.offset_dn + noise.gain_dn_per_e * (mean + spread * rng.standard_normal(mean.shape))
    exact = capture["reference"].copy(data=counts.astype(np.float32))
    parts = truth_attributes(scene, declared_rig(scene))
    told = {name: value if isinstance(value, str) else json.dumps(value) for name, value in parts.items()}
    return capture.assign(reference=exact).assign_attrs(told)


def errors_of(label: str, capture: xr.Dataset) -> tuple[Float, Float, float]:
    """(errors [px] (frame, lenslet, axis), whether a spot is lost, CPU ms of a frame) of an estimator."""
    rig = wavefront_rig(Scene.model_validate(_json(capture)))
    per_rad = rig.lenslets.focal_length_m / rig.camera.pixel_pitch_m
    lattice = lattice_of(rig)
    place = np.stack([lattice.col_px, lattice.row_px], axis=1)
    hidden = hide_truth(capture)
    start = time.process_time()
    found = run_estimator(label, hidden)
    spent = time.process_time() - start
    moved = np.asarray(capture["truth_slope"].values) * per_rad
    valid = np.asarray(found["valid"].values, bool)
    spot = np.asarray(found["spot"].values) - place
    known = valid[..., None] if valid.ndim == 2 else valid
    half = 0.5 * rig.lenslets.pitch_m / rig.camera.pixel_pitch_m
    error = np.where(known, np.clip(np.nan_to_num(spot - moved), -half, half), -moved)
    return error, ~np.broadcast_to(known, error.shape), 1e3 * spent / len(moved)


def _json(capture: xr.Dataset) -> Any:
    scene = capture.attrs["truth_scene"]
    return json.loads(scene) if isinstance(scene, str) else scene


def _labels(name: str) -> list[str]:
    return [f"{name}[{','.join(filter(None, (option, f'least_sigmas={_LEAST}')))}]" for option in OPTIONS[name]]


def _rms(values: Float) -> float:
    return float(np.sqrt((values**2).mean()))


def chosen(name: str, captures: Sequence[xr.Dataset]) -> str:
    """The label of a centroider's options with least rms error in captures of `dev` seeds."""
    labels = _labels(name)
    if len(labels) == 1:
        return labels[0]
    return min(labels, key=lambda label: _rms(np.stack([errors_of(label, one)[0] for one in captures])))


def rows_of(cell: Cell, names: Sequence[str] = tuple(OPTIONS)) -> Iterator[dict[str, Any]]:
    """Lines of the table for one cell: every centroider with its options chosen on `dev` seeds, measured on the others."""
    dev, test = ([captured(cell, seed) for seed in seeds] for seeds in (DEV, TEST))
    bound = np.stack([bounds_of(one)["spot"].sigma for one in test])
    moved = np.stack([one["truth_slope"].values for one in test]) * _per_rad(test[0])
    rng = np.random.Generator(np.random.PCG64(7))
    for name in names:
        label = chosen(name, dev)
        parts = [errors_of(label, one) for one in test]
        error = np.stack([part[0] for part in parts])
        each = (error**2).mean(axis=-1).ravel()
        draws = np.sqrt(each[rng.integers(0, each.size, (1000, each.size))].mean(axis=1)) / _rms(bound)
        low, high = np.percentile(draws, [2.5, 97.5])
        yield {
            "width_px": cell.width_px, "read_noise_e": cell.read_noise_e, "flux": cell.flux, "estimator": name, "label": label,
            "lost": float(np.stack([part[1] for part in parts]).mean()), "rms_px": _rms(error), "bound_px": _rms(bound),
            "ratio": _rms(error) / _rms(bound), "ratio_lo": float(low), "ratio_hi": float(high),
            "left": _rms(moved) / _rms(bound), "cpu_ms": float(np.median([part[2] for part in parts])),
        }  # fmt: skip


def _per_rad(capture: xr.Dataset) -> float:
    rig = wavefront_rig(Scene.model_validate(_json(capture)))
    return rig.lenslets.focal_length_m / rig.camera.pixel_pitch_m


def claims(rows: Sequence[dict[str, Any]]) -> list[tuple[str, str, str]]:
    """(claim, verdict, figures) of Thomas et al. 2006 on this table, at their read noise of 3 e and every width of the spot.

    "contradicted" where the intervals exclude the claim at every width, "trend" where they exclude its opposite, else
    "undetermined". Whether a centroider works rests on how far spots move: with errors as they are here it must hold, or fail, for
    moves up to half a pitch as well.
    """
    made: dict[str, list[tuple[str, str]]] = {}
    low, high, old = min(FLUX), max(FLUX), ("spot-quad", "spot-weighted", "spot-threshold", "spot-correlation")
    for width in WIDTH_PX:
        at = {(r["flux"], r["estimator"]): r for r in rows if r["read_noise_e"] == 3.0 and r["width_px"] == width}
        quad, weighted, threshold, correlation = (at[low, name] for name in old)
        bright = [at[high, name] for name in old]
        works = [_below(r, r["left"] * far) for r in (quad, weighted) for far in (1.0, 0.5 / _MOVE)]
        for claim, verdict, told in (
            ("at very low flux quad cell and weighted centroid have least noise",
             _apart([quad, weighted], [threshold, correlation]), _told([quad, weighted, threshold, correlation])),
            ("both work with 10 photons at a read noise of 3 e", _same(works),
             _told([quad, weighted]) + f"; spots left where they were {quad['left']:.2f}"),
            ("at high flux centre of gravity and correlation are better than the quad cell",
             _apart([bright[2], bright[3]], [bright[0]]), _told(bright)),
        ):  # fmt: skip
            made.setdefault(claim, []).append((verdict, f"{width:g} px: {told}"))
    return [(claim, _same([v for v, _ in parts]), "; ".join(t for _, t in parts)) for claim, parts in made.items()]


def _told(rows: Sequence[dict[str, Any]]) -> str:
    return ", ".join(f"{r['estimator']} {r['ratio']:.2f} [{r['ratio_lo']:.2f}, {r['ratio_hi']:.2f}]" for r in rows)


def _same(verdicts: Sequence[str]) -> str:
    return verdicts[0] if len(set(verdicts)) == 1 else "undetermined"


def _apart(better: Sequence[dict[str, Any]], worse: Sequence[dict[str, Any]]) -> str:
    if all(b["ratio_hi"] < w["ratio_lo"] for b in better for w in worse):
        return "trend"
    # What is no better than leaving spots where they were has not measured, and contradicts nothing.
    measured = [w for w in worse if w["ratio_hi"] < w["left"]]
    return "contradicted" if any(b["ratio_lo"] > w["ratio_hi"] for b in better for w in measured) else "undetermined"


def _below(row: dict[str, Any], limit: float) -> str:
    if row["ratio_hi"] < limit:
        return "trend"
    return "contradicted" if row["ratio_lo"] > limit else "undetermined"


def drawn(rows: Sequence[dict[str, Any]], path: str) -> None:
    """A chart of error over bound against light, a panel per width and read noise."""
    import altair as alt
    import pandas as pd

    table = pd.DataFrame(rows)
    base = alt.Chart(table).mark_line(point=True).encode(
        x=alt.X("flux:Q", scale=alt.Scale(type="log"), title="photoelectrons of a spot"),
        y=alt.Y("ratio:Q", scale=alt.Scale(type="log", domain=[0.8, 300]), title="rms error over bound"),
        color=alt.Color("estimator:N", scale=alt.Scale(scheme="tableau20"), title="centroid"),
    )  # fmt: skip
    panel = base.properties(width=230, height=190)
    panel.facet(
        row=alt.Row("width_px:Q", title="first zero of the spot, px"),
        column=alt.Column("read_noise_e:Q", title="read noise, e"),
    ).save(path)


def main(arguments: Sequence[str]) -> int:
    """Print the table and the claims' verdicts; with file names also write the table and a chart."""
    made: list[dict[str, Any]] = []
    for name in OPTIONS:
        errors_of(name, captured(Cell(WIDTH_PX[0], 3.0, 1000.0), 1))  # compile kernels: no time of theirs is counted
    print("width px  read e     flux   bound px     left " + "".join(f"{name[5:]:>12}" for name in OPTIONS))
    for width, read, flux in itertools.product(WIDTH_PX, READ_NOISE, FLUX):
        rows = list(rows_of(Cell(width, read, flux)))
        made += rows
        head = f"{width:8g} {read:7g} {flux:8g} {rows[0]['bound_px']:10.3g} {rows[0]['left']:8.2f} "
        print(head + "".join(f"{row['ratio']:12.2f}" for row in rows), flush=True)
    for claim, verdict, figures in claims(made):
        print(f"{verdict}: {claim}: {figures}")
    if arguments:
        Path(arguments[0]).write_text(to_csv(made, COLUMNS), encoding="utf-8")
    if len(arguments) > 1:
        drawn(made, arguments[1])
    return 0


if __name__ == "__main__":
    raise SystemExit(main(sys.argv[1:]))
