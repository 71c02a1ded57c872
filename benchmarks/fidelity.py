"""Every rung of the ladder on a family of scenes: cost, error, task error, and the choice between rungs.

The quantity is expected photoelectrons per pixel and gate, without ambient light. R₁ and R₂ are full references with
seeds of their own; ε² = Σ(X − R₁)(X − R₂)/ΣR₁R₂ is free of their noise. Its interval is a bootstrap over pixels. Both
references are this project's path tracer: they judge what a rung leaves out, and not the tracer, which the tests hold
against quadratures and independent walks.

The task error is the bias that the rung's error causes in the time of a maximum-likelihood estimate, J⁻¹Σ∂S·ΔS/V, in
units of its bound J^(−1/2): the root mean square over the pixels that see the target.

    python -m beambench.benchmarks.fidelity [--scenes 20] [--seed 1] [--out FOLDER]
"""

from __future__ import annotations

import argparse
import json
import sys
import tempfile
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..generator.choose import Choice, choose, stack_error
from ..generator.direct import DirectScene, render_direct
from ..generator.full import Limits, Slices, gate_offset, render_remainder
from ..generator.generate import expected_electrons, slice_coordinates, slice_settings
from ..generator.path_world import PathWorld
from ..generator.scatter import render_scatter, scattered_electrons
from ..scenes.scene import Scene, gated_rig
from .fidelity_family import family
from .files import write_json, write_text
from .output import default_folder
from .tables import to_csv

__all__ = ["COLUMNS", "measure_scene", "run_fidelity", "summarise", "task_error"]

Float = NDArray[np.float64]
Stack = NDArray[np.float32]

COLUMNS = (
    "modality", "scene", "rung", "cpu_s", "rel_error", "lo", "hi", "task_error", "predicted_error", "chosen", "verdict",
)  # fmt: skip

RTOLS = (0.1, 0.03, 0.01)
_REFERENCE_RTOL = 0.01
_REFERENCE = Limits()


def task_error(scene: Scene, x: Stack, truth: Stack, slope: Stack, background_e: Float) -> float:
    """rms over pixels of |Σ ∂S·ΔS/V|/√J, J = Σ(∂S)²/V: bias of the time in units of its bound.

    Main arguments:
        x, truth: the rung's stack and the true one (slices, rows, cols); slope: dS/dτ of the target's own return.
        background_e: ambient and dark electrons per slice, which add to the variance V.
    """
    read = gated_rig(scene).detector.read_noise_e ** 2
    v = np.maximum(truth.astype(np.float64), 0.0) + background_e[:, None, None] + read
    d = slope.astype(np.float64)
    information = np.sum(d * d / v, axis=0)
    pull = np.sum(d * (x.astype(np.float64) - truth) / v, axis=0)
    seen = information > 0
    return float(np.sqrt(np.mean(pull[seen] ** 2 / information[seen]))) if seen.any() else 0.0


class _Rungs:
    """Stacks of one scene by each rung."""

    def __init__(self, scene: Scene) -> None:
        self.scene, self.coords = scene, slice_coordinates(scene)
        delay, energy = slice_settings(scene, self.coords, 0, 0)
        self.settings = (delay, energy)
        self.slices = Slices(delay, energy, self.coords["gate"], gate_offset(scene))
        self.world = PathWorld.of(scene)
        _, self.ambient = expected_electrons(scene, render_direct(scene, 0.1), self.coords, 0, 0)

    def _stack(self, direct: DirectScene) -> Stack:
        light, ambient = expected_electrons(self.scene, direct, self.coords, 0, 0)
        return light - ambient.astype(np.float32)[:, None, None]

    def direct(self, rtol: float) -> Stack:
        return self._stack(render_direct(self.scene, rtol))

    def scatter(self, rtol: float) -> Stack:
        found = render_scatter(self.scene, rtol)
        return self._stack(found.direct) + scattered_electrons(self.scene, found, self.coords["gate"], *self.settings)

    def full(self, rtol: float, seed: int, limits: Limits) -> Stack:
        # Both references share the direct rung's sub-pixel rays, so these must not err visibly.
        direct = self.direct(0.1 * rtol)
        return (
            direct
            + render_remainder(self.scene, direct, self.slices, rtol, seed, 0, limits=limits, world=self.world).light
        )

    def slope(self) -> Stack:
        """dS/dτ of the direct return [1/s] by central differences over a tenth of a delay step."""
        step = 0.1 * gated_rig(self.scene).delays.step_s
        stacks = []
        direct = render_direct(self.scene, 3e-3)
        for sign in (1.0, -1.0):
            coords = self.coords | {"actual": self.coords["actual"] - sign * step}
            stacks.append(expected_electrons(self.scene, direct, coords, 0, 0)[0])
        return (stacks[0] - stacks[1]) / np.float32(2 * step)


def _timed(make: Callable[[], Stack]) -> tuple[Stack, float]:
    start = time.process_time()
    stack = make()
    return stack, time.process_time() - start


