"""Waveforms whose shots start at their own times and have outgoing pulses of their own, samples that are not sound, and shots of
several returns."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest
import xarray as xr

import beambench
from beambench.benchmarks.judges.bound import bound_of, elements_of, truth_of
from beambench.benchmarks.laws.gated import clean_capture as gated_capture
from beambench.benchmarks.laws.waveform import clean_capture, counted_capture
from beambench.benchmarks.scores.truth import errors_of
from beambench.captures import hide_truth, make_capture, open_captures, write
from beambench.captures.layouts import layout_of
from beambench.captures.validate import validate
from beambench.estimators import get_estimator, list_estimators, run_estimator
from beambench.estimators.waveform.record import read_record
from beambench.optics.constants import C_M_PER_S
from beambench.scenes.errors import InputError

NAMES = list_estimators("waveform")


def read_by(name: str) -> xr.Dataset:
    """A capture that an estimator can read, with its truth."""
    one = get_estimator(name)
    return next(c for c in (clean_capture(), counted_capture()) if not one.unfit(hide_truth(c)))


def with_vars(capture: xr.Dataset, **values: tuple[tuple[str, ...], Any]) -> xr.Dataset:
    """The capture with further variables of its layout."""
    schema = layout_of("waveform").by_name
    made = {
        name: xr.Variable(dims, array, {"units": schema[name].units[0], "long_name": schema[name].long_name})
        for name, (dims, array) in values.items()
    }
    coords = {name: one for name, one in made.items() if schema[name].role == "coord"}
    rest = {name: one for name, one in made.items() if schema[name].role != "coord"}
    found = capture.assign_coords(coords).assign(rest)
    if "truth_kind" in found.attrs:
        validate(found)
    return found


def half(capture: xr.Dataset) -> float:
    return C_M_PER_S / (2 * json.loads(capture.attrs["rig"])["medium"]["group_index"])


def pulses(capture: xr.Dataset, shift_s: np.ndarray[Any, Any]) -> xr.Dataset:
    """The declared response as the outgoing pulse of each shot, later by shift_s on the clock of the records."""
    response = json.loads(capture.attrs["rig"])["response"]
    value = np.asarray(response["value"])
    step = response["step_s"]
    pad = int(np.ceil(2e-9 / step))
    grid = response["start_s"] + step * np.arange(-pad, value.size + pad)
    rows = [np.interp(grid - s, response["start_s"] + step * np.arange(value.size), value, 0.0, 0.0) for s in shift_s]
    return with_vars(capture, pulse=(("shot", "pulse_sample"), np.array(rows)), pulse_time=(("pulse_sample",), grid))


def mean_time(capture: xr.Dataset) -> float:
    """Centroid of the declared response, s."""
    response = json.loads(capture.attrs["rig"])["response"]
    value = np.asarray(response["value"])
    return float(response["start_s"] + response["step_s"] * (np.arange(value.size) * value).sum() / value.sum())


@pytest.mark.parametrize("name", NAMES)
def test_every_estimator_adds_the_start_of_each_record(name: str) -> None:
    capture = hide_truth(read_by(name))
    # Whole nanoseconds: the counter counts whole cycles of 1 GHz.
    start = 1e-9 * (np.arange(capture.sizes["shot"]) % 5)
    plain, moved = (run_estimator(name, c) for c in (capture, with_vars(capture, start=(("shot",), start))))
    np.testing.assert_array_equal(moved["valid"].values, plain["valid"].values)
    shift = (moved["range"] - plain["range"]).values
    assert plain["valid"].values.any()
    np.testing.assert_allclose(shift[plain["valid"].values], (start * half(capture))[plain["valid"].values], atol=1e-9)
    if "return_range" in moved:
        np.testing.assert_allclose(
            (moved["return_range"] - plain["return_range"]).values[:, 0], start * half(capture), atol=1e-9
        )


@pytest.mark.parametrize("name", NAMES)
def test_every_estimator_times_from_the_centroid_of_its_own_pulse(name: str) -> None:
    """Pulses that leave up to 1.5 ns later: the same echoes then have travelled for a shorter time. The response that the rig
    declares is not read: it is replaced by one that lies elsewhere and is twice as wide."""
    capture = hide_truth(read_by(name))
    late = 0.5e-9 * (np.arange(capture.sizes["shot"]) % 4)
    held = pulses(capture, late)
    rig = json.loads(capture.attrs["rig"])
    rig["response"]["step_s"] *= 2
    rig["response"]["start_s"] += 3e-9
    held = held.assign_attrs(rig=json.dumps(rig))
    plain, found = run_estimator(name, capture), run_estimator(name, held)
    both = plain["valid"].values & found["valid"].values
    assert both.sum() >= 0.9 * plain["valid"].values.sum() > 0
    # The pulse is the response here: its centroid is that of the light plus the delay of the detector, which is taken out.
    expected = plain["range"].values - (late + mean_time(capture)) * half(capture)
    error = (found["range"].values - expected)[both]
    # A cycle of the counter is 15 cm; the edge's walk is that of each group of equal pulses and not of the whole capture.
    limit = {"waveform-counter": 0.16, "waveform-leading-edge": 0.02}.get(name, 1e-3)
    assert np.abs(error).max() < limit


def test_the_shape_of_the_pulse_is_that_of_the_shot() -> None:
    """A wider pulse in half of the shots: with its own template the likelihood reaches its stated error, with that of the
    others it does not."""
    capture = clean_capture()
    rng = np.random.default_rng(5)
    time = capture["time"].values
    step = time[1] - time[0]
    width = np.where(np.arange(48) % 2 == 0, 0.4e-9, 1.0e-9)
    grid = 2.5e-11 * np.arange(-200, 201)
    shape = np.exp(-0.5 * (grid / width[:, None]) ** 2)
    tau = capture["truth_range"].values / half(capture)
    echo = np.exp(-0.5 * ((time - tau[:, None]) / width[:, None]) ** 2) * step / (width[:, None] * np.sqrt(2 * np.pi))
    signal = np.rint(40 + rng.poisson(4000 * echo + 4) + rng.normal(0, 3, echo.shape)).astype(np.uint16)
    held = hide_truth(capture).assign(signal=capture["signal"].copy(data=signal))
    held = with_vars(held, pulse=(("shot", "pulse_sample"), shape), pulse_time=(("pulse_sample",), grid))
    found = run_estimator("waveform-ml", held)
    z = ((found["range"].values - capture["truth_range"].values) / found["sigma"].values)[found["valid"].values]
    assert found["valid"].values.all()
    assert 0.65 < np.sqrt((z**2).mean()) < 1.4  # 48 shots: a standard error of a tenth
    sigma = found["sigma"].values
    assert sigma[1::2].mean() > 1.5 * sigma[::2].mean()


def test_the_declared_response_of_the_detector_is_convolved() -> None:
    """pulse ⊗ exp(−t/T)/T lags by T, which the template then holds."""
    capture = hide_truth(clean_capture())
    grid = 2.5e-11 * np.arange(-200, 201)
    shape = np.tile(np.exp(-0.5 * (grid / 0.4e-9) ** 2), (48, 1))
    held = with_vars(capture, pulse=(("shot", "pulse_sample"), shape), pulse_time=(("pulse_sample",), grid))
    rig = json.loads(held.attrs["rig"])
    late = 2.5e-11 * np.arange(300)
    rig["detector_response"] = {"start_s": 0.0, "step_s": 2.5e-11, "value": np.exp(-late / 0.6e-9).tolist()}
    plain = read_record(held)
    both = read_record(held.assign_attrs(rig=json.dumps(rig)))
    assert plain.share.centroid_s - both.share.centroid_s == pytest.approx(0.6e-9, abs=2e-11)
    assert both.share.variance_s2 - plain.share.variance_s2 == pytest.approx(0.36e-18, rel=0.02)


def test_a_reader_of_one_pulse_refuses_several() -> None:
    held = pulses(hide_truth(clean_capture()), np.linspace(0, 1e-9, 48))
    with pytest.raises(InputError, match="different outgoing pulses"):
        read_record(held)


def test_a_shot_without_a_pulse_has_no_answer() -> None:
    held = pulses(hide_truth(clean_capture()), np.zeros(48))
    held["pulse"].values[3] = np.nan
    held["pulse"].values[4] = 0.0
    valid = run_estimator("waveform-ml", held)["valid"].values
    assert not valid[[3, 4]].any() and valid.sum() == 46
    held["pulse"].values[:] = np.nan
    with pytest.raises(InputError, match="outgoing pulse"):
        run_estimator("waveform-ml", held)


def test_dark_shots_serve_every_pulse() -> None:
    capture = hide_truth(clean_capture())
    lit = np.arange(48) % 6 > 0
    held = with_vars(pulses(capture, 0.3e-9 * (np.arange(48) % 3)), laser_on=(("shot",), lit))
    found = run_estimator("waveform-average[background=off-shots]", held)
    assert not found["valid"].values[~lit].any() and found["valid"].values[lit].all()


@pytest.mark.parametrize("name", NAMES)
def test_a_sample_that_is_not_sound_is_a_missing_one(name: str) -> None:
    capture = hide_truth(read_by(name))
    rng = np.random.default_rng(2)
    sound = rng.random(capture["signal"].shape) > 0.02
    spoilt = capture["signal"].values.copy()
    spoilt[~sound] = 3000
    marked = with_vars(
        capture.assign(signal=capture["signal"].copy(data=spoilt)), valid_sample=(("shot", "sample"), sound)
    )
    missing = capture.assign(signal=capture["signal"].copy(data=np.where(sound, spoilt, np.nan)))
    one, other = run_estimator(name, marked), run_estimator(name, missing)
    for variable in ("range", "sigma", "valid"):
        np.testing.assert_array_equal(one[variable].values, other[variable].values)


def test_unsound_samples_of_a_stack_are_missing_ones() -> None:
    capture = hide_truth(gated_capture())
    sound = np.random.default_rng(2).random(capture["counts"].shape) > 1e-3
    spoilt = np.where(sound, capture["counts"].values, 4095).astype(np.uint16)
    units = {"units": "1", "long_name": "whether the sample was recorded soundly"}
    marked = capture.assign(
        counts=capture["counts"].copy(data=spoilt), valid_sample=(capture["counts"].dims, sound, units)
    )
    validate(marked.assign_attrs(truth_kind="none", capture_key=0).assign(
        {n: gated_capture()[n] for n in gated_capture().data_vars if n.startswith("truth_")}))  # fmt: skip
    missing = capture.assign(counts=capture["counts"].copy(data=np.where(sound, spoilt, np.nan).astype(np.float32)))
    for name in list_estimators("gated"):
        one, other = run_estimator(name, marked), run_estimator(name, missing)
        for variable in ("range", "sigma", "valid"):
            np.testing.assert_array_equal(one[variable].values, other[variable].values, err_msg=name)
    whole = gated_capture()
    flagged = whole.assign(valid_sample=(whole["counts"].dims, sound, units))
    assert (bound_of(whole).kind, bound_of(flagged).kind) == ("exact", "quasi")


def test_a_bound_counts_from_the_start_of_each_record_and_without_unsound_samples() -> None:
    capture = clean_capture()
    plain = bound_of(capture)
    start = np.linspace(0, 3e-9, 48)
    moved = with_vars(capture, start=(("shot",), start))
    moved = moved.assign(truth_range=capture["truth_range"] + start * half(capture))
    np.testing.assert_allclose(bound_of(moved).sigma, plain.sigma, rtol=1e-6)
    np.testing.assert_allclose(elements_of(moved)[1].delay_s, elements_of(capture)[1].delay_s, atol=1e-15)
    sound = np.ones(capture["signal"].shape, bool)
    sound[:, capture["signal"].values.sum(axis=0).argmax()] = False
    assert (bound_of(with_vars(capture, valid_sample=(("shot", "sample"), sound))).sigma >= plain.sigma).all()
    none = bound_of(pulses(capture, np.zeros(48)))
    assert none.kind == "none" and none.scale == pytest.approx(plain.scale, rel=1e-2)


def test_several_returns_are_scored_by_the_nearest() -> None:
    capture = clean_capture()
    first = capture["truth_range"].values
    returns = np.stack([first, first + 0.5, np.full(48, np.nan)], axis=1)
    returns[:10, 1] = np.nan
    held = with_vars(capture, truth_returns=(("shot", "return"), returns))
    truth = truth_of(held)
    assert truth.mixed.tolist() == [False] * 10 + [True] * 38
    np.testing.assert_allclose(errors_of(first + 0.51, truth), np.where(truth.mixed, 0.01, 0.51), atol=1e-12)
    np.testing.assert_allclose(errors_of(first - 0.01, truth), -0.01, atol=1e-12)
    with pytest.raises(InputError, match="truth_returns"):
        with_vars(capture, truth_returns=(("shot", "return"), -returns))


def test_the_store_and_the_export_carry_them(tmp_path: Path) -> None:
    capture = pulses(clean_capture(), np.linspace(0, 1e-9, 48))
    capture = with_vars(
        capture, start=(("shot",), np.linspace(0, 1e-8, 48)),
        valid_sample=(("shot", "sample"), np.ones(capture["signal"].shape, bool)),
        truth_returns=(("shot", "return"), np.tile(capture["truth_range"].values[:, None], (1, 2))),
    )  # fmt: skip
    write(tmp_path / "store", capture)
    again = open_captures(tmp_path / "store")[0]
    names = ("pulse", "pulse_time", "start", "valid_sample", "truth_returns")
    for name in names:
        np.testing.assert_array_equal(again[name].values, capture[name].values)
        assert again[name].attrs["units"] == capture[name].attrs["units"]
    hidden = hide_truth(again)
    assert set(names) - set(hidden.variables) == {"truth_returns"}
    beambench.export(tmp_path / "store", out=tmp_path / "captures.h5")
    with h5py.File(tmp_path / "captures.h5") as file:
        assert set(names[:4]) <= set(file) and "truth_returns" not in file
        assert file["pulse"].attrs["dims"] == "capture shot pulse_sample"
    beambench.estimate(tmp_path / "store", ["waveform-ml"], out=tmp_path / "estimates")
    (row,) = beambench.score(tmp_path / "store", tmp_path / "estimates", out=tmp_path / "scores").to_dict("records")
    assert row["status"] == "ok" and row["bound_kind"] == "none"


def test_a_pulse_needs_its_times() -> None:
    rig = json.loads(clean_capture().attrs["rig"])
    attrs = {"rig": rig, "truth_kind": "none"}
    with pytest.raises(InputError, match="outgoing pulse") as caught:
        make_capture(
            "waveform", {"signal": np.zeros((2, 8)), "pulse": np.ones((2, 4))}, {"time": np.arange(8.0)}, {}, attrs
        )
    assert "pulse_time" in caught.value.allowed
