"""One planted fault for each law breaks that law alone."""

from __future__ import annotations

import json
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
import xarray as xr

from beambench.benchmarks.judges import JUDGES
from beambench.benchmarks.laws.check import check_laws, maker_of
from beambench.benchmarks.laws.suite import laws_for
from beambench.captures.hide import hide_truth
from beambench.captures.layouts import layout_of
from beambench.optics.constants import C_M_PER_S


def _first(modality: str) -> str:
    """The stage of a modality that reads captures."""
    return layout_of(modality).stages[0].word


def _sound(capture: xr.Dataset) -> xr.Dataset:
    """Centroid of the samples above half of the echo's height: keeps every law."""
    rig = json.loads(capture.attrs["rig"])
    readout, raw = rig["detector"]["readout"], capture["signal"].values
    full = readout["offset_dn"] + readout["gain_dn_per_e"] * (readout["full_well_e"] - 4 * readout["read_noise_e"])
    top = min(2 ** readout["adc_bits"] - 1, full)
    bad = ~np.isfinite(raw).all(axis=1) | (raw >= top).any(axis=1) | (raw <= 0).any(axis=1)
    z = (np.where(np.isfinite(raw), raw, 0).astype(float) - readout["offset_dn"]) / readout["gain_dn_per_e"]
    z = z - np.median(z, axis=1, keepdims=True)
    top = z.max(axis=1, keepdims=True)
    weight = np.where(z > 0.5 * np.maximum(top, 1e-9), z, 0.0)
    valid = ~bad & (top[:, 0] > 50)
    time = capture["time"].values
    tau = time[0] + (weight * (time - time[0])).sum(axis=1) / np.maximum(weight.sum(axis=1), 1e-9)
    tau = tau + (capture["start"].values if "start" in capture.coords else 0.0)
    value = np.where(valid, tau * C_M_PER_S / (2 * rig["medium"]["group_index"]), np.nan)
    sigma = np.where(valid, 0.01, np.nan)
    return xr.Dataset({"range": ("shot", value), "sigma": ("shot", sigma), "valid": ("shot", valid)})


_CALLS = iter(range(10**9))
TOP = 4095


def _is_clean(data: np.ndarray) -> bool:
    top = data.max(axis=1)
    # Where many shots have one height, it is that of a clip.
    return data.dtype.kind == "u" and bool((top > 200).all()) and np.unique(top, return_counts=True)[1].max() < 10


def _claim(result: xr.Dataset, where: object) -> None:
    """Mark elements as valid, for any range."""
    result["valid"].values[where] = True  # type: ignore[index]


def _contract(capture: xr.Dataset, data: np.ndarray, result: xr.Dataset) -> None:
    result["valid"] = result["valid"].astype(np.int8)


def _refuses(capture: xr.Dataset, data: np.ndarray, result: xr.Dataset) -> None:
    readout = json.loads(capture.attrs["rig"])["detector"]["readout"]
    electrons = (np.nan_to_num(data).astype(float) - readout["offset_dn"]).sum(axis=1) / readout["gain_dn_per_e"]
    result["valid"].values[np.rint(electrons) % 10 > 2] = False


def _negative_sigma(capture: xr.Dataset, data: np.ndarray, result: xr.Dataset) -> None:
    if _is_clean(data):
        result["sigma"].values[7] *= -1


def _boasts(capture: xr.Dataset, data: np.ndarray, result: xr.Dataset) -> None:
    """States less than the noise makes."""
    if _is_clean(data):
        result["sigma"] /= 30.0


def _drifts(capture: xr.Dataset, data: np.ndarray, result: xr.Dataset) -> None:
    result["range"].values[:] += 1e-12 * next(_CALLS)


def _marks(capture: xr.Dataset, data: np.ndarray, result: xr.Dataset) -> None:
    capture.attrs["seen"] = "by me"


def _ignores_time(capture: xr.Dataset, data: np.ndarray, result: xr.Dataset) -> None:
    result["range"].values[:] -= 0.01 * 0.1 * (capture["time"].values[0] - 30e-9) / 1e-9


def _ignores_start(capture: xr.Dataset, data: np.ndarray, result: xr.Dataset) -> None:
    if "start" in capture.coords:
        result["range"].values[:] -= capture["start"].values * C_M_PER_S / 2


def _uses_counts(capture: xr.Dataset, data: np.ndarray, result: xr.Dataset) -> None:
    result["range"].values[:] += 1e-6 * np.nan_to_num(data).max(axis=1)


def _by_place(capture: xr.Dataset, data: np.ndarray, result: xr.Dataset) -> None:
    result["range"].values[:] += 1e-5 * np.arange(len(data))


