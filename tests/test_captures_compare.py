"""Comparisons count differing bits; provenance describes how a capture was made, but not by whom."""

from __future__ import annotations

import getpass
import json
import platform
import re
import sys
import types
from pathlib import Path

import numpy as np
import pytest

from beambench.captures import compare_captures, compare_stores, write
from beambench.captures.example import example_capture
from beambench.captures.layouts import LAYOUTS
from beambench.captures.provenance import cpu, provenance
from beambench.scenes.errors import InputError


@pytest.mark.parametrize("modality", list(LAYOUTS))
def test_equal_arguments_give_equal_bits(modality: str) -> None:
    comparison = compare_captures(example_capture(modality, seed=3), example_capture(modality, seed=3))
    assert comparison.equal and comparison.differing == 0 and "equal bits" in str(comparison)


def test_differing_values_are_counted_with_their_size() -> None:
    a, b = example_capture("gated"), example_capture("gated")
    b["counts"].values[0, 0, :3] += np.array([1, 2, 9], np.uint16)
    b["truth_field"] = b["truth_range"] * 0
    comparison = compare_captures(a, b)
    entry = {variable.name: variable for variable in comparison.variables}
    assert (entry["counts"].differing, entry["counts"].max_abs, entry["counts"].size) == (3, 9.0, a["counts"].size)
    assert entry["truth_field"].note == "only in the second" and entry["delay"].differing == 0
    assert not comparison.equal and "3 of 210 values differ" in str(comparison)


def test_bits_not_values_are_compared() -> None:
    a, b = example_capture("gated"), example_capture("gated")
    for capture, values in ((a, (np.nan, 0.0, np.inf)), (b, (np.nan, -0.0, 1.0))):
        capture["truth_range"].values[0, :3] = values
    entry = next(v for v in compare_captures(a, b).variables if v.name == "truth_range")
    assert (entry.differing, entry.max_abs) == (2, 0.0)


def test_complex_and_shape_and_dtype() -> None:
    a, b = example_capture("wavefront"), example_capture("wavefront")
    b["truth_field"].values[0, 0, 0] += 3 + 4j
    entry = next(v for v in compare_captures(a, b).variables if v.name == "truth_field")
    assert entry.differing == 1 and entry.max_abs == pytest.approx(5.0, rel=1e-6)
    wide = a.assign(truth_phase=a["truth_phase"].astype("float32"))
    assert "dtype" in str(compare_captures(a, wide)) and "shape" in str(compare_captures(a, a.isel(mode=slice(3))))
    double = a.assign(truth_field=a["truth_field"].astype("complex128"))
    other = double.copy(deep=True)
    other["truth_field"].values[0, 1, 1] *= 2
    assert compare_captures(double, other).differing == 1


def test_provenance_does_not_count_as_content_but_the_rig_does() -> None:
    a = example_capture("amcw")
    assert compare_captures(a, a.assign_attrs(provenance="{}")).equal
    assert compare_captures(a, a.assign_attrs(provenance="{}")).attributes == ("provenance",)
    assert not compare_captures(a, a.assign_attrs(rig="{}")).equal
    assert not compare_captures(a, a.assign_attrs(seed=0.0)).equal


def test_stores_are_compared_capture_by_capture(tmp_path: Path) -> None:
    a = write(tmp_path / "a", [example_capture("amcw", seed=s) for s in (1, 2)])
    b = write(tmp_path / "b", [example_capture("amcw", seed=s) for s in (1, 3)])
    c = write(tmp_path / "c", example_capture("amcw", seed=1))
    assert [comparison.equal for comparison in compare_stores(a, b)] == [True, False]
    with pytest.raises(InputError, match="different numbers"):
        compare_stores(a, c)


def test_provenance_is_json_repeatable_and_anonymous() -> None:
    arguments = {"scene": "flat-wall", "seed": 7, "fidelity": "direct", "overrides": {"rig.t0_s": 1e-9}}
    first, second = provenance(arguments), provenance(arguments)
    text = json.dumps(first)
    assert first == second and json.loads(text)["arguments"] == arguments
    assert {"beambench", "python", "packages", "platform", "cpu"} <= set(first)
    assert first["packages"]["numpy"] == np.__version__
    assert cpu()["model"]
    words = set(re.findall(r"[\w.-]+", text))  # whole words only: a host named "vm" is part of the word "llvmlite"
    assert platform.node() not in words and str(Path.home()) + "/" not in text
    if len(getpass.getuser()) > 4:
        assert getpass.getuser() not in text
    with pytest.raises(InputError, match="representable as JSON"):
        provenance({"rtol": float("nan")})


def test_provenance_does_not_depend_on_what_the_process_did_before(monkeypatch: pytest.MonkeyPatch) -> None:
    """Packages were listed if they were loaded: the bytes of a capture depended on those made before it."""
    before = provenance({"seed": 1})
    monkeypatch.delitem(sys.modules, "numba", raising=False)
    monkeypatch.setitem(sys.modules, "mitransient", types.ModuleType("mitransient"))
    assert provenance({"seed": 1}) == before and "numba" in before["packages"]
