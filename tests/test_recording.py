"""Recordings: a plan becomes a capture shot by shot, whatever dies in between."""

from __future__ import annotations

import errno
import json
import os
import threading
import time
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from beambench.captures.recording.plan import PLANS, Planned, load_plan, load_rig
from beambench.captures.recording.record import devices_of, finish
from beambench.captures.recording.slots import JOURNAL, folder_of
from beambench.generator.emulators.bench import Bench, Faults
from beambench.scenes.errors import InputError

from ._emulated import SHAPE, Ramp, bench, free_host
from ._recorded import capture_of, check, connected, plan, rig_data, taken

# ---------------------------------------------------------------- what is recorded


def test_a_scan_is_recorded_at_its_delays(tmp_path: Path) -> None:
    planned = plan()
    assert [slot.part for slot in planned.slots] == ["dark"] * 2 + ["reference"] + ["scan"] * 10
    seen: list[tuple[int, int, str]] = []
    with bench(Faults(loss=0.05)) as (rig, sight):
        done = taken(
            planned,
            connected(rig),
            tmp_path / "real.zarr",
            watch=lambda done, total, text, frame: seen.append((done, total, text)),
        )
        assert {pulses for _, _, pulses in sight.seen} == {100}
    capture = check(tmp_path / "real.zarr", planned)
    assert (done.done, done.total, done.given_up) == (13, 13, "")
    assert [one[0] for one in seen] == list(range(1, 14)) and seen[-1] == (13, 13, "scan 13/13")
    assert not folder_of(tmp_path / "real.zarr").exists()
    assert capture.attrs["truth_kind"] == "none" and np.isnan(capture.truth_range.values).all()
    assert json.loads(capture.attrs["rig"]) == planned.declared
    told = json.loads(capture.attrs["provenance"])["recording"]
    assert told["opened"][0]["devices"]["camera"]["serial"] == "EMU0001"
    assert told["opened"][0]["told"]["camera"]["TriggerSource"] == "Line0"  # as read back
    assert [slot["index"] for slot in told["slots"]] == list(range(1, 14))
    (clock,) = told["clocks"]
    # Both clocks are this machine's. A frame that arrives late turns the line, and widens its error with it.
    assert clock["shots"] == 13 and clock["ppm_error"] > 0 and abs(clock["ppm"]) < 6 * clock["ppm_error"] + 1e3
    assert (np.diff(capture.time.values) > 0).all() and capture.time.values[0] == 0


def test_averages_are_means_and_say_so(tmp_path: Path) -> None:
    with bench() as (rig, _):
        taken(
            plan(averages=3, repeats=1, dark=0, reference=0, reference_delay_s=None),
            connected(rig),
            tmp_path / "a.zarr",
        )
    capture = capture_of(tmp_path / "a.zarr")
    assert capture.counts.dtype == np.float32 and capture.attrs["averaged"] and capture.sizes["slice"] == 5
    assert np.allclose(capture.counts.values[:, 0, 0], 7 * (2 + 3 * np.arange(5)))  # shots 1 2 3, 4 5 6, …


def test_silent_shots_are_taken_again(tmp_path: Path) -> None:
    planned = plan()
    with bench(Faults(stall=0.3), seed=4) as (rig, _):
        done = taken(planned, connected(rig, shot_timeout_s=0.15), tmp_path / "s.zarr")
    check(tmp_path / "s.zarr", planned)
    assert done.retakes > 0


def test_a_rig_that_dies_is_opened_again(tmp_path: Path) -> None:
    planned, host = plan(repeats=4), free_host()
    rigs: list[Bench] = []

    def rig() -> Bench:
        sight = Ramp()
        made = Bench(sight, host, serial="EMU0001", seed=1, faults=Faults(), control_port=3956, delay_port=5025)
        made._shots = 100 * len(rigs)  # frames of a later rig are later ones
        rigs.append(made)
        made.start()
        return made

    def kill(done: int, total: int, text: str, frame: Any) -> None:
        if done in (5, 12):
            rigs[-1].close()
            threading.Timer(0.5, rig).start()

    rig()
    try:
        done = taken(planned, connected(None, host), tmp_path / "d.zarr", watch=kill)
    finally:
        rigs[-1].close()
    capture = check(tmp_path / "d.zarr", planned)
    assert len(rigs) == 3 and done.retakes >= 2
    told = json.loads(capture.attrs["provenance"])["recording"]
    assert len(told["opened"]) == 3 and {slot["opened"] for slot in told["slots"]} == {1, 2, 3}