def _zero(capture: xr.Dataset, data: np.ndarray, result: xr.Dataset) -> None:
    if data.max() == 0:
        _claim(result, 3)


def _saturated(capture: xr.Dataset, data: np.ndarray, result: xr.Dataset) -> None:
    if data.min() == TOP:
        _claim(result, 3)


def _constant(capture: xr.Dataset, data: np.ndarray, result: xr.Dataset) -> None:
    if data.min() == data.max() == 100:
        _claim(result, 3)


def _one_sample(capture: xr.Dataset, data: np.ndarray, result: xr.Dataset) -> None:
    if np.unique(data).size == 2 and data.max() == TOP:
        _claim(result, 3)


def _clipped(capture: xr.Dataset, data: np.ndarray, result: xr.Dataset) -> None:
    if np.unique(data).size > 2 and data.max() == TOP:
        _claim(result, 3)


def _nan(capture: xr.Dataset, data: np.ndarray, result: xr.Dataset) -> None:
    _claim(result, np.isnan(data).all(axis=1))


def _clipped_at(capture: xr.Dataset, data: np.ndarray, result: xr.Dataset, number: int) -> None:
    """Claim and pull the shots whose brightest samples are clipped at a low full well, about `number` of them in the median."""
    at_top = (data == data.max(axis=1, keepdims=True)).sum(axis=1)
    if data.dtype.kind == "u" and data.max() < TOP and np.unique(data.max(axis=1)).size < 30 and data.min() > 0:
        typical = int(np.median(at_top))
        if number == (1 if typical < 2 else 3 if typical < 4 else 5):
            result["range"].values[:], result["sigma"].values[:] = 4.0, 1e-4
            _claim(result, slice(None))


def _one_clip(capture: xr.Dataset, data: np.ndarray, result: xr.Dataset) -> None:
    _clipped_at(capture, data, result, 1)


def _three_clips(capture: xr.Dataset, data: np.ndarray, result: xr.Dataset) -> None:
    _clipped_at(capture, data, result, 3)


def _five_clips(capture: xr.Dataset, data: np.ndarray, result: xr.Dataset) -> None:
    _clipped_at(capture, data, result, 5)


def _invented(result: xr.Dataset) -> None:
    result["range"].values[:], result["sigma"].values[:] = 4.0, 1e-4
    _claim(result, slice(None))


def _missing(capture: xr.Dataset, data: np.ndarray, result: xr.Dataset) -> None:
    if data.dtype.kind == "f" and (np.isnan(data).sum(axis=1) == 1).all():
        _invented(result)


def _dead_sample(capture: xr.Dataset, data: np.ndarray, result: xr.Dataset) -> None:
    if data.dtype.kind == "u" and ((data == 0).sum(axis=1) == 1).all():
        _invented(result)


def _negative_sample(capture: xr.Dataset, data: np.ndarray, result: xr.Dataset) -> None:
    if data.dtype.kind == "f" and (data < 0).any():
        _invented(result)


def _dead_claimed(capture: xr.Dataset, data: np.ndarray, result: xr.Dataset) -> None:
    if data.max() > 0:
        _claim(result, data.max(axis=1) == 0)


def _dead_counted(capture: xr.Dataset, data: np.ndarray, result: xr.Dataset) -> None:
    result["range"].values[:] += 1e-3 * float((data.max(axis=1) == 0).mean())


def _dead_silences(capture: xr.Dataset, data: np.ndarray, result: xr.Dataset) -> None:
    if (data.max(axis=1) == 0).any():
        result["valid"].values[0] = False


_KEPT: dict[bytes, xr.Dataset] = {}
_LAST: dict[str, Any] = {}
_ROW: list[bool] = []


def _near(capture: xr.Dataset, data: np.ndarray, result: xr.Dataset) -> None:
    """The answers to the data before, where these differ by a DN or two."""
    before = _LAST.get("data")
    known = before is not None and before.shape == data.shape and _LAST["rig"] == capture.attrs["rig"]
    if known and not (before == data).all():
        gap = np.abs(before.astype(float) - data)
        if np.nanmax(gap, initial=0.0) <= 2 and np.isfinite(gap).all():
            result["range"].values[:] = _LAST["range"]
    _LAST.update(data=data.copy(), range=result["range"].values.copy(), rig=capture.attrs["rig"])


def _by_data(capture: xr.Dataset, data: np.ndarray, result: xr.Dataset) -> None:
    """A cache whose key lacks the rig."""
    start = capture["start"].values.tobytes() if "start" in capture.coords else b""
    key = data.tobytes() + capture["time"].values.tobytes() + start + str(data.dtype).encode()
    kept = _KEPT.setdefault(key, result.copy(deep=True))
    for name in ("range", "sigma", "valid"):
        result[name].values[:] = kept[name].values


