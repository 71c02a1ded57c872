"""Plans, rig files and recordings of an emulated rig, and what a recording must hold: for tests of the recorder."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from beambench.captures import open_captures, verify
from beambench.captures.recording.plan import Planned, RigFile, load_plan, load_rig
from beambench.captures.recording.record import Recorded, devices_of, record
from beambench.generator.emulators.bench import Bench

from ._emulated import SHAPE

__all__ = ["capture_of", "check", "connected", "plan", "rig_data", "taken"]

SCAN = {
    "start_s": 26.5e-9, "step_s": 0.24e-9, "count": 5, "repeats": 2, "averages": 1, "dark": 2, "reference": 1,
    "reference_delay_s": 26.98e-9,
}  # fmt: skip


def plan(**scan: Any) -> Planned:
    sizes = {"rig.camera.rows": SHAPE[0], "rig.camera.cols": SHAPE[1], "rig.t0_s": 1e-9}
    data = {
        "schema_version": 1, "plan": "test", "title": "A test", "instrument": "flat-wall", "changes": sizes, "scan": SCAN | scan,
    }  # fmt: skip
    return load_plan(data)


def rig_data(rig: Bench | None, host: str = "127.0.0.9", **changes: Any) -> dict[str, Any]:
    """A rig file for an emulated rig, or for the address of one that is not there."""
    delay = f"{host}:5025" if rig is None else "{}:{}".format(*rig.delays.address)
    camera = host if rig is None else rig.camera.address[0]
    return {
        "schema_version": 1, "rig": "bench", "title": "A bench", "trigger": "delay", "shot_timeout_s": 0.5, "give_up_s": 20.0,
        "devices": {
            "delay": {"driver": "dg645", "address": delay},
            "camera": {"driver": "gige", "address": camera, "serial": "EMU0001"},
        },
        "settings": {"camera": {"TriggerMode": "On", "TriggerSource": "Line0"}},
    } | changes  # fmt: skip


def connected(rig: Bench | None, host: str = "127.0.0.9", **changes: Any) -> RigFile:
    return load_rig(rig_data(rig, host, **changes))


def taken(planned: Planned, rig: RigFile, out: Path, **options: Any) -> Recorded:
    return record(planned, devices_of(planned, rig), out, **options)


def capture_of(out: Path) -> Any:
    assert verify(out) == []
    return open_captures(out)[0].load()


def check(out: Path, planned: Planned) -> Any:
    """Every slot at its delay, in order, with the frame that was exposed at that delay."""
    capture = capture_of(out)
    asked = [slot.settings["delay"] for slot in planned.slots]
    lit = np.array([settings["laser_on"] for settings in asked])
    delays = np.array([settings["delay_s"] for settings in asked])
    assert np.array_equal(capture.laser_on.values, lit)
    assert np.allclose(capture.delay.values, delays + 1e-9, rtol=0, atol=6e-13)
    assert np.array_equal(capture.counts.values[:, -1, -1], np.where(lit, np.rint(delays / 1e-11), 0))
    # The frame's first pixel is 7·shot: no frame stands in two slots, and later slots hold later shots.
    shots = capture.counts.values[:, 0, 0] // 7
    assert (np.diff(shots.astype(int)) > 0).all()
    assert capture.valid.values.all()
    return capture
