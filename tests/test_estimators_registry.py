"""Labels, parameters, plug-ins, and results that break the contract."""

from __future__ import annotations

from importlib.metadata import EntryPoint

import numpy as np
import pytest
import xarray as xr

from beambench.benchmarks.written.gated_stack import GaussianRig, stack_capture
from beambench.captures.layouts import stage_of
from beambench.estimators import (
    BUILTIN,
    Estimator,
    estimator,
    format_label,
    get_estimator,
    list_estimators,
    parse_label,
    registry,
    run_estimator,
)  # fmt: skip
from beambench.estimators.result import range_result
from beambench.scenes.errors import InputError

RIG = GaussianRig(slices=16)


def _capture() -> xr.Dataset:
    return stack_capture(RIG, np.full((16, 3, 4), 9, dtype=np.uint16))


def test_a_source_that_nobody_looked_up_says_so_in_one_way() -> None:
    cites = [get_estimator(name).cites for name in BUILTIN]
    assert not any(word in text for text in cites for word in ("recalled", "memory", "unverified"))
    assert any("not verified)" in text for text in cites)


def test_labels_round_trip() -> None:
    name, params = parse_label("weighted-average[ background = min ]")
    assert (name, params) == ("weighted-average", {"background": "min"})
    label = format_label("x", {"b": 1.5, "a": True, "c": None, "d": "word", "e": "true"})
    assert label == 'x[a=true,b=1.5,c=null,d=word,e="true"]'
    assert parse_label(label) == ("x", {"a": True, "b": 1.5, "c": None, "d": "word", "e": "true"})
    assert parse_label("poisson-ml") == ("poisson-ml", {})


@pytest.mark.parametrize("label", ["", "a[", "a[b]", "a[=1]", "a[b=1,b=2]", "a[b=]", "[b=1]", "a b", "a[b=1]c"])
def test_bad_labels_are_refused(label: str) -> None:
    with pytest.raises(InputError):
        parse_label(label)


@pytest.mark.parametrize(
    "label",
    ["no-such", "peak[no=1]", "weighted-average[background=some]", "poisson-ml[min_snr=word]", "poisson-ml[min_snr=-1]",
     "poisson-ml[min_snr=true]", "chua-2017[k_s=-1]", "chua-2017[k_d=0]", "chua-2017[threshold=1]",
     "chua-2017[phi=wide]", "weighted-average[background=off-slices]"],
)  # fmt: skip
def test_bad_names_and_parameters_are_refused(label: str) -> None:
    with pytest.raises(InputError):
        run_estimator(label, _capture())


def test_unknown_name_suggests_a_near_one() -> None:
    with pytest.raises(InputError, match="weighted-average"):
        get_estimator("weigthed-average")


def _result(**changes: object) -> xr.Dataset:
    ones = np.ones((3, 4))
    result = range_result(ones, ones, ones > 0)
    for key, value in changes.items():
        result[key] = (("row", "col"), value) if isinstance(value, np.ndarray) else value
    return result


HOSTILE = {
    "no dataset": lambda c: np.zeros((3, 4)),
    "no sigma": lambda c: _result().drop_vars("sigma"),
    "wrong shape": lambda c: _result().isel(row=slice(0, 2)),
    "transposed": lambda c: _result().transpose("col", "row"),
    "nan called valid": lambda c: _result(range=np.full((3, 4), np.nan)),
    "infinite sigma": lambda c: _result(sigma=np.full((3, 4), np.inf)),
    "zero sigma": lambda c: _result(sigma=np.zeros((3, 4))),
    "integer range": lambda c: _result(range=np.ones((3, 4), dtype=int)),
    "valid not bool": lambda c: _result(valid=np.ones((3, 4))),
}


@pytest.mark.parametrize("what", sorted(HOSTILE))
def test_faulty_plugin_is_refused(what: str) -> None:
    def faulty(capture: xr.Dataset) -> xr.Dataset:
        return HOSTILE[what](capture)  # type: ignore[no-any-return, no-untyped-call]

    marked = estimator("gated", cites="a plug-in of this test")(faulty)
    with pytest.raises(InputError, match="Estimator faulty"):
        run_estimator(marked, _capture())


