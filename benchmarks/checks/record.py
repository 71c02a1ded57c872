"""Recordings of an emulated rig that is killed, by a recorder that is killed, with packets that are lost.

    python -m beambench.benchmarks.checks.record --rounds 20

A gated scan of 40 delays, three times, of a rig with hidden values: each round kills the rig and the recorder (SIGKILL) at random
moments, starts the rig anew, goes on with --resume, and sometimes tears the journal's last line. A round holds if every slot
is there once, at its delay, with the sha256 that its journal line had; if χ² of the recorded counts about the rendered
expectation is that of noise; and if an estimator is as accurate on the recording as on a stack that the generator made of the
same hidden rig, within their common interval.
"""

from __future__ import annotations

import argparse
import hashlib
import json
import os
import secrets
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from ...captures import open_captures, verify
from ...captures.hide import hide_truth
from ...captures.recording.plan import Planned, load_plan
from ...captures.recording.slots import JOURNAL, folder_of
from ...estimators import run_estimator
from ...generator.emulators.gated_sight import hidden
from ...generator.emulators.gated_table import write_table
from ...generator.gated.direct import render_direct
from ...generator.gated.stack import ambient_electrons, expected_electrons, slice_coordinates
from ...generator.generate import generate
from ...scenes.load import load_scene
from ...scenes.rigs.gated import gated_rig
from ...scenes.scene import Scene
from .attempts import Attempts, print_attempts

__all__ = ["chi_square", "main", "recordings"]

_DELAYS = {"kind": "listed", "laser_off": 0}
#: Standard errors that χ² may differ by, and two accuracies of one estimator.
_ALLOWED = 4.5


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the campaign and print its table. Returns 1 where a round failed."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--rounds", type=int, default=20)
    parser.add_argument("--loss", type=float, default=0.005)
    parser.add_argument("--side", type=int, default=24, help="rows and columns of the camera")
    parser.add_argument("--estimator", default="poisson-ml")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--longest", type=float, default=300.0, help="seconds of a round; more on a busy machine")
    given = parser.parse_args(arguments)
    return print_attempts(
        [recordings(given.rounds, given.loss, given.side, given.estimator, given.seed, given.longest)]
    )


def recordings(rounds: int, loss: float, side: int, estimator: str, seed: int, longest_s: float) -> Attempts:
    """The campaign: an attempt for each round, told as it ends."""
    part = Attempts(f"recordings with {loss:.1%} of the packets lost, rig and recorder killed")
    draw = np.random.default_rng(seed)
    with tempfile.TemporaryDirectory(prefix="beambench-record-") as place:
        base = Path(place)
        planned = load_plan("gated-demo", {"changes": _changes(side), "scan.repeats": 3, "scan.dark": 4})
        (base / "plan.json").write_text(json.dumps(planned.plan.model_dump(mode="json")))
        scene = hidden(planned.scene, seed)
        delays, electrons, ambient = expectation(planned, scene)
        write_table(base / "table.npz", scene, delays, electrons, ambient)
        rendered = generate(_listed(scene, planned, repeats=3), seed=seed)
        # As declared for the recording: the estimator knows as little of the hidden values in both.
        shift = float(planned.declared["t0_s"]) - gated_rig(scene).t0_s
        rendered = rendered.assign_coords(delay=("slice", rendered["delay"].values + shift, rendered["delay"].attrs))
        rendered.attrs["rig"] = json.dumps(planned.declared)
        told = _accuracy(rendered, rendered, estimator)
        scan = [number for number, slot in enumerate(planned.slots) if slot.part == "scan"]
        for number in range(rounds):
            out = base / f"round-{number}.zarr"
            try:
                kills = _round(base, out, loss, draw, seed + number, longest_s)
                problem = _problem(planned, scene, out, delays, electrons, ambient)
                mine = _accuracy(open_captures(out)[0].load().isel(slice=scan), rendered, estimator)
                if abs(mine[0] - told[0]) > _ALLOWED * np.hypot(mine[1], told[1]):
                    problem += f" {estimator}: mean squared error {mine[0]:.3g} recorded, {told[0]:.3g} rendered [m²]"
            except (RuntimeError, AssertionError) as error:
                problem, kills = str(error), {}
            if problem:
                part.failed(f"round {number}: {problem.strip()}")
            else:
                part.held()
                counted = ", ".join(f"{count} times {name}" for name, count in kills.items())
                print(f"round {number} held: {counted}", file=sys.stderr, flush=True)
            for name, count in kills.items():
                part.notes[name] = part.notes.get(name, 0) + count
    return part


def _changes(side: int) -> dict[str, Any]:
    own = load_plan("gated-demo").plan.changes
    return own | {"rig.camera.rows": side, "rig.camera.cols": side, "rig.camera.focal_length_m": 1.5e-3 * side / 48}


