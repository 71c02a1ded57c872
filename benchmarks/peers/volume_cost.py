"""Cost of the `full` rung in homogeneous water against mitransient's volumetric integrator, and of `scatter` against `full`.

R1 and R2 are two `full` stacks of other seeds with four times the largest sample count (the peer cannot give a reference:
it needs 10⁷ paths per pixel for one per cent); ε² = Σ(X − R1)(X − R2)/ΣR1R2 is unbiased by their noise. Both sides run at
four sample counts × five seeds; ε² = floor² + v/N and cost = a + qN are fitted, with floor zero for the peer, and costs are
compared at the same ε. Beyond 4 × its largest count the cost of the peer is a lower bound. The cost is that of the whole
stack in CPU seconds of all threads; scenes are loaded and kernels compiled beforehand. Against `scatter` the largest sample
count is the one that a pilot predicts for ε, 2400 at most; `scatter` has a constant cost (the tables of the water), so
that its gain grows with the image.

    python -m beambench.benchmarks.peers.volume_cost [--quick]
"""

from __future__ import annotations

import argparse
import json
import sys
import tempfile
import time
from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from ...generator.gated.direct import render_direct
from ...generator.gated.full import Limits, Slices, render_remainder
from ...generator.gated.gates import gate_offset
from ...generator.gated.scatter import render_scatter, scattered_electrons
from ...generator.gated.stack import expected_electrons, slice_coordinates, slice_settings
from ...generator.gated.view import view_of
from ...generator.paths.world import PathWorld
from ...optics.constants import C_M_PER_S
from ...scenes.load import load_scene
from ...scenes.scene import Scene
from .mitransient_direct import equal_error_cost, squared_error
from .mitransient_volume import MitransientVolume

__all__ = ["compare_with_peer", "compare_with_scatter", "timed", "water_scene"]

Stack = NDArray[np.float32]
Made = TypeVar("Made")

#: a, b [1/m] (Petzold 1972, 514 nm) and the wall's range [m]. At .9 m of harbour water the small-angle picture of
#: `scatter` errs by 1.1 %; at .8 m it is valid at 1 %.
WATERS = {
    "clear": (0.114, 0.037, 2.0),
    "coastal": (0.179, 0.219, 2.0),
    "harbour": (0.366, 1.824, 0.9),
    "near-harbour": (0.366, 1.824, 0.8),
}
EPSILONS = (0.1, 0.03, 0.01)
GOAL_PEER, GOAL_SCATTER = 3.0, 100.0


def water_scene(name: str, size: int = 16) -> Scene:
    """A wall across the field of view in one of `WATERS`, a lamp beside a camera of ±17°, 24 gates around the wall."""
    absorption, scattering, distance = WATERS[name]
    per_metre = 1.36 / C_M_PER_S
    first, last = 2 * (distance - 0.5), 2 * (distance + 0.3)
    return load_scene(
        "flat-wall",
        {
            "name": f"{name}-wall",
            "target.0.shape.center_m": [0.0, 0.0, distance],
            "medium": {
                "name": name,
                "index": {"kind": "explicit", "phase": 1.34, "group": 1.36},
                "absorption_per_m": absorption,
                "scattering_per_m": scattering,
                "phase_function": {"kind": "fournier-forand", "index": 1.1, "slope": 3.58},
            },
            "rig.camera.rows": size,
            "rig.camera.cols": size,
            "rig.camera.focal_length_m": 13.0e-6 * size / 0.6,
            "rig.laser.position_m": [0.1, 0.0, 0.0],
            "rig.delays.start_s": first * per_metre,
            "rig.delays.step_s": (last - first) * per_metre / 24,
            "rig.delays.count": 24,
        },
    )