def test_unmarked_function_and_other_modality_are_refused() -> None:
    with pytest.raises(InputError, match="not a marked function"):
        run_estimator(lambda capture: _result(), _capture())
    other = estimator("centroid", cites="a plug-in of this test")(lambda capture: _result())
    with pytest.raises(InputError, match="modality"):
        run_estimator(Estimator("other", stage_of("centroid"), "x", other), _capture())
    with pytest.raises(InputError):
        estimator("no-modality", cites="x")
    with pytest.raises(InputError):
        estimator("gated", cites=" ")


def test_good_plugin_runs_and_a_duplicate_name_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    here = "beambench.estimators.gated.peak:peak"
    monkeypatch.setattr(registry, "plugin_points", lambda: [EntryPoint("third", here, "g")])
    registry._plugins_on.cache_clear()
    try:
        assert "third" in list_estimators()
        assert run_estimator("third", _capture()).attrs["estimator"] == "third"
        clash = [EntryPoint("parabola", here, "g"), EntryPoint("third", here, "g")]
        monkeypatch.setattr(registry, "plugin_points", lambda: clash)
        registry._plugins_on.cache_clear()
        with pytest.raises(InputError, match="Two estimators are named parabola"):
            list_estimators()
        broken = [EntryPoint("gone", "no_such_module_here:f", "g")]
        monkeypatch.setattr(registry, "plugin_points", lambda: broken)
        registry._plugins_on.cache_clear()
        with pytest.raises(InputError, match="cannot be imported"):
            get_estimator("gone")
    finally:
        registry._plugins_on.cache_clear()


def test_bad_rigs_and_stacks_are_refused() -> None:
    import json

    capture = _capture()
    rig = json.loads(capture.attrs["rig"])
    for text in ("{", "[]", json.dumps(rig | {"schema": 2}), json.dumps(rig | {"gates": []}),
                 json.dumps({k: v for k, v in rig.items() if k != "camera"}),
                 json.dumps(rig | {"pulse": {"start_s": 0, "step_s": 0, "value": [1, 1]}}),
                 json.dumps(rig | {"pulse": {"start_s": 0, "step_s": 1e-11, "value": [0, 0]}})):  # fmt: skip
        with pytest.raises(InputError):
            run_estimator("peak", capture.assign_attrs(rig=text))
    with pytest.raises(InputError):
        run_estimator("peak", capture.isel(row=slice(0, 2)))
    with pytest.raises(InputError):
        run_estimator("peak", capture.assign_coords(gate=capture["gate"] + 1))
    with pytest.raises(InputError):
        run_estimator("peak", capture.drop_vars("delay"))


def test_an_estimator_may_need_a_kind_of_rig() -> None:
    @estimator("gated", cites="a test", needs={"camera.rows": "many", "detector.adc_bits": "16"})
    def picky(capture: xr.Dataset) -> xr.Dataset:
        raise AssertionError("never called")

    found = Estimator(
        "picky", stage_of("gated"), "a test", picky, needs=(("kind", "gated"), ("detector.readout.kind", "counting"))
    )
    assert found.unfit(_capture()) == "reads rigs whose detector.readout.kind is counting, not None"
    # Decided by the declared rig alone, not by the counts; a rig that is not JSON cannot be read.
    for rig in ("{}", "no JSON", ""):
        assert found.unfit(_capture().assign_attrs(rig=rig))
    with pytest.raises(InputError, match="counting, not None"):
        found(_capture())
    with pytest.raises(InputError, match=r"camera\.rows is many, not 3"):
        run_estimator(picky, _capture())
    assert get_estimator("weighted-average").unfit(_capture()) == ""
    with pytest.raises(InputError, match="cannot need the name"):
        estimator("gated", cites="a test", needs={"name": "object1"})
