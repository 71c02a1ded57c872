"""Values that the declared rig states as unknown (null): an answer that does not need them, one from a measurement that the page
describes, or a refusal that names the value."""

from __future__ import annotations

import json
from typing import Any

import numpy as np
import pytest
import xarray as xr

from beambench.benchmarks.bounds.instrument import true_scene
from beambench.benchmarks.judges.bound import bound_of
from beambench.benchmarks.laws.amcw import clean_capture as amcw_capture
from beambench.benchmarks.laws.check import fed, maker_of
from beambench.benchmarks.laws.gated import clean_capture as gated_capture
from beambench.benchmarks.laws.maker import Maker
from beambench.benchmarks.laws.waveform import clean_capture as waveform_capture
from beambench.captures.hide import hide_truth
from beambench.estimators import get_estimator, list_estimators, run_estimator
from beambench.estimators.gated.tools.stack import read_stack
from beambench.estimators.rig import read_rig
from beambench.estimators.waveform.record import read_record
from beambench.generator.generate import generate
from beambench.scenes.errors import InputError
from beambench.scenes.load import load_scene

from ._rig_page import TABLES


def without(capture: xr.Dataset, *paths: str) -> xr.Dataset:
    """The capture with these values of its declared rig stated as unknown."""
    rig = json.loads(capture.attrs["rig"])
    for path in paths:
        node: Any = rig
        *parents, last = path.split(".")
        for part in parents:
            node = node[part]
        node[last] = None
    return capture.assign_attrs(rig=json.dumps(rig))


@pytest.mark.parametrize("name", list_estimators())
def test_an_unknown_value_is_not_needed_or_named(name: str) -> None:
    one = get_estimator(name)
    maker = Maker(maker_of(one.stage.word).laws, one.stage, one.unfit)
    clean = maker.clean()
    known = run_estimator(fed(name), clean)
    rig, answered = read_rig(clean), 0
    keys = [key for key in TABLES[one.modality] if key.applies(rig)]
    for key in keys if name != "spectrum-reml" else keys[::6]:  # a second and more for each
        place = key.path.removesuffix(".*")
        if rig.get(place) is None:
            continue
        try:
            found = run_estimator(fed(name), without(clean, place))
        except InputError as error:
            assert place in str(error) and (error.allowed or error.next_step), (place, str(error))
            continue
        answered += 1
        quantity, valid = one.stage.gives[0].name, found["valid"].values
        assert np.isfinite(found[quantity].values[valid]).all() and (found["sigma"].values[valid] > 0).all(), place
        # What is measured in place of the value moves weights and thresholds a little, within the noise of the answer.
        both = valid & known["valid"].values
        assert both.any() == known["valid"].values.any(), place
        shift = np.abs(found[quantity] - known[quantity]).values[both]
        assert (shift <= 2.0 * known["sigma"].values[both]).all(), (place, shift.max())
    assert answered > 0


def test_read_noise_is_measured_in_slices_with_the_laser_off() -> None:
    changes = {
        "rig.camera.rows": 16, "rig.camera.cols": 16, "rig.delays.laser_off": 40, "rig.detector.read_noise_e": 7.0,
        "rig.detector.gain_dn_per_e": 0.5, "rig.detector.dark_current_e_per_s": 0.0, "rig.ambient_e_per_s": 0.0,
    }  # fmt: skip
    capture = hide_truth(generate(load_scene("flat-wall", changes), seed=3))
    told = read_stack(capture).instrument
    measured = read_stack(without(capture, "detector.read_noise_e")).instrument
    # 256 pixels of 39 degrees of freedom: σ has a standard error of 1/√(2·9984) = .7 %, its square of twice that.
    assert measured.floor_var == pytest.approx(told.floor_var, rel=5 * 0.014)
    assert measured.key != told.key
    few = without(capture, "detector.read_noise_e").isel(slice=slice(0, -39))
    with pytest.raises(InputError, match="laser off") as caught:
        run_estimator("peak", few)
    assert "detector.read_noise_e" in caught.value.where and "laser_on" in caught.value.next_step


def test_shot_noise_of_dark_slices_is_not_taken_for_read_noise() -> None:
    """200 electrons of dark charge a slice: variance 249, of which 49 are read noise."""
    changes = {
        "rig.camera.rows": 16, "rig.camera.cols": 16, "rig.delays.laser_off": 60, "rig.detector.read_noise_e": 7.0,
        "rig.detector.gain_dn_per_e": 0.5, "rig.detector.dark_current_e_per_s": 2e4, "rig.detector.exposure_s": 0.01,
        "rig.ambient_e_per_s": 0.0,
    }  # fmt: skip
    capture = hide_truth(generate(load_scene("flat-wall", changes), seed=3))
    measured = read_stack(without(capture, "detector.read_noise_e")).instrument.floor_var
    # The variance, 249, has a standard error of √(2/(256·59)) = 1.2 %, 2.9.
    assert measured == pytest.approx(49.0 + 1 / 3, abs=5 * 2.9)