class _Rungs:
    """Stacks of one scene."""

    def __init__(self, scene: Scene) -> None:
        self.scene, self.coords = scene, slice_coordinates(scene)
        self.settings = slice_settings(scene, self.coords, 0, 0)
        self.slices = Slices(*self.settings, self.coords["gate"], gate_offset(scene))
        self.world = PathWorld.of(scene, view_of(scene))

    def direct(self, rtol: float) -> Stack:
        return self._signal(render_direct(self.scene, rtol))

    def _signal(self, direct: Any) -> Stack:
        light, ambient = expected_electrons(self.scene, direct, self.coords, 0, 0)
        return light - ambient.astype(np.float32)[:, None, None]

    def full(self, samples: int, seed: int, rtol: float = 3e-3) -> Stack:
        direct = self.direct(rtol)
        limits = Limits(most_samples=samples)
        return (
            direct
            + render_remainder(self.scene, direct, self.slices, 1e-9, seed, 0, limits=limits, world=self.world).light
        )

    def scatter(self, rtol: float) -> Stack:
        found = render_scatter(self.scene, rtol)
        return self._signal(found.direct) + scattered_electrons(self.scene, found, self.coords["gate"], *self.settings)


def timed(make: Callable[[], Made]) -> tuple[Made, float]:
    """What `make` makes, and its CPU seconds of all threads."""
    start = time.process_time()
    stack = make()
    return stack, time.process_time() - start


def _measure(
    make: Callable[[int, int], Stack], counts: Sequence[int], seeds: int, refs: tuple[Stack, Stack]
) -> dict[str, Any]:
    make(min(counts), 999)
    rows = []
    for seed in range(seeds):
        for n in counts:
            stack, seconds = timed(partial(make, n, seed))
            rows.append((n, squared_error(stack, *refs), seconds))
    columns = np.array(rows, dtype=float).T
    return dict(zip(("n", "e2", "cost"), columns, strict=True))


def _cost_at(run: dict[str, Any], epsilon: float, floor: bool) -> tuple[float, str]:
    """CPU seconds at ε. With `floor`, ε² = floor² + v/N is fitted; without, the floor is zero, in favour of an unbiased
    estimate whose outliers a fit would take for a floor. "at least": more than 4 × the largest count is needed."""
    n, e2, cost = run["n"], run["e2"], run["cost"]
    if np.mean(e2[n == n.min()]) <= epsilon**2:
        return float(np.median(cost[n == n.min()])), "fewest samples"
    if floor:
        return equal_error_cost(n, e2, cost, epsilon)[::2]
    q, a = np.polyfit(n, cost, 1)
    needed = float(np.mean(e2 * n)) / epsilon**2
    beyond = needed > 4 * n.max()
    return float(max(a, 0.0) + q * min(needed, 4 * n.max())), "at least" if beyond else ""


def compare_with_peer(name: str, counts: Sequence[int], peer_counts: Sequence[int], seeds: int) -> dict[str, Any]:
    """CPU seconds of both at each ε, and their ratio; "at least" where the peer does not reach ε within 4 × its samples."""
    scene = water_scene(name)
    rungs = _Rungs(scene)
    refs = (rungs.full(4 * max(counts), 10_001, 5e-4), rungs.full(4 * max(counts), 10_002, 5e-4))
    ours = _measure(lambda n, seed: rungs.full(n, seed), counts, seeds, refs)
    with tempfile.TemporaryDirectory() as folder:
        peer = MitransientVolume(scene, rungs.slices, folder, divisor=4)
        theirs = _measure(peer.run, peer_counts, seeds, refs)
    found: dict[str, Any] = {"scene": scene.name, "goal": GOAL_PEER}
    for side, run in (("ours", ours), ("peer", theirs)):
        found[side] = {
            int(n): {
                "epsilon": float(np.sqrt(max(np.mean(run["e2"][run["n"] == n]), 0.0))),
                "cpu_s": float(np.median(run["cost"][run["n"] == n])),
            }
            for n in np.unique(run["n"])
        }
    for epsilon in EPSILONS:
        (a, remark), (b, peer_remark) = _cost_at(ours, epsilon, True), _cost_at(theirs, epsilon, False)
        found[f"at_{epsilon:g}"] = {
            "ours_cpu_s": a, "ours_remark": remark, "peer_cpu_s": b, "peer_remark": peer_remark, "ratio": b / a,
            "met": bool(b / a >= GOAL_PEER) and remark in ("", "fewest samples"),
        }  # fmt: skip
    return found


