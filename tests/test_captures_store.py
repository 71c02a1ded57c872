"""The store returns the same bits, and never overwrites a store or leaves an incomplete one."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import warnings
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
import xarray as xr

from beambench.captures import CaptureWriter, compare_captures, open_captures, verify, write
from beambench.captures.example import example_capture
from beambench.captures.layouts import LAYOUTS
from beambench.captures.store.arrays import CHUNK_BYTES, chunk_keys, chunk_shape
from beambench.captures.store.layout import size_problem
from beambench.captures.store.status import status
from beambench.scenes.errors import InputError


def identical(a: xr.Dataset, b: xr.Dataset) -> None:
    assert [str(n) for n in a.variables] == [str(n) for n in b.variables]
    assert list(a.attrs.items()) == list(b.attrs.items())
    assert [type(v) for v in a.attrs.values()] == [type(v) for v in b.attrs.values()]
    assert set(a.coords) == set(b.coords)
    for name in a.variables:
        x, y = a[name], b[name]
        assert x.dims == y.dims and x.dtype == y.dtype and x.attrs == y.attrs
        assert x.values.tobytes() == y.values.tobytes(), name


@pytest.mark.parametrize("modality", list(LAYOUTS))
@pytest.mark.parametrize("channel", [False, True])
def test_round_trip_is_bit_exact(modality: str, channel: bool, tmp_path: Path) -> None:
    captures = [example_capture(modality, seed=seed, channel=channel) for seed in range(3)]
    captures[1].attrs |= {"note": "Ω" * 200, "averaged": False, "capture_key": 2**90 + 1, "level": 0.1}
    del captures[2].attrs["provenance"]
    path = write(tmp_path / "store", iter(captures))
    opened = open_captures(path)
    assert (len(opened), opened.modality) == (3, modality)
    for original, read in zip(captures, opened, strict=True):
        identical(original, read)
        assert compare_captures(original, read).equal
    identical(opened[-1], captures[2])
    assert verify(path) == []
    assert os.listdir(tmp_path) == ["store"]


@pytest.mark.parametrize("special", [np.nan, -0.0, np.inf, 5e-324])
def test_special_values_and_nan_payloads_survive(special: float, tmp_path: Path) -> None:
    capture = example_capture("gated")
    payload = np.array([0x7FF8DEADBEEF0001], np.uint64).view(np.float64)[0]
    capture["truth_depth"].values[0, :2] = special, payload
    capture["truth_electrons"].values[...] = np.nan  # a chunk of fill values only is written too
    identical(capture, open_captures(write(tmp_path / "s", capture))[0])


def test_even_one_capture_has_the_leading_dimension_for_other_readers(tmp_path: Path) -> None:
    capture = example_capture("gated")
    path = write(tmp_path / "store", capture)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        foreign = xr.open_zarr(path)
    assert foreign["counts"].dims == ("capture", "slice", "row", "col") and foreign.sizes["capture"] == 1
    assert set(foreign.coords) == set(capture.coords)
    assert foreign["delay"].attrs == capture["delay"].attrs
    for name in capture.variables:
        np.testing.assert_array_equal(foreign[name][0].values, capture[name].values)


def test_every_array_is_checksummed_and_nothing_is_pickled(tmp_path: Path) -> None:
    path = write(tmp_path / "store", example_capture("gated"))
    files = sorted(path.rglob("zarr.json"))
    assert len(files) == len(example_capture("gated").variables) + 1
    for file in files:
        body = json.loads(file.read_text())
        if body["node_type"] == "array":
            assert body["codecs"][-1]["name"] == "crc32c", file
    assert not any("pickle" in file.read_text() for file in files)


def test_repeated_rigs_are_stored_once(tmp_path: Path) -> None:
    rig = json.dumps({"kind": "amcw", "name": "recurring" * 3000})
    captures = [example_capture("amcw", seed=seed).assign_attrs(rig=rig) for seed in range(20)]
    path = write(tmp_path / "store", captures)
    assert (path / "zarr.json").stat().st_size < 2 * len(rig) + 20 * 1000
    assert all(capture.attrs["rig"] == rig for capture in open_captures(path))


def test_index_and_partial_load(tmp_path: Path) -> None:
    opened = open_captures(write(tmp_path / "s", [example_capture("amcw", seed=s) for s in range(3)]))
    for bad in (3, -4):
        with pytest.raises(IndexError):
            opened[bad]
        with pytest.raises(InputError, match="no capture of this index"):
            opened[bad]
    with pytest.raises(InputError, match="must be selected by its number"):
        opened["0"]  # type: ignore[index]
    some = opened.load(1, ["truth_range"])
    assert list(some.variables) == ["truth_range"]
    assert opened.attributes(1)["seed"] == 1
    with pytest.raises(InputError, match="no such variable"):
        opened.load(0, ["nope"])


def test_large_stacks_are_chunked_in_rows() -> None:
    dims, shape = ["slice", "row", "col"], [64, 512, 512]
    chunk = chunk_shape(dims, shape, 2)
    assert chunk == (64, 128, 512) and 2 * np.prod(chunk) <= CHUNK_BYTES
    assert chunk_keys(3, {"dims": dims, "shape": shape, "dtype": "uint16"}) == [f"c.3.0.{b}.0" for b in range(4)]
    assert chunk_shape(["shot", "sample"], [2_000_000, 8], 4) == (CHUNK_BYTES // 32, 8)
    assert chunk_shape([], [], 8) == ()
    assert chunk_shape(["row", "col"], [2, 10**7], 4) == (1, 10**7)  # never less than a row


def test_a_stack_of_several_chunks_round_trips(tmp_path: Path) -> None:
    capture = example_capture("gated", sizes={"slice": 40, "row": 200, "col": 600}, optional=False)
    path = write(tmp_path / "store", capture)
    assert len([f for f in os.listdir(path / "counts") if f.startswith("c.")]) == 2
    identical(capture, open_captures(path)[0])


def test_large_captures_of_single_photons_are_readable_and_bombs_are_not(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Nearly all zero, packed to less than 1/500: sound. The same bytes packed as the writer never packs them: refused."""
    from numcodecs import Blosc

    monkeypatch.setattr("beambench.captures.store.layout.LARGE_BYTES", 2**24)
    capture = example_capture("gated", sizes={"slice": 64, "row": 512, "col": 512}, optional=False)
    for name in capture.data_vars:
        capture[name] = capture[name].copy(data=np.full_like(capture[name].values, 1))
    path = write(tmp_path / "store", capture)
    packed = sum(file.stat().st_size for file in path.rglob("c.*"))
    assert packed < capture.nbytes / 500
    identical(capture, open_captures(path)[0])
    bomb = Blosc(cname="zstd", clevel=9, shuffle=1).encode(bytes(2**23))
    assert len(bomb) < 2**23 / 2000 and "unpacks to" in size_problem(
        {"counts": {"dtype": "uint16", "shape": [64, 128, 512]}, "more": {"dtype": "uint8", "shape": [2**24]}},
        {"counts": {"c.0.0.0.0": (len(bomb), "")}, "more": {"c.0.0": (len(bomb), ""), "c.0.1": (len(bomb), "")}},
    )


