"""An estimator reaches no truth: not by name, attribute, encoding, base array or pickle, nor by the store's path."""

from __future__ import annotations

import pickle
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import xarray as xr

from beambench.captures import hide_truth, open_captures, write
from beambench.captures.example import example_capture
from beambench.captures.hide import VISIBLE_ATTRIBUTES, sealed
from beambench.captures.layouts import LAYOUTS

MAGIC = 1234.5678901
SECRETS = ["hush-scene", "hush-provenance", "hush-fidelity", "91827364554637281"]


def secretive(modality: str) -> xr.Dataset:
    capture = example_capture(modality)
    for name in capture.variables:
        if str(name).startswith("truth_") and capture[name].dtype.kind in "fc":
            capture[name].values[...] = MAGIC
    capture["counts" if "counts" in capture else next(iter(capture.data_vars))].attrs["comment"] = "hush-provenance"
    capture.attrs |= {
        "truth_scene": '{"name": "hush-scene"}',
        "provenance": '{"arguments": "hush-provenance"}',
        "fidelity": '{"rung": "hush-fidelity"}',
        "seed": 91827364554637281,
        "capture_key": 91827364554637281,
        "my_notes": "hush-scene",
    }
    return capture


def reachable(thing: object, seen: dict[int, object]) -> None:
    """Everything that attributes, items and base arrays lead to."""
    if id(thing) in seen or isinstance(thing, type) or type(thing).__name__ in ("module", "function"):
        return
    seen[id(thing)] = thing
    if isinstance(thing, np.ndarray):
        reachable(thing.base, seen)
        return
    if isinstance(thing, dict):
        for key, value in thing.items():
            reachable(key, seen)
            reachable(value, seen)
    elif isinstance(thing, list | tuple | set | frozenset):
        for value in thing:
            reachable(value, seen)
    slots = [name for kind in type(thing).__mro__ for name in getattr(kind, "__slots__", ())]
    for name in [*getattr(thing, "__dict__", {}), *slots]:
        reachable(getattr(thing, name, None), seen)


@pytest.mark.parametrize("modality", list(LAYOUTS))
@pytest.mark.parametrize("stored", [False, True])
def test_nothing_leads_to_the_truth(modality: str, stored: bool, tmp_path: Path) -> None:
    capture = secretive(modality)
    path = tmp_path / "secret-store-path"
    if stored:
        write(path, capture)
        capture = open_captures(path)[0]
    hidden = hide_truth(capture)
    seen: dict[int, object] = {}
    reachable(hidden, seen)
    assert len(seen) > 50  # the walk has gone somewhere
    arrays = [thing for thing in seen.values() if isinstance(thing, np.ndarray)]
    assert len({id(a) for a in arrays}) >= len(hidden.variables)
    assert not any((np.abs(a - MAGIC) < 1e-3).any() for a in arrays if a.dtype.kind in "fc")
    texts = [str(thing) for thing in seen.values() if isinstance(thing, str | bytes | int | Path)]
    for secret in [*SECRETS, "secret-store-path"]:
        assert not any(secret in text for text in texts), secret
    frozen = pickle.dumps(hidden)
    for needle in [np.float64(MAGIC).tobytes(), np.float32(MAGIC).tobytes(), b"secret-store-path", b"truth_"]:
        assert needle not in frozen
    assert all(secret.encode() not in frozen for secret in SECRETS)
    assert (91827364554637281).to_bytes(8, "little") not in frozen


def test_the_walk_finds_what_is_not_hidden() -> None:
    seen: dict[int, object] = {}
    reachable(secretive("gated"), seen)
    arrays = [thing for thing in seen.values() if isinstance(thing, np.ndarray)]
    assert any((a == MAGIC).any() for a in arrays if a.dtype.kind == "f")
    texts = " ".join(str(thing) for thing in seen.values() if isinstance(thing, str | int))
    assert all(secret in texts for secret in SECRETS)


def test_encodings_of_xarray_s_own_reader_are_cleared(tmp_path: Path) -> None:
    write(tmp_path / "store", secretive("gated"))
    lazy = xr.open_zarr(tmp_path / "store").isel(capture=0)
    one = xr.Dataset(lazy.variables, attrs=open_captures(tmp_path / "store").attributes(0))
    one = one.set_coords(["delay", "gate", "pulses", "laser_on", "time", "valid"])
    one.encoding["source"] = str(tmp_path / "store")
    hidden = hide_truth(one)
    assert hidden.encoding == {} and all(v.encoding == {} for v in hidden.variables.values())
    assert all(isinstance(v.variable._data, np.ndarray) for v in hidden.data_vars.values())
    assert str(tmp_path).encode() not in pickle.dumps(hidden)
    seen: dict[int, object] = {}
    reachable(hidden, seen)
    assert not any(str(tmp_path) in str(thing) for thing in seen.values() if isinstance(thing, str | Path))


@pytest.mark.parametrize("modality", list(LAYOUTS))
def test_the_data_stay_as_they_are(modality: str) -> None:
    capture = example_capture(modality)
    hidden = hide_truth(capture)
    kept = {str(n) for n in capture.variables if not str(n).startswith("truth_")}
    assert {str(n) for n in hidden.variables} == kept
    for name in kept:
        np.testing.assert_array_equal(hidden[name].values, capture[name].values)
        assert hidden[name].attrs["units"] == capture[name].attrs["units"]
        assert (name in hidden.coords) == (name in capture.coords)
    assert set(hidden.attrs) <= set(VISIBLE_ATTRIBUTES) and hidden.attrs["rig"] == capture.attrs["rig"]


def test_arrays_are_read_only_views_without_copy() -> None:
    counts = np.zeros((6, 5, 7), np.uint16)
    capture = example_capture("gated").assign(
        counts=(("slice", "row", "col"), counts, {"units": "DN", "long_name": "c"})
    )
    hidden = hide_truth(capture)
    assert np.shares_memory(hidden["counts"].values, counts)
    with pytest.raises(ValueError, match="read-only"):
        hidden["counts"].values[0] = 1
    capture["counts"].values[0] = 7  # the owner still may write
    assert hidden["counts"].values[0, 0, 0] == 7


def test_a_view_into_a_larger_buffer_is_copied(tmp_path: Path) -> None:
    both = np.concatenate([np.arange(10.0), np.full(10, MAGIC)])
    apart: np.ndarray[Any, Any] = sealed(both[:10])
    root: Any = apart
    while root.base is not None:
        root = root.base
    assert root.size == 10 and not np.shares_memory(apart, both)
    mapped = np.memmap(tmp_path / "file", dtype=np.uint16, mode="w+", shape=(4,))
    unmapped: Any = sealed(mapped)
    while unmapped is not None:
        assert not isinstance(unmapped, np.memmap)
        unmapped = unmapped.base
