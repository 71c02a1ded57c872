"""The gate of every pixel from a scan over a surveyed wall: iris and skew of an intensifier, and what they do to time zero."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

import beambench
from beambench.estimators.calibration.gated_delay_scan import DELAY_SCAN, delay_scan_values
from beambench.estimators.calibration.gated_scan import DelayScan, read_scan
from beambench.generator.generate import generate
from beambench.optics.correlation.gate_maps import gate_offset_map
from beambench.scenes.errors import InputError
from beambench.scenes.load import load_scene
from beambench.scenes.rig_files import read_rig_file

#: Planted: the corners' gate opens 150 ps earlier, and it is skewed along x and y.
_IRIS_S, _SKEW_S = -150e-12, (60e-12, -40e-12)
_MAP = {"iris_s": _IRIS_S, "skew_s": list(_SKEW_S)}


def _scene(gate_map: dict[str, Any] | None, declared: dict[str, Any] | None) -> dict[str, Any]:
    # The wall is at 5 m: its echo is 33.4 ns after the pulse.
    delays = {"kind": "listed", "values_s": [28.5e-9 + k * 0.3e-9 for k in range(28)], "repeats": 8, "laser_off": 6}
    return {
        "rig.camera.rows": 20, "rig.camera.cols": 28, "rig.delays": delays,
        "rig.gate_map": gate_map, "declared": {"gate_map": declared},
    }  # fmt: skip


def _scan(seed: int, gate_map: dict[str, Any] | None, declared: dict[str, Any] | None) -> tuple[DelayScan, Any]:
    capture = generate(load_scene("flat-wall", _scene(gate_map, declared)), seed=seed)
    return read_scan(capture), capture["truth_range"].values


def test_iris_and_skew_are_found_with_their_errors() -> None:
    """Eight captures, three numbers each: errors over stated errors are 1 rms (.65 to 1.35 are 3 standard errors of 24)."""
    z = []
    for seed in range(8):
        timing = delay_scan_values(*_scan(seed, _MAP, None), mapped=True).timing
        assert timing is not None and timing.told
        for found, true in ((timing.iris, _IRIS_S), (timing.skew_x, _SKEW_S[0]), (timing.skew_y, _SKEW_S[1])):
            assert found.sigma < 8e-12
            z.append((found.value - true) / found.sigma)
    assert 0.65 < float(np.sqrt(np.mean(np.square(z)))) < 1.35


def test_an_even_gate_is_called_even_and_time_zero_is_that_of_the_middle() -> None:
    scan, range_m = _scan(3, None, None)
    even = delay_scan_values(scan, range_m, mapped=True)
    assert even.timing is not None and not even.timing.told
    assert even.timing.scatter_s < 2e-12
    mapped = delay_scan_values(*_scan(3, _MAP, None), mapped=True)
    t0 = mapped.numbers["rig.t0_s"]
    assert abs(t0.value) < 4 * t0.sigma + 3e-12, "the map's mean is no time zero"
    assert mapped.pulse.value == pytest.approx(even.pulse.value, abs=4 * np.hypot(mapped.pulse.sigma, even.pulse.sigma))


def test_a_declared_map_is_not_time_zero() -> None:
    found = delay_scan_values(*_scan(5, _MAP, _MAP), mapped=True)
    t0 = found.numbers["rig.t0_s"]
    assert abs(t0.value) < 4 * t0.sigma + 3e-12
    plain = delay_scan_values(*_scan(5, _MAP, _MAP)).numbers["rig.t0_s"]
    assert abs(plain.value) < 4 * plain.sigma + 3e-12, "declared maps hold without a calibration of them"
    assert found.timing is not None
    assert np.ptp(found.timing.offset_s) == pytest.approx(np.ptp(gate_offset_map(20, 28, _IRIS_S, _SKEW_S)), rel=0.1)


def test_the_rig_file_holds_the_map_and_a_scene_takes_it(tmp_path: Path) -> None:
    store = tmp_path / "scan.zarr"
    beambench.generate("flat-wall", overrides=_scene(_MAP, None), seeds=[1], out=store)
    made = beambench.calibrate([store], procedures=["delay-scan"], out=tmp_path / "rig.toml")
    held = read_rig_file(made.out)
    assert held.rig["gate_map"]["iris_s"] == pytest.approx(_IRIS_S, rel=0.1)
    assert held.uncertainty["rig.gate_map.skew_s.0"] < 8e-12
    scene = load_scene("flat-wall", held.overrides())
    assert scene.rig.gate_map.skew_s[0] == pytest.approx(_SKEW_S[0], rel=0.2)  # type: ignore[attr-defined]


def test_a_curved_target_tells_no_map() -> None:
    """A pixel of a sphere is not timed by the range of its middle: its map was told where the gate opened evenly."""
    rig = {name: value for name, value in _scene(None, None).items() if name != "declared"}
    capture = generate(load_scene("sphere", rig), seed=4)
    assert delay_scan_values(read_scan(capture), capture["truth_range"].values, mapped=True).timing is None


def test_pixels_that_look_past_the_light_say_nothing() -> None:
    """With a field ten times as wide as the light, an iris of 5 ns was told: it rested on a few dark pixels of the rim."""
    capture = generate(load_scene("flat-wall", _scene(_MAP, None) | {"rig.camera.pixel_pitch_m": 2.0e-4}), seed=3)
    timing = delay_scan_values(read_scan(capture), capture["truth_range"].values, mapped=True).timing
    assert timing is None


def test_a_scan_that_misses_the_target_is_refused() -> None:
    """It ended in a LinAlgError: no pixel has an echo, and nothing that is common to the pixels can be solved for."""
    late = {**_scene(None, None)["rig.delays"], "values_s": [60e-9 + k * 0.3e-9 for k in range(28)]}
    capture = generate(load_scene("flat-wall", _scene(None, None) | {"rig.delays": late}), seed=1)
    with pytest.raises(InputError, match="No pixel shows an echo"):
        delay_scan_values(read_scan(capture), capture["truth_range"].values)


def test_without_a_survey_no_map_is_stated() -> None:
    scan, _ = _scan(2, _MAP, None)
    assert delay_scan_values(scan, mapped=True).timing is None
    assert DELAY_SCAN.line
