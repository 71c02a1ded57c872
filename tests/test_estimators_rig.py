"""The reader of the declared rig refuses missing and invalid values, with path and value."""

from __future__ import annotations

import copy
import json
from typing import Any

import numpy as np
import pytest
import xarray as xr

from beambench.captures.hide import hide_truth
from beambench.estimators import run_estimator
from beambench.estimators.rig import Amplifier, read_rig, samples_of
from beambench.generator.generate import generate
from beambench.scenes.errors import InputError
from beambench.scenes.load import load_scene

RIG: dict[str, Any] = {
    "schema": 1,
    "kind": "toy",
    "detector": {"gain_dn_per_e": 2.0, "offset_dn": 100, "read_noise_e": 3.0, "full_well_e": 1e4, "adc_bits": 12,
                 "tube": {"gain": 50.0, "excess_noise_factor": 1.6}, "none": None},
    "gates": [{"start_s": 0.0, "step_s": 1e-9, "value": [0.0, 1.0, 1.0, 0.0]}],
    "window_m": [1.0, 9.0],
    "word": "analog",
}  # fmt: skip

#: A small scene of each modality, an estimator that reads it, and values without which its captures cannot be read.
READ = {
    "flat-wall": ("peak", ("camera.rows", "camera.focal_length_m", "laser.position_m", "laser.jitter_shot_s", "pulse",
                           "gates", "gates.0.value", "medium.group_index", "detector.gain_dn_per_e",
                           "detector.adc_bits", "pulses_per_slice")),
    "photodetector-5m": ("waveform-average", ("response", "detector.readout", "detector.readout.kind",
                                              "detector.readout.gain_dn_per_e", "detector.readout.offset_dn",
                                              "detector.readout.full_well_e", "detector.readout.adc_bits",
                                              "pulses_per_shot", "medium.group_index")),
    "single-photon": ("waveform-average", ("detector.readout.dead_time_s", "medium.group_index")),
    "amcw": ("amcw-phase", ("detector.read_noise_e", "modulation.frequencies_hz", "modulation.phase_steps",
                            "range_window_m", "t0_s", "medium.group_index")),
}  # fmt: skip


def _capture(rig: object) -> xr.Dataset:
    return xr.Dataset(attrs={"rig": rig if isinstance(rig, str) else json.dumps(rig)})


def _without(rig: dict[str, Any], path: str) -> dict[str, Any]:
    changed = copy.deepcopy(rig)
    *parents, last = path.split(".")
    node: Any = changed
    for part in parents:
        node = node[int(part)] if isinstance(node, list) else node[part]
    del node[last]
    return changed


def test_values_are_read_by_path() -> None:
    rig = read_rig(_capture(RIG), "toy")
    assert rig.need("gates.0.step_s") == 1e-9 and rig.get("gates.1") is None and rig.get("word.x") is None
    assert rig.number("detector.offset_dn", least=0) == 100.0
    assert rig.whole("detector.adc_bits") == 12 and rig.word("word", "analog", "single-photon") == "analog"
    np.testing.assert_array_equal(rig.numbers("window_m", length=2), [1.0, 9.0])
    assert rig.samples("gates.0").step_s == 1e-9
    # The clip: the least of the converter's top, 4095, and 100 + 2·(10⁴ − 4·3).
    converter = rig.converter("detector")
    assert converter.saturation_dn == 4095.0 and converter.floor_e2 == 3.0**2 + 1 / (12 * 2.0**2)
    assert rig.amplifier("detector.tube") == Amplifier(50.0, 1.6)
    assert rig.amplifier("detector.none") == rig.amplifier("detector.no") == Amplifier(1.0, 1.0)


def test_equal_texts_are_parsed_once() -> None:
    text = json.dumps(RIG)
    one, two = read_rig(_capture(text)), read_rig(_capture(json.dumps(json.loads(text))))
    assert one is two and one.key != read_rig(_capture(RIG | {"kind": "other"})).key


@pytest.mark.parametrize(
    ("attribute", "what"),
    [
        (None, "no declared rig"),
        (5, "no declared rig"),
        ("{", "not JSON"),
        ("[]", "not an object"),
        (json.dumps(RIG | {"kind": "gated"}), "not that of a toy capture"),
        (json.dumps(RIG | {"schema": 2}), "unknown schema"),
    ],
)
def test_an_attribute_that_is_no_rig_is_refused(attribute: object, what: str) -> None:
    with pytest.raises(InputError, match=what) as caught:
        read_rig(xr.Dataset(attrs={"rig": attribute} if attribute is not None else {}), "toy")
    assert caught.value.where.startswith("attribute rig") and caught.value.allowed


@pytest.mark.parametrize("value", ["3", True, None, float("nan"), float("inf"), [1], -1.0])
def test_a_number_is_finite_and_within_its_limits(value: object) -> None:
    rig = read_rig(_capture(RIG | {"x": value}))
    with pytest.raises(InputError) as caught:
        rig.number("x", least=0)
    assert caught.value.where == "attribute rig: x" and "0 or more" in caught.value.allowed
    with pytest.raises(InputError, match="cannot be used"):
        read_rig(_capture(RIG | {"x": [1.0, value]})).numbers("x", least=0)
    with pytest.raises(InputError, match="cannot be used"):
        rig.whole("x")


def test_a_number_of_hundreds_of_digits_is_refused_with_the_rig() -> None:
    with pytest.raises(InputError, match="a whole number of 401 digits"):
        read_rig(_capture(RIG | {"x": 10**400}))


def test_other_values_are_checked() -> None:
    rig = read_rig(_capture(RIG | {"half": 0.5, "zero": 0.0}))
    for bad in (
        lambda: rig.whole("half"),
        lambda: rig.whole("detector.adc_bits", most=8),
        lambda: rig.number("zero", above=0),
        lambda: rig.numbers("window_m", length=3),
        lambda: rig.word("word", "digital"),
        lambda: rig.need("detector.gates"),
        lambda: rig.samples("detector"),
        lambda: rig.amplifier("detector"),
    ):
        with pytest.raises(InputError) as caught:
            bad()
        assert caught.value.where.startswith("attribute rig: ") and caught.value.allowed


@pytest.mark.parametrize(
    "change", [{"step_s": 0}, {"value": [1.0]}, {"value": [0.0, 0.0]}, {"start_s": float("nan")}, {"value": "flat"}]
)
def test_samples_are_two_or_more_of_positive_sum(change: dict[str, Any]) -> None:
    with pytest.raises(InputError) as caught:
        samples_of({"start_s": 0.0, "step_s": 1e-9, "value": [0.0, 1.0]} | change, "attribute rig: pulse")
    assert caught.value.where == "attribute rig: pulse"


@pytest.mark.parametrize("scene", sorted(READ))
def test_every_missing_value_is_named(scene: str) -> None:
    """No KeyError: each value that an estimator needs is refused by its path where the rig lacks it."""
    label, paths = READ[scene]
    small = {"rig.camera.rows": 4, "rig.camera.cols": 4} if scene == "flat-wall" else {}
    capture = hide_truth(generate(load_scene(scene, small), seed=1))
    rig = json.loads(capture.attrs["rig"])
    run_estimator(label, capture)
    for path in paths:
        with pytest.raises(InputError) as caught:
            run_estimator(label, capture.assign_attrs(rig=json.dumps(_without(rig, path))))
        assert path.startswith(caught.value.where.removeprefix("attribute rig: ")) or caught.value.where.startswith(
            f"attribute rig: {path}"
        ), (path, str(caught.value))