def expectation(planned: Planned, scene: Scene) -> tuple[NDArray[np.float64], NDArray[np.float32], float]:
    """(delays as set, expected photoelectrons at each (delay, row, col), those of ambient light) of a scene."""
    listed = _listed(scene, planned)
    coords = slice_coordinates(listed)
    electrons, _ = expected_electrons(listed, render_direct(listed, 3e-3, with_truth=False), coords, 1, 0)
    return coords["setting"], electrons, float(ambient_electrons(listed, coords)[0])


def _listed(scene: Scene, planned: Planned, repeats: int = 1) -> Scene:
    """The scene with the delays of the scan, each so many times."""
    scan = [slot.settings["delay"]["delay_s"] for slot in planned.slots if slot.part == "scan"]
    values = list(dict.fromkeys(scan))
    return load_scene(scene, {"rig.delays": _DELAYS | {"values_s": values, "repeats": repeats}})


# ---------------------------------------------------------------- one round


class _Rig:
    """The emulated rig, started anew at one address after each death."""

    def __init__(self, table: Path, loss: float, seed: int) -> None:
        self.host = f"127.{16 + secrets.randbelow(224)}.{secrets.randbelow(256)}.{1 + secrets.randbelow(254)}"
        self._command = [
            sys.executable, "-P", "-m", "beambench.generator.emulators", "sphere", f"--table={table}", f"--host={self.host}",
            f"--loss={loss}", "--stay",
        ]  # fmt: skip
        self._seed = 1000 * seed
        self._process = self._started(self._seed)

    def _started(self, seed: int) -> subprocess.Popen[str]:
        process = subprocess.Popen([*self._command, f"--seed={seed}"], stdout=subprocess.PIPE, text=True)
        assert process.stdout is not None
        if not process.stdout.readline():
            raise RuntimeError(f"the rig did not start: exit code {process.wait()}")
        return process

    def die_and_return(self) -> None:
        """SIGKILL, and a new one; its noise is other noise."""
        self.end()
        self._seed += 1
        self._process = self._started(self._seed)

    def end(self) -> None:
        """SIGKILL."""
        self._process.kill()
        self._process.wait()


def _round(
    base: Path, out: Path, loss: float, draw: np.random.Generator, seed: int, longest_s: float
) -> dict[str, int]:
    """Record with kills until it is done; how many there were of each kind. Raises RuntimeError where it never is."""
    rig = _Rig(base / "table.npz", loss, seed)
    kills = {"rig killed": 0, "recorder killed": 0, "journal torn": 0}
    file = base / f"{out.stem}.json"
    file.write_text(json.dumps(_rig_file(rig.host, 0.4 * longest_s)))
    begun = time.monotonic()
    command = [sys.executable, "-P", "-m", "beambench", "record", str(base / "plan.json")]
    try:
        while time.monotonic() - begun < longest_s:
            recorder = subprocess.Popen(
                [*command, "--rig", str(file), "-o", str(out), "--resume"],
                stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True,
            )  # fmt: skip
            _wait_for_shots(recorder, folder_of(out), int(draw.integers(2, 60)))
            if kills["rig killed"] < 2:
                kills["rig killed"] += 1
                rig.die_and_return()
            if kills["recorder killed"] < 2 and recorder.poll() is None:
                time.sleep(float(draw.uniform(0.0, 1.0)))
                os.kill(recorder.pid, signal.SIGKILL)
                recorder.communicate()
                kills["recorder killed"] += 1
                kills["journal torn"] += _torn(folder_of(out), draw)
                continue
            _, said = recorder.communicate(timeout=longest_s)
            if recorder.returncode == 0:
                return kills
            if recorder.returncode not in (2, 3, -signal.SIGKILL):
                raise RuntimeError(f"exit code {recorder.returncode}: {said.strip()[-300:]}")
        raise RuntimeError(f"it was not done within {longest_s:g} s")
    finally:
        rig.end()


def _rig_file(host: str, give_up_s: float) -> dict[str, Any]:
    return {
        "schema_version": 1, "rig": "killed", "title": "Emulated rig that is killed", "trigger": "delay", "shot_timeout_s": 1.0,
        "give_up_s": give_up_s,
        "devices": {
            "delay": {"driver": "dg645", "address": f"{host}:5025"},
            "camera": {"driver": "gige", "address": host, "serial": "EMU0001"},
        },
        "settings": {"camera": {"TriggerMode": "On", "TriggerSource": "Line0"}},
    }  # fmt: skip


