"""Recorded traces of an oscilloscope whose segments start at times of their own: with `start` the triggered edge stands still."""

from __future__ import annotations

import struct
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest

from beambench.captures import make_capture
from beambench.estimators import run_estimator
from beambench.optics.constants import C_M_PER_S

#: What is added to all times, so that the instant of the trigger is a positive range.
ZERO_S = 1e-6


def segments(path: Path) -> tuple[npt.NDArray[np.float64], float, npt.NDArray[np.float64]]:
    """(signal in V (segment, sample), step [s], time of each first sample after its trigger [s]) of a LeCroy sequence file
    (template LECROY_2_3, little-endian 16-bit samples)."""
    data = path.read_bytes()
    at = data.index(b"WAVEDESC")

    def read(offset: int, kind: str) -> Any:
        return struct.unpack_from("<" + kind, data, at + offset)[0]

    assert (read(32, "h"), read(34, "h")) == (1, 1)
    count = read(144, "i")
    begin = at + read(36, "i") + read(40, "i")
    triggers = np.frombuffer(data, "<f8", 2 * count, begin).reshape(count, 2)
    raw = np.frombuffer(data, "<i2", read(60, "i") // 2, begin + read(48, "i") + read(52, "i"))
    volts = raw.reshape(count, -1) * float(read(156, "f")) - float(read(160, "f"))
    return volts, float(read(176, "f")), triggers[:, 1].copy()


def edge_times(volts: npt.NDArray[np.float64], step: float, start: npt.NDArray[np.float64] | None) -> Any:
    """Times of the echoes after the trigger, from a capture of which only the shape of the pulse is known."""
    shape = volts.mean(axis=0)[355:395] - np.median(volts)
    shape = np.clip(shape, 0, None)
    response = {"start_s": -10 * step, "step_s": step, "value": shape.tolist()}
    names = ("gain_dn_per_e", "read_noise_e", "full_well_e", "adc_bits")
    readout = {"kind": "analog", "offset_dn": 0.0} | dict.fromkeys(names)
    rig = {"schema": 1, "kind": "waveform", "response": response, "detector": {"readout": readout},
           "medium": {"group_index": 1.0}, "pulses_per_shot": None}  # fmt: skip
    coords: dict[str, Any] = {"time": step * np.arange(volts.shape[1])}
    if start is not None:
        coords["start"] = start + ZERO_S
    capture = make_capture("waveform", {"signal": volts}, coords, {}, {"rig": rig, "truth_kind": "none"})
    found = run_estimator("waveform-constant-fraction", capture)
    return 2 * found["range"].values / C_M_PER_S, found["valid"].values


@pytest.mark.data
def test_the_trigger_stands_still_with_the_starts_of_the_segments(real_data: Path) -> None:
    volts, step, start = segments(real_data / "wf_lecroy" / "pulse_sequence.trc")
    assert volts.shape == (20, 502) and step == pytest.approx(1e-9)
    assert start.std() > 0.2e-9  # a trigger falls anywhere between two samples
    still, valid = edge_times(volts, step, start)
    moving, _ = edge_times(volts, step, None)
    assert valid.sum() >= 18
    # The sampling clock runs free: without the starts the edge scatters by a uniform part of a step, 1 ns/√12 = .29 ns; what is
    # left with them, .15 ns, is that of trigger and pulses.
    assert still[valid].std() < 0.6 * moving[valid].std()