def measure_scene(scene: Scene, seed: int, rtols: Sequence[float] = RTOLS) -> list[dict[str, Any]]:
    """Rows of fidelity.csv of one scene. `chosen` and `verdict` join one word per rtol: whether `auto` took the rung, and
    whether that was within rtol ("pass", "fail"); "dearer" where a cheaper rung would have passed, "unreached" where none
    did."""
    rungs = _Rungs(scene)
    finest = min(rtols)
    choices = {rtol: choose(scene, rtol, seed, 0) for rtol in rtols}
    one, two = (rungs.full(_REFERENCE_RTOL, 1000 + seed + i, _REFERENCE) for i in (0, 500_000))
    truth = 0.5 * (one + two)
    slope = rungs.slope()
    detector = gated_rig(scene).detector
    background = rungs.ambient + detector.dark_current_e_per_s * detector.exposure_s
    makers: dict[str, Callable[[], Stack]] = {"direct": lambda: rungs.direct(0.3 * finest)}
    if scene.medium.scattering_per_m > 0:
        makers["scatter"] = lambda: rungs.scatter(0.3 * finest)
    makers["full"] = lambda: rungs.full(finest, seed, _REFERENCE)
    rows, passes = [], {}
    for rung, make in makers.items():
        if rung != "full":
            make()  # compiled and loaded before it is timed
        stack, seconds = _timed(make)
        error, low, high = stack_error(stack, one, two)
        passes[rung] = error
        rows.append(
            {
                "modality": "gated", "scene": scene.name, "rung": rung, "cpu_s": seconds, "rel_error": error, "lo": low,
                "hi": high, "task_error": task_error(scene, stack, truth, slope, background),
                "predicted_error": choices[finest].predicted.get(rung, 0.0),
                "chosen": ";".join(f"{r:g}" for r in rtols if choices[r].rung == rung),
                "verdict": "",
            }
        )  # fmt: skip
    for row in rows:
        row["verdict"] = ";".join(
            f"{r:g}:{_verdict(choices[r], passes, r)}" for r in rtols if choices[r].rung == row["rung"]
        )
    return rows


def _verdict(choice: Choice, errors: dict[str, float], rtol: float) -> str:
    cheapest = next((rung for rung, error in errors.items() if error <= rtol), None)
    if errors[choice.rung] > rtol:
        return "unreached" if cheapest is None else "fail"
    return "pass" if choice.rung == cheapest else "dearer"


def summarise(rows: Sequence[dict[str, Any]]) -> dict[str, Any]:
    """Shares over scenes and rtols: within rtol, cheapest passing rung taken; cost of three policies; median |log₁₀ predicted/
    measured| of the rungs below `full` whose error is above 1e-4."""
    words = [w.split(":")[1] for row in rows for w in row["verdict"].split(";") if w]
    cost: dict[str, float] = {}
    for rung in ("direct", "full"):
        cost[f"always {rung}"] = sum(r["cpu_s"] for r in rows if r["rung"] == rung)
    cost["auto, mean over rtol"] = sum(r["cpu_s"] * len(r["chosen"].split(";")) for r in rows if r["chosen"]) / max(
        len({w.split(":")[0] for row in rows for w in row["verdict"].split(";") if w}), 1
    )
    ratios = [
        abs(np.log10(r["predicted_error"] / r["rel_error"]))
        for r in rows
        if r["rung"] != "full" and r["rel_error"] > 1e-4 and r["predicted_error"] > 0
    ]
    return {
        "decisions": len(words),
        "within rtol": 1.0 - (words.count("fail") + words.count("unreached")) / max(len(words), 1),
        "cheapest passing rung taken": words.count("pass") / max(len(words), 1),
        "median |log10 predicted/measured|": float(np.median(ratios)) if ratios else None,
        "cost in CPU seconds": cost,
        "chosen": {rung: sum(len(r["chosen"].split(";")) for r in rows if r["rung"] == rung and r["chosen"])
                   for rung in ("direct", "scatter", "full")},
    }  # fmt: skip


def run_fidelity(
    scenes: int = 20, seed: int = 1, out: str | Path | None = None, progress: Callable[[str], None] | None = None
) -> Path:
    """Measure a family of scenes and write fidelity.csv, fidelity.json (shares and costs) and fidelity.svg; the folder."""
    folder = Path(out) if out is not None else default_folder("fidelity")
    folder.mkdir(parents=True, exist_ok=True)
    rows: list[dict[str, Any]] = []
    with tempfile.TemporaryDirectory() as meshes:
        for scene in family(seed, scenes, Path(meshes)):
            found = measure_scene(scene, seed)
            rows += found
            if progress is not None:
                shown = ", ".join(f"{r['rung']} {r['rel_error']:.2g} ({r['verdict']})" for r in found)
                progress(f"{scene.name}: {shown}")
    write_text(folder / "fidelity.csv", to_csv(rows, COLUMNS))
    write_json(folder / "fidelity.json", summarise(rows))
    _chart(rows, folder / "fidelity.svg")
    return folder


def _chart(rows: list[dict[str, Any]], path: Path) -> None:
    """Cost against error of every rung and scene, both axes logarithmic."""
    import altair as alt
    import pandas as pd

    table = pd.DataFrame(rows)
    table["medium"] = table["scene"].str.split("-").str[0]
    table = table[table["rel_error"] > 0]
    chart = (
        alt.Chart(table)
        .mark_point(filled=True, size=40)
        .encode(
            x=alt.X("cpu_s", title="cost [CPU s]").scale(type="log"),
            y=alt.Y("rel_error", title="relative error of the stack").scale(type="log"),
            color=alt.Color("rung").scale(domain=["direct", "scatter", "full"]),
            shape="medium",
        )
        .properties(width=480, height=320)
    )
    chart.save(str(path))


def main(argv: Sequence[str] | None = None) -> int:
    """Command line of the measurement."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--scenes", type=int, default=20)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--out", default=None)
    options = parser.parse_args(argv)
    folder = run_fidelity(options.scenes, options.seed, options.out, lambda line: print(line, flush=True))
    print(json.dumps(json.loads((folder / "fidelity.json").read_text(encoding="utf-8")), indent=1))
    return 0


if __name__ == "__main__":
    sys.exit(main())
