"""The layout of captures: built captures are valid, and breaches are refused with the name of the variable."""

from __future__ import annotations

import json
import subprocess
import sys

import numpy as np
import pytest
import xarray as xr

from beambench.captures import make_capture
from beambench.captures.example import example_capture
from beambench.captures.layouts import LAYOUTS, layout_of
from beambench.captures.layouts.schema import SCHEMA_VERSION
from beambench.captures.validate import validate
from beambench.scenes.errors import InputError

RIG = {"kind": "gated", "gates": [{}, {}]}
PER_SLICE = {"delay": [1e-9, 2e-9], "gate": [0, 1], "pulses": 1, "laser_on": True, "time": 0.0, "valid": True}


def recorded(**attrs: object) -> xr.Dataset:
    counts = np.arange(2 * 3 * 4, dtype=np.uint16).reshape(2, 3, 4)
    return make_capture("gated", {"counts": counts}, PER_SLICE, {}, {"rig": RIG, "truth_kind": "none", **attrs})


def test_the_list_of_modalities_is_the_design_s() -> None:
    assert list(LAYOUTS) == ["gated", "waveform", "amcw", "laser_line", "wavefront"]


@pytest.mark.parametrize("modality", list(LAYOUTS))
@pytest.mark.parametrize("channel", [False, True])
@pytest.mark.parametrize("optional", [False, True])
def test_every_variable_has_units_and_a_name(modality: str, channel: bool, optional: bool) -> None:
    capture = example_capture(modality, channel=channel, optional=optional)
    assert capture.attrs["schema_version"] == SCHEMA_VERSION
    for name in capture.variables:
        assert capture[name].attrs["units"] and capture[name].attrs["long_name"]
    expected = {v.name for v in layout_of(modality).variables if v.required or optional}
    assert {str(name) for name in capture.variables} == expected


@pytest.mark.parametrize("modality", list(LAYOUTS))
def test_names_of_the_schema_are_unique_and_truth_is_marked(modality: str) -> None:
    names = [v.name for v in layout_of(modality).variables]
    assert len(names) == len(set(names))
    assert all(v.name.startswith("truth_") == (v.role == "truth") for v in layout_of(modality).variables)
    assert all(np.dtype(d).kind in "biufc" for v in layout_of(modality).variables for d in v.dtypes)


def test_a_recording_has_the_same_layout_with_nan() -> None:
    capture = recorded()
    assert np.isnan(capture["truth_range"]).all() and capture["truth_range"].dims == ("row", "col")
    assert capture["truth_normal"].shape == (3, 4, 3) and np.isnan(capture["truth_normal"]).all()
    assert (capture["truth_material"] == -1).all() and not capture["truth_mixed"].any()
    assert list(capture["gate"].values) == [0, 1] and capture["laser_on"].dtype == bool


def test_arrays_are_kept_not_copied() -> None:
    counts = np.zeros((2, 3, 4), np.uint16)
    capture = make_capture("gated", {"counts": counts}, PER_SLICE, {}, {"rig": RIG, "truth_kind": "none"})
    assert np.shares_memory(capture["counts"].values, counts)


def test_lossless_turning_only() -> None:
    ok = recorded()
    truth = {"truth_material": np.arange(12).reshape(3, 4).astype(float)}
    attrs = {"rig": RIG, "truth_kind": "surveyed"}
    turned = make_capture("gated", {"counts": ok["counts"].values}, PER_SLICE, truth, attrs)
    assert turned["truth_material"].dtype.kind == "i"
    with pytest.raises(InputError, match="truth_material has a dtype"):
        bad = {"truth_material": truth["truth_material"] + 0.5}
        make_capture("gated", {"counts": ok["counts"].values}, PER_SLICE, bad, attrs)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda d: {"counts": d.astype(np.int32)}, "counts has a dtype"),
        (lambda d: {"counts": d.astype(np.float64)}, "counts has a dtype"),
        (lambda d: {"counts": d.astype(np.float32)}, "averaged"),
        (lambda d: {"counts": d[0]}, "wrong number of dimensions"),
        (lambda d: {"counts": d[:1]}, "does not fit the other variables along slice"),
        (lambda d: {"counts": d, "bogus": d}, "no data variable of this name"),
        (lambda d: {}, "needs counts"),
        (lambda d: {"counts": d[:, :0]}, "is empty"),
        (lambda d: {"counts": d, "dark": np.zeros((9, 9), np.float32)}, "does not fit"),
    ],
)
def test_bad_data_are_refused_by_name(change, message) -> None:  # type: ignore[no-untyped-def]
    counts = np.zeros((2, 3, 4), np.uint16)
    with pytest.raises(InputError, match=message):
        make_capture("gated", change(counts), PER_SLICE, {}, {"rig": RIG, "truth_kind": "none"})


