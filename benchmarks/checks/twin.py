"""Does the certificate pass right twins, and does it name what is wrong with a wrong one?

    python -m beambench.benchmarks.checks.twin --rigs 200 --draws 40 --journal twin.jsonl

Emulated rigs: each has hidden parameters, drawn about those that are declared (gain ± 5 %, length of the pulse ± 5 %, time
zero ± 50 ps, read noise ± 10 %, the energy of frames 0 or 1 %), a gated camera with a tube of F² = 1.8, and a wall behind
water that scatters. A recording is drawn, one half of it calibrates the twin's rig, and the certificate judges the other
half:

- with the twin as calibrated: no clause may fail;
- with the twin's rig wrong in one planted way: the clause that names it must fail. Such a twin is drawn `--least` times; where its
  clause then fails by twice the half width of its interval, it is drawn no further, for the time's sake.

The expectation is rendered once by the generator; rigs differ from it by their own pulse, gate and time zero
(`expected_electrons`), and by noise. The estimators' clauses are left out: what they find follows from these. Intervals are
exact (Clopper and Pearson).

Each rig is a line of the journal, and rigs that are there are not tried again: the same command goes on where it was stopped.
"""

from __future__ import annotations

import argparse
import json
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from ...estimators.calibration.gated_scan import DelayScan, scan_half
from ...generator.checked import checked
from ...generator.gated.expected import expect
from ...optics.constants import C_M_PER_S
from ...scenes.load import load_scene
from ...scenes.rigs.gated import gated_rig
from ..twin.clause import Evidence, Judged
from ..twin.gated import calibrated_half, frame_of, read_with_rig_of, unbiased
from ..twin.gated_clauses import CLAUSES
from ..twin.gated_measure import signal_statistics
from ..twin.gated_render import GatedTwin
from ..twin.gated_rig import Uncertain, stretched, uncertain_of
from ..twin.verdict import judged

__all__ = ["FAULTS", "Bench", "Outcome", "exact_interval", "main", "tried"]

#: Fault -> (the clause that names it, change of the twin).
FAULTS: dict[str, tuple[str, Callable[[GatedTwin], GatedTwin]]] = {}


@dataclass(frozen=True)
class Outcome:
    """Of one rig: verdicts of its clauses, by what is wrong with its twin ("right": nothing)."""

    verdicts: Mapping[str, Mapping[str, str]]


def _rig(change: Callable[[dict[str, Any]], None]) -> Callable[[GatedTwin], GatedTwin]:
    """A change of the twin's rig, as data."""

    def changed(twin: GatedTwin) -> GatedTwin:
        data = twin.scene.model_dump(mode="json")
        change(data["rig"])
        return replace(twin, scene=load_scene(data))

    return changed


def _fault(name: str, clause: str) -> Callable[[Callable[[dict[str, Any]], None]], None]:
    def add(change: Callable[[dict[str, Any]], None]) -> None:
        FAULTS[name] = (clause, _rig(change))

    return add


@_fault("gain +3 %", "gain")
def _gain(rig: dict[str, Any]) -> None:
    rig["detector"]["gain_dn_per_e"] *= 1.03


@_fault("pulse +5 %", "pulse")
def _pulse(rig: dict[str, Any]) -> None:
    rig["laser"]["pulse"] = stretched(rig["laser"]["pulse"], 1.05)


@_fault("t0 +20 ps", "t0")
def _t0(rig: dict[str, Any]) -> None:
    rig["t0_s"] += 20e-12


@_fault("read noise +10 %", "read-noise")
def _read_noise(rig: dict[str, Any]) -> None:
    rig["detector"]["read_noise_e"] *= 1.1


@_fault("excess noise left out", "excess")
def _excess(rig: dict[str, Any]) -> None:
    rig["detector"]["intensifier"]["excess_noise_factor"] = 1.0


def _clear_water(twin: GatedTwin) -> GatedTwin:
    return replace(twin, scattered=np.zeros_like(twin.scattered))


FAULTS["backscatter left out"] = ("backscatter", _clear_water)

_SETTINGS: dict[str, Any] = {
    "rig.camera.rows": 16, "rig.camera.cols": 16, "rig.camera.pixel_pitch_m": 52e-6,
    "rig.laser.pulse.fwhm_s": 0.8e-9,
    "rig.gates": [{"kind": "trapezoidal", "width_s": 1.5e-9, "rise_s": 0.3e-9, "fall_s": 0.4e-9, "transmission": 1.0}],
    "rig.detector.intensifier": {"gain": 1.0, "excess_noise_factor": 1.8, "phosphor_sigma_px": 0.0},
    "medium": {
        "name": "water", "index": {"kind": "explicit", "phase": 1.335, "group": 1.357}, "absorption_per_m": 0.02,
        "scattering_per_m": 0.04, "phase_function": {"kind": "henyey-greenstein", "g": 0.1},
    },
}  # fmt: skip


