"""Recordings of every modality, from a capture that is played back."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from beambench.captures.drivers.replay import Replay
from beambench.captures.example import example_capture
from beambench.captures.recording.plan import RigFile, load_plan, load_rig
from beambench.captures.store.writer import write
from beambench.scenes.errors import InputError

from ._emulated import SHAPE
from ._recorded import capture_of, plan, rig_data, taken


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
