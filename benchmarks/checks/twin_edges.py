"""Is the certificate sound on a recording that holds edges, whose target nobody surveyed?

    python -m beambench.benchmarks.checks.twin_edges --rigs 20

The recording is that of the plan `gated-demo`: a sphere before a wall, forty delays, six times, by rigs whose gain, pulse,
energy, read noise and time zero are hidden, as `record --rig emulator` makes it. The rig file comes from the first half:

- with the rig as calibrated: no clause may fail, and χ² of the pixels with one echo must pass;
- with a rig that is wrong in one planted way: the clause that names it must fail.

The recording is too short for 3 % of the gain, and shows neither time zero nor water: `checks.twin` plants these. Intervals
are exact (Clopper and Pearson).
"""

from __future__ import annotations

import argparse
import json
import time
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import xarray as xr

from ...captures.hide import hide_truth
from ...captures.recording.plan import load_plan
from ...estimators.calibration.gated_scan import read_scan, scan_half
from ...generator.emulators.gated_sight import hidden
from ...generator.generate import generate
from ...scenes.load import load_scene
from ...scenes.rigs.gated import gated_rig
from ..twin.clause import Ask
from ..twin.gated import calibrated_half, read_with_rig_of
from ..twin.gated_render import settings_of
from ..twin.gated_rig import stretched, twin_scene
from ..twin.rig_file import TwinRig
from ..twin.run import certified
from .twin import exact_interval

__all__ = ["FAULTS", "main", "recording", "tried"]


def _longer(rig: TwinRig) -> TwinRig:
    return replace(rig, values={**rig.values, "rig.laser.pulse": stretched(rig.values["rig.laser.pulse"], 1.05)})


def _noisier(rig: TwinRig) -> TwinRig:
    path = "rig.detector.read_noise_e"
    return replace(rig, values={**rig.values, path: 1.1 * rig.values[path]})


#: Fault -> (the clause that names it, change of the rig).
FAULTS: dict[str, tuple[str, Callable[[TwinRig], TwinRig]]] = {
    "pulse +5 %": ("pulse", _longer),
    "read noise +10 %": ("read-noise", _noisier),
}


def recording(seed: int) -> xr.Dataset:
    """A recording of the plan by a rig with hidden values, without truth and with the rig that the plan declares."""
    planned = load_plan("gated-demo")
    scan = [slot.settings["delay"]["delay_s"] for slot in planned.slots if slot.part == "scan"]
    delays = list(dict.fromkeys(scan))
    dark = sum(slot.part == "dark" for slot in planned.slots)
    scene = hidden(planned.scene, seed)
    given = {"kind": "listed", "values_s": delays, "repeats": len(scan) // len(delays), "laser_off": dark}
    made = generate(load_scene(scene, {"rig.delays": given}), seed=seed)
    shift = float(planned.declared["t0_s"]) - gated_rig(scene).t0_s
    made = made.assign_coords(delay=("slice", made["delay"].values + shift, made["delay"].attrs))
    made.attrs["rig"] = json.dumps(planned.declared)
    return hide_truth(made)


def tried(seed: int, draws: int, faults: tuple[str, ...] = tuple(FAULTS)) -> tuple[dict[str, dict[str, str]], float]:
    """The verdicts of one rig by what is wrong with it ("right": nothing), and the share of pixels in which χ² was judged."""
    capture = recording(seed)
    first = scan_half(read_scan(capture), 0)
    base = twin_scene(capture, None, {}, settings_of(first))
    right, _ = calibrated_half(read_with_rig_of(base, first), None, base)
    verdicts: dict[str, dict[str, str]] = {}
    coverage = 1.0
    for name, rig in {"right": right, **{name: FAULTS[name][1](right) for name in faults}}.items():
        found = certified(capture, Ask(rig, None, None, draws, 1000 * seed + 1, ()))
        verdicts[name] = {one.clause.name: str(one.verdict) for one in found.clauses}
        if name == "right":
            coverage = next(one.coverage for one in found.clauses if one.clause.name == "residual")
    return verdicts, coverage


def _line(text: str, held: list[bool]) -> str:
    low, high = exact_interval(sum(held), len(held))
    return f"{text:<44} {sum(held):4d} of {len(held):4d}   95 % interval {100 * low:.1f} … {100 * high:.1f} %"


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--rigs", type=int, default=20, help="emulated rigs")
    parser.add_argument("--draws", type=int, default=40, help="simulated recordings of a twin")
    parser.add_argument("--from", dest="start", type=int, default=1, help="number of the first rig; 0 hides nothing")
    given = parser.parse_args()
    began = time.perf_counter()
    found: list[dict[str, Any]] = []
    for number in range(given.start, given.start + given.rigs):
        verdicts, coverage = tried(number, given.draws)
        found.append(verdicts)
        wrong = [name for name, verdict in verdicts["right"].items() if verdict == "fail"]
        missed = [name for name, (clause, _) in FAULTS.items() if verdicts[name][clause] != "fail"]
        spent = time.perf_counter() - began
        print(
            f"rig {number}: fails though right {wrong or '–'}, missed {missed or '–'}; χ² judged in {100 * coverage:.1f} % of "
            f"the pixels; {spent:.0f} s", flush=True,
        )  # fmt: skip
    print(_line("right: no clause fails", ["fail" not in one["right"].values() for one in found]))
    print(_line("right: χ² of a pixel passes", [one["right"]["residual"] == "pass" for one in found]))
    for name, (clause, _) in FAULTS.items():
        print(_line(f"{name}: {clause} fails", [one[name][clause] == "fail" for one in found]))


if __name__ == "__main__":
    main()