class Bench:
    """The nominal rig and its expectation, and the recordings of hidden rigs.

    Main arguments:
        electrons: photoelectrons of an open gate in the brightest pixel. repeats, dark: of a recording, both halves together.
        before: delays before the echo.
    """

    def __init__(self, *, electrons: float = 45.0, repeats: int = 192, dark: int = 192, before: int = 5) -> None:
        self.repeats, self.dark = repeats, dark
        scene = load_scene("flat-wall", _SETTINGS)
        echo = 2.0 * 5.0 * 1.357 / C_M_PER_S
        echoes = [float(t) for t in echo - 2.2e-9 + 0.15e-9 * np.arange(24)]
        early = [echoes[0] - 4.5e-9 + 0.4e-9 * k for k in range(before)]
        data = scene.model_dump(mode="json")
        data["rig"]["delays"] = {"kind": "listed", "values_s": early + echoes, "repeats": 1, "laser_off": 1}
        self.nominal = load_scene(data)
        made = expect(self.nominal, checked(self.nominal, seed=0, capture_key=1, fidelity="scatter", rtol=3e-3))
        rig = gated_rig(self.nominal)
        settings = np.array(early + echoes)
        returns = made.light.returns
        scale = electrons / float(returns.amplitude.max())
        light = replace(made.light, returns=replace(returns, amplitude=returns.amplitude * scale))
        shape = (rig.camera.rows, rig.camera.cols)
        none = np.zeros((len(settings), shape[0] * shape[1]), np.float32)
        self.twin = GatedTwin(self.nominal, light, none, Uncertain({}, {}), None, made.truth, settings, shape)
        whole = made.electrons[: len(settings)].reshape(len(settings), -1) * scale
        # What water adds, from the scene's own light: expected − own, both without ambient light, which is dark here.
        self.scattered = np.maximum(whole - self.twin.expected_dn(), 0.0).astype(np.float32)
        self.range_m = np.asarray(made.truth["truth_range"], np.float64)

    def hidden(self, seed: int) -> GatedTwin:
        """A rig with hidden parameters."""
        draw = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(0x7716,)))
        data = self.nominal.model_dump(mode="json")
        rig = data["rig"]
        rig["detector"]["gain_dn_per_e"] *= 1 + 0.05 * draw.uniform(-1, 1)
        rig["detector"]["read_noise_e"] *= 1 + 0.1 * draw.uniform(-1, 1)
        rig["laser"]["pulse"] = stretched(rig["laser"]["pulse"], 1 + 0.05 * draw.uniform(-1, 1))
        rig["t0_s"] += 50e-12 * draw.uniform(-1, 1)
        rig["laser"]["energy_fluctuation"] = 0.01 * float(draw.integers(2))
        return replace(self.twin, scene=load_scene(data), scattered=self.scattered)

    def recording(self, seed: int) -> DelayScan:
        """A recording of a hidden rig, as the laboratory declares it: nominal values, time zero 0."""
        drawn = self.hidden(seed).draw(10**6 + seed, self.repeats, self.dark)
        return replace(drawn, delay_s=self.twin.settings_s, rig=self.twin.declared)

    def calibrated(self, first: DelayScan) -> GatedTwin:
        """The twin that one half gives; the level of its light, and what the water scatters, from this half."""
        rig, _ = calibrated_half(read_with_rig_of(self.nominal, first), self.range_m, self.nominal)
        data = self.nominal.model_dump(mode="json")
        scene = load_scene(data, dict(rig.values))
        draft = _matched(replace(self.twin, scene=scene, scattered=self.scattered), first)
        rig = unbiased(rig, draft, first, self.range_m)
        scene = load_scene(data, dict(rig.values))
        twin = replace(self.twin, scene=scene, scattered=self.scattered, uncertain=uncertain_of(scene, rig.sigmas))
        return _matched(twin, first)


def _matched(twin: GatedTwin, first: DelayScan) -> GatedTwin:
    """The twin with its light scaled to a half of the recording by one factor."""
    seen = first.counts.mean(axis=1) - first.dark.astype(np.float64).mean(axis=0)
    factor = float(seen.sum()) / float(twin.expected_dn().sum())
    held = twin.light.returns
    light = replace(twin.light, returns=replace(held, amplitude=held.amplitude * factor))
    return replace(twin, light=light, scattered=(twin.scattered * np.float32(factor)).astype(np.float32))