def test_a_capture_beyond_the_memory_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = write(tmp_path / "store", example_capture("gated"))
    monkeypatch.setattr("beambench.captures.store.reader.LARGE_BYTES", 100)
    monkeypatch.setattr("beambench.captures.store.reader.free_bytes", lambda: 1000)
    with pytest.raises(InputError, match="more than the free memory"):
        open_captures(path)[0]


def test_captures_of_one_store_have_one_layout(tmp_path: Path) -> None:
    first = example_capture("gated")
    for other, name in [
        (example_capture("gated", sizes={"row": 6}), "counts"),
        (example_capture("waveform"), "modality"),
        (example_capture("gated", optional=False), "truth_instance"),
    ]:
        with pytest.raises(InputError, match=f"{name} differs from the first"):
            write(tmp_path / "store", [first, other], overwrite=True)
        assert not (tmp_path / "store").exists()


def test_objects_and_texts_are_refused(tmp_path: Path) -> None:
    capture = example_capture("gated")
    with pytest.raises(InputError, match="wrong dtype"):
        write(tmp_path / "a", capture.assign(truth_albedo=capture["truth_albedo"].astype(object)))
    with pytest.raises(InputError, match="does not survive"):
        write(tmp_path / "b", capture.assign_attrs(helper=object()))
    with pytest.raises(InputError, match="does not survive"):
        write(tmp_path / "c", capture.assign_attrs(level=float("nan")))
    assert os.listdir(tmp_path) == []