@pytest.mark.parametrize(
    ("coords", "message"),
    [
        ({"delay": [1e-9, np.nan]}, "delay must be finite"),
        ({"gate": [0, 2]}, "gate that the rig does not have"),
        ({"gate": [-1, 0]}, "gate must not be negative"),
        ({"pulses": -3}, "pulses must not be negative"),
        ({"laser_on": [1, 0]}, "laser_on has a dtype"),
        ({"delay": None}, "needs delay"),
    ],
)
def test_bad_coordinates_are_refused(coords: dict[str, object], message: str) -> None:
    counts = np.zeros((2, 3, 4), np.uint16)
    with pytest.raises(InputError, match=message):
        make_capture("gated", {"counts": counts}, PER_SLICE | coords, {}, {"rig": RIG, "truth_kind": "none"})


@pytest.mark.parametrize(
    ("attrs", "message"),
    [
        ({"truth_kind": "guessed"}, "where its truth comes from"),
        ({"rig": {"gain": float("nan")}}, "not representable as JSON"),
        ({"rig": "{"}, "not representable as JSON"),
        ({"rig": None}, "does not declare its rig"),
        ({"rig": [1]}, "does not declare its rig"),
        ({"schema_version": 2}, "set by make_capture"),
        ({"truth_kind": "rendered"}, "needs truth_range"),
    ],
)
def test_bad_attributes_are_refused(attrs: dict[str, object], message: str) -> None:
    with pytest.raises(InputError, match=message):
        recorded(**attrs)


def test_truth_range_is_positive() -> None:
    attrs = {"rig": RIG, "truth_kind": "surveyed"}
    truth = {"truth_range": np.full((3, 4), -1.0)}
    with pytest.raises(InputError, match="truth_range must be positive"):
        make_capture("gated", {"counts": np.zeros((2, 3, 4), np.uint16)}, PER_SLICE, truth, attrs)


@pytest.mark.parametrize("version", [None, 0, 2, "1", True])
def test_other_schema_versions_are_refused(version: object) -> None:
    capture = example_capture("gated")
    capture.attrs["schema_version"] = version
    with pytest.raises(InputError, match="schema"):
        validate(capture)


def test_validate_names_dims_dtype_units_and_role() -> None:
    good = example_capture("gated")
    for change, message in [
        (good.transpose("row", "slice", "col", ...), "counts has the wrong dimensions"),
        (good.assign(truth_range=good["truth_range"].astype("int32")), "truth_range has the wrong dtype"),
        (good.reset_coords("delay"), "delay must be a coordinate"),
        (good.drop_vars("truth_first"), "lacks truth_first"),
        (good.assign(extra=good["counts"]), "no variable of this name"),
        (good.assign_attrs(rig="{"), "attribute rig is not JSON"),
        (good.isel(xyz=slice(2)), "fixed size"),
    ]:
        with pytest.raises(InputError, match=message):
            validate(change)
    wrong = good.copy(deep=True)
    wrong["delay"].attrs["units"] = "ns"
    with pytest.raises(InputError, match="delay has the wrong units"):
        validate(wrong)
    validate(good)


def test_json_attributes_take_objects_and_texts_alike() -> None:
    assert recorded().attrs["rig"] == json.dumps(RIG)
    assert recorded(rig=json.dumps(RIG)).attrs["rig"] == json.dumps(RIG)


def test_importing_the_package_is_light() -> None:
    code = "import sys, beambench.captures as c; assert not {'xarray', 'zarr', 'numpy'} & set(sys.modules); c.write"
    subprocess.run([sys.executable, "-c", code], check=True, timeout=60)