def test_given_up_keeps_the_stack_with_a_mask_and_resume_goes_on(tmp_path: Path) -> None:
    planned, out = plan(), tmp_path / "g.zarr"
    with bench() as (rig, _):
        file = connected(rig, give_up_s=0.5)

        def pull(done: int, total: int, text: str, frame: Any) -> None:
            if done == 6:
                rig.close()

        done = taken(planned, file, out, watch=pull)
    assert done.done == 6 and done.given_up
    capture = capture_of(out)
    assert capture.valid.values.sum() == 6 and capture.valid.values[:6].all()
    assert (capture.counts.values[6:] == 0).all() and np.isnan(capture.time.values[6:]).all()
    with pytest.raises(InputError, match="The output exists"):
        taken(planned, file, out)
    with bench() as (rig, _):
        rig._shots = 500
        assert taken(planned, connected(rig), out, resume=True).done == 13
    check(out, planned)


# ---------------------------------------------------------------- the recorder dies


class Died(BaseException):
    """As a kill: nothing is tidied by the code under test but what the operating system closes."""


def begun(planned: Planned, out: Path, shots: int) -> None:
    def die(done: int, total: int, text: str, frame: Any) -> None:
        if done == shots:
            raise Died

    with bench() as (rig, _), pytest.raises(Died):
        taken(planned, connected(rig), out, watch=die)


@pytest.mark.parametrize("tear", ["nothing", "torn line", "garbage", "flipped byte", "lost frames"])
def test_a_killed_recorder_goes_on(tmp_path: Path, tear: str) -> None:
    planned, out = plan(), tmp_path / "k.zarr"
    begun(planned, out, 6)
    journal, frames = folder_of(out) / JOURNAL, folder_of(out) / "frames.bin"
    kept = 6
    if tear == "torn line":
        journal.write_bytes(journal.read_bytes()[:-30])
        kept = 5
    elif tear == "garbage":
        journal.write_bytes(journal.read_bytes() + b"\0" * 100)
    elif tear == "flipped byte":
        content = bytearray(frames.read_bytes())
        content[3 * SHAPE[0] * SHAPE[1] * 2 + 11] ^= 4
        frames.write_bytes(content)
        kept = 5
    elif tear == "lost frames":
        os.truncate(frames, 4 * SHAPE[0] * SHAPE[1] * 2)
        kept = 4
    with bench() as (rig, sight):
        rig._shots = 100
        taken(planned, connected(rig), out, resume=True)
        assert len(sight.seen) == 13 - kept  # what was sound is not taken again
    if tear == "flipped byte":  # a slot that was taken again holds a later shot than its neighbours
        capture = capture_of(out)
        assert capture.valid.values.all() and capture.counts.values[3, 0, 0] > capture.counts.values[5, 0, 0]
    else:
        check(out, planned)


def test_finish_makes_a_store_without_devices(tmp_path: Path) -> None:
    planned, out = plan(), tmp_path / "f.zarr"
    begun(planned, out, 4)
    done = finish(planned, out)
    assert (done.done, done.total) == (4, 13) and not folder_of(out).exists()
    assert capture_of(out).valid.values.sum() == 4
    with pytest.raises(InputError, match="No recording"):
        finish(planned, tmp_path / "other.zarr")


def test_another_plan_or_no_resume_is_refused_and_the_journal_stays(tmp_path: Path) -> None:
    out = tmp_path / "r.zarr"
    begun(plan(), out, 4)
    before = (folder_of(out) / JOURNAL).read_bytes()
    with bench() as (rig, _):
        with pytest.raises(InputError, match="was begun"):
            taken(plan(), connected(rig), out)
        with pytest.raises(InputError, match="another one"):
            taken(plan(count=6), connected(rig), out, resume=True)
    assert (folder_of(out) / JOURNAL).read_bytes() == before


# ---------------------------------------------------------------- faults