def tried(bench: Bench, seed: int, draws: int, faults: tuple[str, ...], least: int | None = None) -> Outcome:
    """The verdicts of one rig, with its twin as calibrated and with planted faults.

    Other arguments:
        least: draws of a faulty twin after which it is judged, and drawn no further if it fails beyond doubt; None: never.
    """
    scan = bench.recording(seed)
    first, second = scan_half(scan, 0), scan_half(scan, 1)
    right = bench.calibrated(first)
    twins = {"right": right} | {name: _matched(FAULTS[name][1](right), first) for name in faults}
    verdicts = {}
    for name, twin in twins.items():
        frame = frame_of(replace(twin, truth={}), first, bench.range_m)
        real, _ = signal_statistics(twin.read_with(second), frame)
        drawn: list[dict[str, float]] = []
        found: list[Judged] = []
        for number in range(draws):
            one = twin.draw(1000 * seed + number, second.repeats, len(second.dark))
            drawn.append(signal_statistics(one, frame)[0])
            if number + 1 == (least if name in FAULTS else None) or number + 1 == draws:
                found = judged(CLAUSES, Evidence(real, drawn, {}, {}, {}, ()))
                if name in FAULTS and _beyond_doubt(found, FAULTS[name][0]):
                    break
        verdicts[name] = {one.clause.name: str(one.verdict) for one in found}
    return Outcome(verdicts)


def _beyond_doubt(found: list[Judged], clause: str) -> bool:
    """Whether a clause fails by twice the half width of its interval, or more: further draws, which narrow it, leave that so."""
    one = next(one for one in found if one.clause.name == clause)
    return one.verdict == "fail" and min(abs(one.low), abs(one.high)) > 0.5 * (one.high - one.low)


def exact_interval(count: int, of: int) -> tuple[float, float]:
    """95 % interval of a share by Clopper and Pearson, Biometrika 26:404, 1934."""
    from scipy.special import betaincinv

    low = 0.0 if count == 0 else float(betaincinv(count, of - count + 1, 0.025))
    high = 1.0 if count == of else float(betaincinv(count + 1, of - count, 0.975))
    return low, high


def summary(outcomes: list[Outcome]) -> list[str]:
    """Lines of the table: how many right twins pass, how many wrong ones fail the clause that names the fault."""
    lines = []
    passed = sum("fail" not in one.verdicts["right"].values() for one in outcomes)
    lines.append(_line("right: no clause fails", passed, len(outcomes)))
    for clause in CLAUSES:
        held = [one.verdicts["right"][clause.name] for one in outcomes]
        if "pass" in held or "fail" in held:
            text = ", ".join(f"{held.count(word)} {word}" for word in ("pass", "fail", "cannot tell") if word in held)
            lines.append(f"    {clause.name:<16} {text}")
    for name, (named, _) in FAULTS.items():
        held = [one.verdicts[name][named] for one in outcomes if name in one.verdicts]
        if held:
            lines.append(_line(f"{name}: {named} fails", held.count("fail"), len(held)))
    return lines


def _line(text: str, count: int, of: int) -> str:
    low, high = exact_interval(count, of)
    return f"{text:<44} {count:4d} of {of:4d}   {100 * count / of:5.1f} %   95 % interval {100 * low:.1f} … {100 * high:.1f} %"


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--rigs", type=int, default=40, help="emulated rigs")
    parser.add_argument("--faults-of", type=int, default=10**9, help="plant faults in the first so many of them only")
    parser.add_argument("--draws", type=int, default=40, help="simulated recordings of a twin")
    parser.add_argument(
        "--least", type=int, default=12, help="draws of a faulty twin, where it then fails beyond doubt"
    )
    parser.add_argument("--from", dest="start", type=int, default=0, help="number of the first rig")
    parser.add_argument("--journal", type=Path, help="file with a line for each rig; what it holds is not tried again")
    given = parser.parse_args()
    held = held_in(given.journal, given.draws)
    bench, began, outcomes = Bench(), time.perf_counter(), []
    for number in range(given.start, given.start + given.rigs):
        faults = tuple(FAULTS) if number - given.start < given.faults_of else ()
        one = held.get(number)
        if one is None or not one.verdicts.keys() >= set(faults):
            one = tried(bench, number, given.draws, faults, given.least)
            _write(given.journal, number, given.draws, one)
        outcomes.append(one)
        wrong = [name for name, verdict in one.verdicts["right"].items() if verdict == "fail"]
        missed = [name for name in faults if one.verdicts[name][FAULTS[name][0]] != "fail"]
        spent = time.perf_counter() - began
        print(f"rig {number}: fails though right {wrong or '–'}, missed {missed or '–'}; {spent:.0f} s", flush=True)
    print("\n".join(summary(outcomes)))


def held_in(journal: Path | None, draws: int) -> dict[int, Outcome]:
    """What a journal holds of rigs tried with so many draws, by their number; the last line of a rig counts. A line that a kill cut
    short is left out."""
    found: dict[int, Outcome] = {}
    if journal is None or not journal.exists():
        return found
    for text in journal.read_text(encoding="utf-8").splitlines():
        try:
            line = json.loads(text)
        except ValueError:
            continue
        if line["draws"] == draws:
            found[line["rig"]] = Outcome(line["verdicts"])
    return found


def _write(journal: Path | None, number: int, draws: int, outcome: Outcome) -> None:
    if journal is not None:
        with journal.open("a", encoding="utf-8") as file:
            # A line of its own also behind one that was cut short.
            file.write("\n" + json.dumps({"rig": number, "draws": draws, "verdicts": outcome.verdicts}) + "\n")


if __name__ == "__main__":
    main()