def compare_with_scatter(name: str, seeds: int, size: int, most: int = 2400, epsilon: float = 0.01) -> dict[str, Any]:
    """CPU seconds of `full` at ε over those of `scatter`, where the error of `scatter` itself is below ε."""
    rungs = _Rungs(water_scene(name, size))
    least = 16 * max(4096 // size**2, 1)  # one round of `render_remainder`: small images get several lanes a pixel
    pilot = 2 * least
    rungs.full(pilot, 998)
    one, two, three = (rungs.full(pilot, seed, 0.3 * epsilon) for seed in (20_001, 20_002, 20_003))
    needed = pilot * max(squared_error(one, two, three), 0.0) / epsilon**2
    top = int(np.clip(1.2 * needed, pilot, most))
    counts = sorted({max(top // k, least) for k in (8, 4, 2, 1)})
    # Over a large image the noise of the references averages out.
    refs = tuple(rungs.full(top * (4 if size < 64 else 1), seed, 5e-4) for seed in (10_001, 10_002))
    full = _measure(lambda n, seed: rungs.full(n, seed, 0.3 * epsilon), counts, seeds, (refs[0], refs[1]))
    rungs.scatter(0.3 * epsilon)
    runs = [timed(lambda: rungs.scatter(0.3 * epsilon)) for _ in range(seeds)]
    error = float(np.sqrt(max(squared_error(runs[0][0], refs[0], refs[1]), 0.0)))
    seconds = float(np.median([s for _, s in runs]))
    cost, remark = _cost_at(full, epsilon, True)
    return {
        "scene": f"{name}-wall", "size": size, "goal": GOAL_SCATTER, "epsilon": epsilon, "scatter_epsilon": error,
        "valid": error <= epsilon, "samples": counts,
        "scatter_cpu_s": seconds, "full_cpu_s": cost, "ratio": cost / seconds, "remark": remark,
        "met": bool(error <= epsilon and remark in ("", "fewest samples") and cost / seconds >= GOAL_SCATTER),
    }  # fmt: skip


def main(argv: Sequence[str] | None = None) -> int:
    """Command line of the comparison."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--quick", action="store_true", help="fewer samples: a smoke test, not a measurement")
    parser.add_argument("--waters", nargs="+", default=list(WATERS), choices=list(WATERS))
    parser.add_argument(
        "--sizes", nargs="+", type=int, default=None, help="pixels along a side, for `scatter` (16 64 128)"
    )
    parser.add_argument("--only", choices=("peer", "scatter"), default=None)
    parser.add_argument("--out", type=Path, default=None)
    options = parser.parse_args(argv)
    counts, peer_counts, seeds = [256, 1024, 4096, 16384], [256, 1024, 4096, 16384], 5
    if options.quick:
        counts, peer_counts, seeds = [256, 1024], [256, 1024], 2
    sizes = options.sizes or ([16] if options.quick else [16, 64, 128])
    result: dict[str, Any] = {"peer": [], "scatter": []}
    for name in options.waters:
        if options.only != "scatter" and not name.startswith("near-"):
            result["peer"].append(compare_with_peer(name, counts, peer_counts, seeds))
            print(json.dumps(result["peer"][-1], indent=1), flush=True)
        for size in sizes if options.only != "peer" else ():
            found = compare_with_scatter(name, seeds, size, 160 if options.quick else 2400)
            result["scatter"].append(found)
            print(json.dumps(found, indent=1), flush=True)
    if options.out is not None:
        options.out.write_text(json.dumps(result, indent=1), encoding="utf-8")
    return 0


if __name__ == "__main__":
    sys.exit(main())