def test_nothing_there_wrong_serial_and_wrong_files(tmp_path: Path) -> None:
    planned, out = plan(), tmp_path / "x.zarr"
    with pytest.raises(InputError, match="does not answer"):
        taken(planned, connected(None, free_host()), out)
    assert not folder_of(out).exists()  # nothing was recorded, so nothing is in the way
    with bench() as (rig, _):
        wrong = rig_data(rig)
        wrong["devices"]["camera"]["serial"] = "ABC"
        with pytest.raises(InputError, match="Another camera"):
            taken(planned, load_rig(wrong), out)
        small = plan()
        small.plan.changes["rig.camera.rows"] = 12
        with pytest.raises(InputError, match="other data than the plan"):
            taken(load_plan(small.plan.model_dump(mode="json")), connected(rig), out)
    assert not folder_of(out).exists()


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"devices": {"camera": {"driver": "gige", "address": "127.0.0.1"}}}, "role 'delay'"),
        (
            {"devices": {"camera": {"driver": "nothing"}, "delay": {"driver": "dg645", "address": "x"}}},
            "no such driver",
        ),
        ({"devices": {"camera": {"driver": "gige", "adress": "x"}}}, "no such option"),
        ({"devices": {"camera": {"driver": "gige", "address": 7}}}, "wrong type"),
        ({"devices": {"camera": {"driver": "gige"}}}, "missing"),
        ({"trigger": "laser"}, "role 'laser'"),
        ({"shot_timeout_s": "2 s"}, "shot_timeout_s"),
    ],
)
def test_a_wrong_rig_file_says_what(change: Mapping[str, Any], said: str) -> None:
    with pytest.raises(InputError, match=said):
        devices_of(plan(), load_rig(rig_data(None) | change))


@pytest.mark.parametrize(
    ("scan", "said"),
    [
        ({"start_ns": 26.5}, "start_s"), ({"start_s": "26.5 ns"}, "number"), ({"start_s": 26.5}, "at most 1"),
        ({"count": 0}, "count"), ({"values_s": [1e-9]}, "start_s, step_s and count, or by values_s"),
        ({"reference_delay_s": 26.6e-9}, "one of the delays"), ({"reference": 0}, "only there"),
    ],
)  # fmt: skip
def test_a_mistyped_plan_says_what(scan: Mapping[str, Any], said: str) -> None:
    with pytest.raises(InputError, match=said):
        plan(**scan)


def test_a_disk_that_fills_when_the_capture_is_written_loses_no_shot(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """All shots are taken and the store does not fit beside them: the note says how to go on, and `resume` takes no shot again."""
    planned, out = plan(), tmp_path / "full.zarr"

    def full(*arguments: Any, **options: Any) -> None:
        raise InputError("Writing capture 0 failed: No space left on device.", where=str(out))

    with bench() as (rig, _):
        with monkeypatch.context() as patched:
            patched.setattr("beambench.captures.recording.record.write", full)
            with pytest.raises(InputError, match="No space left") as caught:
                taken(planned, connected(rig), out)
        assert "13 of 13 shots" in caught.value.__notes__[0] and "records nothing again" in caught.value.__notes__[0]
        made = taken(planned, connected(rig), out, resume=True)
    assert made.done == 13 and not folder_of(out).exists()
    check(out, planned)


def test_a_full_disk_stops_before_or_during_and_keeps_what_is_there(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    planned, out = plan(), tmp_path / "full.zarr"

    def full(*arguments: Any) -> int:
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    with bench() as (rig, _):
        with monkeypatch.context() as patched:
            patched.setattr(os, "posix_fallocate", full)
            with pytest.raises(InputError, match="No space left"):
                taken(planned, connected(rig), out)
        assert not folder_of(out).exists()

        def fill(done: int, total: int, text: str, frame: Any) -> None:
            if done == 5:
                monkeypatch.setattr(os, "fdatasync", full)

        with pytest.raises(InputError, match="5 of 13 shots are in"):
            taken(planned, connected(rig), out, watch=fill)
        monkeypatch.undo()
        assert taken(planned, connected(rig), out, resume=True).done == 13
    check(out, planned)


def test_two_recorders_do_not_write_one_recording(tmp_path: Path) -> None:
    planned, out = plan(), tmp_path / "two.zarr"
    refused: list[str] = []

    def second(done: int, total: int, text: str, frame: Any) -> None:
        if done == 3:
            try:
                finish(planned, out)
            except InputError as error:
                refused.append(str(error))

    with bench() as (rig, _):
        taken(planned, connected(rig), out, watch=second)
    assert len(refused) == 1 and "Another process is writing" in refused[0]


def test_every_plan_of_the_library_loads() -> None:
    names = sorted(path.stem for path in PLANS.glob("*.toml"))
    assert len(names) >= 4
    for name in names:
        planned = load_plan(name)
        assert planned.plan.plan == name and planned.slots and planned.declared["kind"] == planned.recipe.name


def test_time_of_a_shot_is_small(tmp_path: Path) -> None:
    """Set, read back, arm, fire, read, commit with two fsyncs: what a recorder adds to the instruments' own time."""
    planned = plan(repeats=10, count=5)
    with bench() as (rig, _):
        begin = time.perf_counter()
        taken(planned, connected(rig), tmp_path / "t.zarr")
        assert (time.perf_counter() - begin) / len(planned.slots) < 0.5  # 4 ms on an idle machine