def test_the_noise_of_a_record_is_measured_in_its_darker_half() -> None:
    capture = hide_truth(waveform_capture())
    told, place = read_record(capture), "detector.readout."
    measured = read_record(without(capture, place + "read_noise_e"))
    # Level 4: variance 4 F² + σ²; the sampled quantiles of 48 records of 128 agree to some 5 %.
    dark = told.variance(np.array(4.0))
    assert measured.variance(np.array(4.0)) == pytest.approx(float(dark), rel=0.25)
    bare = read_record(without(capture, place + "read_noise_e", place + "gain_dn_per_e", place + "full_well_e"))
    unit = float((told.z * bare.z).sum() / (bare.z**2).sum())
    assert bare.floor_var == 1 and unit == pytest.approx(np.sqrt(float(dark)), rel=0.15)
    # Shot noise: F² of one electron is F²/unit in standard deviations of the baseline; 48 echoes of some 12 samples.
    assert bare.excess * unit == pytest.approx(told.excess, rel=0.3)


def test_a_record_of_unknown_gain_reads_in_any_unit() -> None:
    """Volts or counts: the same answers, since the noise of the baseline is the unit."""
    capture = hide_truth(waveform_capture())
    place = "detector.readout."
    unknown = [place + name for name in ("gain_dn_per_e", "read_noise_e", "full_well_e", "adc_bits")] + [
        "pulses_per_shot"
    ]
    bare = without(capture, *unknown)
    rig = json.loads(bare.attrs["rig"])
    rig["detector"]["readout"]["offset_dn"] *= 2.0**-10
    signal = (bare["signal"] * 2.0**-10).astype(np.float64).assign_attrs(bare["signal"].attrs | {"units": "V"})
    volts = bare.assign(signal=signal).assign_attrs(rig=json.dumps(rig))
    truth = waveform_capture()["truth_range"].values
    for name in ("waveform-ml", "waveform-average", "waveform-constant-fraction", "waveform-several-returns"):
        one, other = run_estimator(name, bare), run_estimator(name, volts)
        np.testing.assert_array_equal(one["valid"].values, other["valid"].values)
        np.testing.assert_allclose(one["range"].values, other["range"].values, rtol=0, atol=1e-7)
        assert one["valid"].values.mean() > 0.9
        assert np.abs(one["range"].values - truth)[one["valid"].values].max() < 0.03
        if name == "waveform-ml":
            z = ((one["range"].values - truth) / one["sigma"].values)[one["valid"].values]
            # 48 shots: a standard error of a tenth, and 15 % of measured noise.
            assert 0.65 < np.sqrt((z**2).mean()) < 1.45


def test_a_flat_top_is_clipped_where_no_limit_is_known() -> None:
    capture = hide_truth(waveform_capture())
    place = "detector.readout."
    bare = without(capture, place + "full_well_e", place + "adc_bits")
    assert not read_record(bare).clipped.sum() > 1
    held = bare["signal"].values
    cut = bare.assign(
        signal=bare["signal"].copy(data=np.minimum(held, np.quantile(held.max(axis=1), 0.2).astype(held.dtype)))
    )
    assert read_record(cut).clipped.mean() > 0.7


def test_one_limit_stands_for_the_other() -> None:
    capture = hide_truth(gated_capture())
    whole = read_stack(capture).instrument
    top = read_stack(without(capture, "detector.full_well_e")).instrument.saturation_dn
    well = read_stack(without(capture, "detector.adc_bits")).instrument.saturation_dn
    assert whole.saturation_dn == min(top, well) and top != well
    with pytest.raises(InputError) as caught:
        run_estimator("peak", without(capture, "detector.full_well_e", "detector.adc_bits"))
    assert caught.value.where == "attribute rig: detector.adc_bits"


def test_pulses_weigh_slices_without_a_nominal_number() -> None:
    capture = hide_truth(gated_capture())
    unequal = capture.assign_coords(
        pulses=("slice", 1 + np.arange(capture.sizes["slice"]) % 2, capture["pulses"].attrs)
    )
    exposure = read_stack(without(unequal, "pulses_per_slice")).exposure
    assert sorted(set(exposure)) == [0.5, 1.0]
    even = read_stack(without(capture.drop_vars("pulses"), "pulses_per_slice"))
    assert (even.exposure == 1.0).all()
    np.testing.assert_array_equal(read_stack(capture.drop_vars("pulses")).exposure, read_stack(capture).exposure)


@pytest.mark.parametrize("make", [gated_capture, waveform_capture, amcw_capture])
def test_a_bound_names_the_value_that_it_needs(make: Any) -> None:
    capture = make()
    true_scene(capture)
    kept = capture.drop_vars([name for name in ("truth_amplitude", "truth_background") if name in capture])
    with pytest.raises(InputError, match="unknown") as caught:
        bound_of(without(kept, "medium.group_index"))
    assert "medium.group_index" in caught.value.where
    # What a bound does not need may be unknown.
    assert bound_of(without(capture, "pulses_per_shot" if "signal" in capture else "laser.wavelength_m")).kind != "none"
    if make is not amcw_capture:
        with pytest.raises(InputError, match="unknown") as caught:
            bound_of(without(capture, "t0_s"))
        assert caught.value.where == "attribute rig: t0_s"
