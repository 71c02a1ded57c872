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

from beambench.captures import open_captures, verify
from beambench.captures.drivers.replay import Replay
from beambench.captures.example import example_capture
from beambench.captures.recording.plan import PLANS, Planned, RigFile, load_plan, load_rig
from beambench.captures.recording.record import Recorded, devices_of, finish, record
from beambench.captures.recording.slots import JOURNAL, folder_of
from beambench.captures.store.writer import write
from beambench.generator.emulators.bench import Bench, Faults
from beambench.scenes.errors import InputError

from ._emulated import SHAPE, Ramp, bench, free_host

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
    assert clock["shots"] == 13 and abs(clock["ppm"]) < 1e5
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
        ({"start_ns": 26.5}, "start_s"), ({"start_s": "26.5 ns"}, "number"), ({"start_s": 26.5}, "less than or equal to 1"),
        ({"count": 0}, "count"), ({"values_s": [1e-9]}, "start_s, step_s and count, or by values_s"),
        ({"reference_delay_s": 26.6e-9}, "one of the delays"), ({"reference": 0}, "only there"),
    ],
)  # fmt: skip
def test_a_mistyped_plan_says_what(scan: Mapping[str, Any], said: str) -> None:
    with pytest.raises(InputError, match=said):
        plan(**scan)


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


# ---------------------------------------------------------------- other modalities, by a capture that is played back


def played(
    tmp_path: Path, modality: str, source: str, sizes: Mapping[str, int], also: list[str]
) -> tuple[Any, RigFile]:
    capture = example_capture(modality, seed=3, sizes=dict(sizes), optional=False)
    write(tmp_path / "source.zarr", capture)
    data = {
        "schema_version": 1, "rig": "replay", "title": "Replay", "trigger": source, "shot_timeout_s": 1.0, "give_up_s": 5.0,
        "devices": {source: {"driver": "replay", "address": str(tmp_path / "source.zarr"), "also": also}},
    }  # fmt: skip
    return capture, load_rig(data)


def test_a_gated_capture_is_played_back(tmp_path: Path) -> None:
    planned = plan(start_s=0.0, step_s=1e-9, count=6, repeats=1, dark=0, reference=0, reference_delay_s=None)
    played_one = example_capture("gated", seed=3, sizes={"row": SHAPE[0], "col": SHAPE[1]}, optional=False)
    played_one.coords["laser_on"] = played_one.laser_on.copy(data=np.ones(6, bool))
    write(tmp_path / "source.zarr", played_one)
    data = rig_data(None) | {"trigger": "camera", "settings": {}}
    data["devices"] = {"camera": {"driver": "replay", "address": str(tmp_path / "source.zarr"), "also": ["delay"]}}
    taken(planned, load_rig(data), tmp_path / "out.zarr")
    capture = capture_of(tmp_path / "out.zarr")
    assert np.array_equal(capture.counts.values, played_one.counts.values)
    assert np.allclose(
        capture.delay.values, played_one.delay.values + 1e-9, rtol=0, atol=1e-15
    )  # t0_s of the plan's instrument


def test_a_waveform_series_is_recorded(tmp_path: Path) -> None:
    capture, rig = played(tmp_path, "waveform", "scope", {"shot": 4, "sample": 32}, [])
    planned = load_plan(
        "waveform-series", {"scan.shots": 4, "scan.samples": 32, "scan.zero_s": 3e-9, "scan.averages": 2}
    )
    taken(planned, rig, tmp_path / "out.zarr")
    found = capture_of(tmp_path / "out.zarr")
    assert np.allclose(found.signal.values, capture.signal.values, rtol=1e-6) and found.signal.attrs["units"] == "DN"
    assert np.allclose(found.time.values, capture.time.values - 3e-9, rtol=0, atol=1e-18)


def test_a_line_survey_is_recorded(tmp_path: Path) -> None:
    capture, rig = played(tmp_path, "laser_line", "camera", {"frame": 6, "row": 256, "col": 192}, ["laser"])
    lit = capture.laser_on.values
    assert 0 < lit.sum() < 6
    planned = load_plan("line-survey", {"scan.frames": None, "scan.positions_m": [[0.0, 0.0, 0.0], [0.1, 0.0, 0.0]]})
    taken(planned, rig, tmp_path / "out.zarr")
    found = capture_of(tmp_path / "out.zarr")
    assert found.laser_on.values.tolist() == [False, False, True, True]
    assert np.array_equal(found.counts.values[2:], capture.counts.values[lit][:2])
    assert np.array_equal(found.counts.values[0], capture.counts.values[~lit][0])
    assert found.pose.values[:, 0].tolist() == [0.0, 0.0, 0.0, 0.1]


def test_a_wavefront_sequence_is_recorded(tmp_path: Path) -> None:
    capture, rig = played(tmp_path, "wavefront", "camera", {"frame": 3, "row": 176, "col": 176}, ["source"])
    planned = load_plan("wavefront-sequence", {"scan.frames": 3, "scan.reference": 2})
    taken(planned, rig, tmp_path / "out.zarr")
    found = capture_of(tmp_path / "out.zarr")
    assert np.array_equal(found.counts.values, capture.counts.values)
    assert np.array_equal(found.reference.values, np.rint(capture.reference.values))


def test_replay_refuses_what_was_not_recorded(tmp_path: Path) -> None:
    write(tmp_path / "s.zarr", example_capture("gated", optional=False))
    device = Replay(str(tmp_path / "s.zarr"))
    device.open()
    with pytest.raises(InputError, match="Nothing was recorded"):
        device.configure({"delay_s": 77e-9})


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