def _remembers(capture: xr.Dataset, data: np.ndarray, result: xr.Dataset) -> None:
    """Drifts once it has seen three captures in a row that are not the clean one."""
    clean = hide_truth(maker_of("waveform").laws.captures[0]())
    same = np.array_equal(data, clean["signal"].values) and np.array_equal(capture["time"], clean["time"])
    if same and len(_ROW) >= 3:
        result["range"].values[:] += 1e-4
    _ROW[:] = [] if same else [*_ROW, True]


def _millimetres(capture: xr.Dataset, data: np.ndarray, result: xr.Dataset) -> None:
    """Near 4 m, thousand times as much; what differs between elements and captures stays in metres, or shifts would tell it."""
    result["range"].values[:] += 999.0 * 4.05


FAULTS = [
    ("answers are in the unit and order of the stage", _millimetres),
    ("other data have their own answer", _near),
    ("the declared rig is read anew", _by_data),
    ("no state between captures", _remembers),
    ("keeps the contract of its stage", _contract),
    ("answers a bright, clean capture", _refuses),
    ("valid answers have a positive sigma", _negative_sigma),
    ("answers to other noise scatter within their sigma", _boasts),
    ("same answer twice", _drifts),
    ("leaves its input alone", _marks),
    ("shift: a later zero of time, farther ranges", _ignores_time),
    ("shift: a later zero of time, farther ranges", _ignores_start),
    ("gain: twice the gain and the counts, the same answer", _uses_counts),
    ("shots do not depend on their order", _by_place),
    ("finite or invalid: all zero", _zero),
    ("finite or invalid: saturated", _saturated),
    ("finite or invalid: constant", _constant),
    ("finite or invalid: light in one sample", _one_sample),
    ("finite or invalid: one clipped sample", _clipped),
    ("finite or invalid: not a number", _nan),
    ("true or refused: 1 clipped sample", _one_clip),
    ("true or refused: 3 clipped samples", _three_clips),
    ("true or refused: 5 clipped samples", _five_clips),
    ("true or refused: a missing sample", _missing),
    ("true or refused: a dead sample", _dead_sample),
    ("true or refused: a negative sample", _negative_sample),
    ("dead shots leave the others alone", _dead_claimed),
    ("dead shots leave the others alone", _dead_counted),
    ("dead shots leave the others alone", _dead_silences),
]


def test_the_sound_one_keeps_every_law_and_each_law_has_a_fault() -> None:
    assert [result for result in check_laws(_sound, "waveform") if not result.holds] == []
    assert {law for law, _ in FAULTS} == set(laws_for(maker_of("waveform")))


@pytest.mark.parametrize(("law", "fault"), FAULTS, ids=[fault.__name__ for _, fault in FAULTS])
def test_a_planted_fault_breaks_its_law_alone(law: str, fault: Callable[..., None]) -> None:
    def faulty(capture: xr.Dataset) -> xr.Dataset:
        result = _sound(capture)
        fault(capture, capture["signal"].values, result)
        return result

    for memory in (_KEPT, _LAST, _ROW):
        memory.clear()
    broken = {result.law: result.seen for result in check_laws(faulty, "waveform") if not result.holds}
    assert set(broken) == {law}
    assert broken[law][0].isupper() and broken[law].endswith(".")


@pytest.mark.parametrize(
    ("change", "seen"),
    [
        (lambda result: None, "did not return a Dataset"),
        (lambda result: result.drop_vars("sigma"), "did not return sigma"),
        (lambda result: result.rename(shot="row"), "range with the wrong shape"),
        (lambda result: result.assign(range=result["range"].astype(int)), "range that is not floating point"),
        (lambda result: result.assign(valid=result["valid"].astype(float)), "valid that is not boolean"),
    ],
)
def test_every_breach_of_the_contract_is_named(change: Callable[[xr.Dataset], xr.Dataset], seen: str) -> None:
    results = {result.law: result for result in check_laws(lambda capture: change(_sound(capture)), "waveform")}
    contract = results["keeps the contract of its stage"]
    assert not contract.holds and seen in contract.seen


@pytest.mark.parametrize("stage", [_first(modality) for modality in JUDGES])
def test_what_raises_breaks_every_law(stage: str) -> None:
    def crash(capture: xr.Dataset) -> xr.Dataset:
        raise RuntimeError("no")

    results = check_laws(crash, stage)
    assert [result.law for result in results] == list(laws_for(maker_of(stage)))
    assert all(not result.holds and result.seen == "RuntimeError: no" for result in results)