def _wait_for_shots(recorder: subprocess.Popen[str], folder: Path, shots: int) -> None:
    """Wait until so many slots more are in the journal, or the recorder ends."""

    def count() -> int:
        try:
            return (folder / JOURNAL).read_bytes().count(b'"event": "slot"')
        except OSError:
            return 0

    wanted = count() + shots
    while recorder.poll() is None and count() < wanted:
        time.sleep(0.02)


def _torn(folder: Path, draw: np.random.Generator) -> int:
    """Sometimes: the end of the journal as a loss of power leaves it."""
    journal = folder / JOURNAL
    if draw.random() < 0.5 or not journal.is_file():
        return 0
    content = journal.read_bytes()
    journal.write_bytes(content[: len(content) - int(draw.integers(1, 40))] + b"\0" * int(draw.integers(0, 9)))
    return 1


# ---------------------------------------------------------------- what a round must leave


def _problem(
    planned: Planned,
    scene: Scene,
    out: Path,
    delays: NDArray[np.float64],
    electrons: NDArray[np.float32],
    ambient: float,
) -> str:
    """What is wrong with a recording; empty where nothing is."""
    if damage := verify(out):
        return f"{len(damage)} damaged files"
    capture = open_captures(out)[0].load()
    told = json.loads(capture.attrs["provenance"])["recording"]["slots"]
    counts = capture["counts"].values
    if len(told) != len(planned.slots) or not capture["valid"].values.all() or None in told:
        return f"{sum(one is not None for one in told)} of {len(planned.slots)} slots"
    for number, (slot, line) in enumerate(zip(planned.slots, told, strict=True)):
        if hashlib.sha256(counts[number].tobytes()).hexdigest() != line["sha256"]:
            return f"slot {number} has other bytes than its journal line"
        asked = slot.settings["delay"]
        set_ = line["told"]["delay"]
        if abs(set_["delay_s"] - asked["delay_s"]) > 3e-12 or set_["laser_on"] != asked["laser_on"]:
            return f"slot {number} was taken at {set_}, and not at {asked}"
    if len({line["sha256"] for line in told}) != len(told):
        return "one frame stands in two slots"
    score = chi_square(planned, scene, counts, delays, electrons, ambient)
    return "" if abs(score) < _ALLOWED else f"χ² about the rendered expectation is off by {score:+.1f} standard errors"


def chi_square(
    planned: Planned,
    scene: Scene,
    counts: NDArray[Any],
    delays: NDArray[np.float64],
    electrons: NDArray[np.float32],
    ambient: float,
) -> float:
    """(χ² − its mean) in standard errors, of counts about the rendered expectation.

    Var c = K²(µ + r²) + 1/12 for a pixel of µ photoelectrons without intensifier, and E z⁴ − 1 = 2 + K⁴µ/(Var c)², the kurtosis of
    a Poisson number. Pixels near the ADC's limits are left out.
    """
    detector = gated_rig(scene).detector
    gain, dark = detector.gain_dn_per_e, detector.dark_current_e_per_s * detector.exposure_s
    sum_, spread = 0.0, 0.0
    for slot, image in zip(planned.slots, counts, strict=True):
        asked = slot.settings["delay"]
        near = int(np.argmin(np.abs(delays - asked["delay_s"])))
        mean_e = (electrons[near].astype(np.float64) if asked["laser_on"] else np.full(image.shape, ambient)) + dark
        mean = gain * mean_e + detector.offset_dn
        variance = gain**2 * (mean_e + detector.read_noise_e**2) + 1 / 12
        inside = (mean > 6 * np.sqrt(variance)) & (mean < 2**detector.adc_bits - 1 - 6 * np.sqrt(variance))
        z2 = (image[inside] - mean[inside]) ** 2 / variance[inside]
        sum_ += float((z2 - 1.0).sum())
        spread += float((2.0 + gain**2 * mean_e[inside] * gain**2 / variance[inside] ** 2).sum())
    return sum_ / float(np.sqrt(spread))


def _accuracy(capture: xr.Dataset, truth: xr.Dataset, estimator: str) -> tuple[float, float]:
    """(mean squared error, its standard error) of an estimator against the truth of the rendered stack [m²], robust to outliers:
    errors are cut at five times their median."""
    found = run_estimator(estimator, hide_truth(capture))
    # Mixed pixels too: their error is the same in both, and in a small image most are mixed.
    good = found["valid"].values & np.isfinite(truth["truth_range"].values)
    if good.mean() < 0.5:
        raise RuntimeError(f"{estimator} answers in {good.mean():.0%} of the pixels: its accuracy says nothing")
    error = np.abs(found["range"].values - truth["truth_range"].values)[good]
    error = np.minimum(error, 5.0 * np.median(error)) ** 2
    return float(error.mean()), float(error.std() / np.sqrt(error.size))


if __name__ == "__main__":
    sys.exit(main())