def test_existing_output_is_kept_unless_overwrite(tmp_path: Path) -> None:
    old, new = example_capture("amcw", seed=1), example_capture("amcw", seed=2)
    path = write(tmp_path / "store", old)
    with pytest.raises(InputError, match="The output exists"):
        write(path, new)

    def failing() -> Iterator[xr.Dataset]:
        yield new
        raise RuntimeError("generator broke")

    with pytest.raises(RuntimeError, match="generator broke") as caught:
        write(path, failing(), overwrite=True)
    assert "1 complete captures" in caught.value.__notes__[0]
    identical(open_captures(path)[0], old)
    (tmp_path / "other.partial").mkdir()
    with pytest.raises(InputError, match="unfinished store is in the way"):
        write(tmp_path / "other", new)
    write(path, new, overwrite=True)
    identical(open_captures(path)[0], new)
    assert sorted(os.listdir(tmp_path)) == ["other.partial", "store"]


def test_what_is_not_a_store_is_never_overwritten(tmp_path: Path) -> None:
    (tmp_path / "thesis").mkdir()
    (tmp_path / "thesis" / "chapter1").write_text("precious")
    (tmp_path / "file").write_text("precious")
    (tmp_path / "link").symlink_to(write(tmp_path / "real", example_capture("amcw")))
    for name in ("thesis", "file", "link"):
        with pytest.raises(InputError, match="not overwritten"):
            write(tmp_path / name, example_capture("amcw"), overwrite=True)
    assert (tmp_path / "thesis" / "chapter1").read_text() == (tmp_path / "file").read_text() == "precious"
    assert len(open_captures(tmp_path / "real")) == 1


def test_no_captures_make_no_store(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="no capture to write"):
        write(tmp_path / "store", [])
    assert os.listdir(tmp_path) == []


def test_a_broken_first_capture_leaves_nothing(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="lacks"):
        write(tmp_path / "store", example_capture("gated").drop_vars("counts"))
    assert os.listdir(tmp_path) == []


@pytest.mark.parametrize("name", ["x.partial", "/"])
def test_names_that_no_store_may_have(name: str, tmp_path: Path) -> None:
    with pytest.raises(InputError, match="cannot be the name of a store"):
        write(tmp_path / name, example_capture("amcw"))


def test_status_tells_what_a_folder_holds(tmp_path: Path) -> None:
    path = tmp_path / "store"
    assert status(path).state == "absent"
    writer = CaptureWriter(path)
    assert (status(path).state, status(path).count) == ("unfinished", 0)
    writer.append(example_capture("amcw"))
    assert (status(path).state, status(path).count, status(path).modality) == ("unfinished", 1, "amcw")
    writer.close()
    found = status(path)
    assert (found.state, found.count, found.unfinished) == ("complete", 1, None)
    assert found.n_bytes == sum(file.stat().st_size for file in path.rglob("*") if file.is_file())
    assert status(tmp_path).state == "other"


def test_a_closed_writer_takes_nothing_more(tmp_path: Path) -> None:
    with CaptureWriter(tmp_path / "store") as writer:
        writer.append(example_capture("amcw"))
    with pytest.raises(InputError, match="closed"):
        writer.append(example_capture("amcw"))


@pytest.mark.parametrize("kind", ["absent", "file", "folder", "partial"])
def test_opening_what_is_no_store(kind: str, tmp_path: Path) -> None:
    path = tmp_path / ("x.partial" if kind == "partial" else "x")
    if kind == "file":
        path.write_text("hello")
    elif kind != "absent":
        path.mkdir()
    match = {"absent": "no such store", "file": "a file, not", "folder": "not a store", "partial": "unfinished"}[kind]
    with pytest.raises(InputError, match=match):
        open_captures(path)


MEMORY = """
import sys, tracemalloc
from beambench.captures import write, open_captures
from beambench.captures.example import example_capture
one = example_capture("waveform", sizes={"shot": 64, "sample": 8192}, optional=False)
def captures(n):
    for i in range(n):
        c = one.copy(deep=True); c.attrs["seed"] = i
        yield c
write(sys.argv[1] + "/warm", captures(2))
for n in (10, 60):
    tracemalloc.start()
    write(f"{sys.argv[1]}/{n}", captures(n))
    for capture in open_captures(f"{sys.argv[1]}/{n}"): pass
    print(tracemalloc.get_traced_memory()[1] / one.nbytes)
    tracemalloc.stop()
"""


def test_memory_is_flat(tmp_path: Path) -> None:
    done = subprocess.run(
        [sys.executable, "-c", MEMORY, str(tmp_path)], check=True, capture_output=True, text=True, timeout=120
    )
    few, many = map(float, done.stdout.split())
    # Peak in captures: the one in hand, its copy, codec buffers. Fifty more add their marks only (< 4 kB each).
    # Which buffers of the store's threads are alive at once is chance, on a busy machine up to two captures' worth;
    # memory that grew would hold fifty more.
    assert many < few + 2, (few, many)
    assert many < 8, (few, many)
