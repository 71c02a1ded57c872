"""Exports of all modalities, read back by other programs where they are installed: values, units, flags and attributes."""

from __future__ import annotations

import io
import json
import tarfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import xarray as xr

import beambench
from beambench.captures import open_captures, write
from beambench.captures.exports.place import EXPORT
from beambench.captures.layouts import LAYOUTS

from ._exports import PARTS, capture_of, data_set

MODALITIES = tuple(LAYOUTS)
#: Why a test that reads by a program of others is skipped.
PEER = "needs the extra `exports`"


@pytest.fixture(scope="module")
def mixed(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A data set of all modalities."""
    return data_set(tmp_path_factory.mktemp("mixed") / "mixed", MODALITIES)


def samples(out: Path) -> Iterator[tuple[str, Path, str, dict[str, bytes]]]:
    """(part, tar file, key, {extension: content}) of a WebDataset, by Python's tarfile alone."""
    for path in sorted(out.rglob("*.tar")):
        found: dict[str, dict[str, bytes]] = {}
        with tarfile.open(path) as tar:
            for member in tar:
                assert (member.mtime, member.uid, member.gid, member.uname) == (0, 0, 0, "") and member.isfile()
                key, _, extension = member.name.partition(".")
                content = tar.extractfile(member)
                assert content is not None
                found.setdefault(key, {})[extension] = content.read()
        for key, files in found.items():
            yield path.parent.name, path, key, files


def test_webdataset_holds_every_value_of_all_modalities(mixed: Path, tmp_path: Path) -> None:
    out = beambench.export(mixed, to="webdataset", out=tmp_path / "out", per_file=2)
    seen = 0
    for part, path, key, files in samples(out):
        modality, number = path.name.rpartition("-")[0], int(key) % len(PARTS)
        capture = capture_of(modality, number)
        assert part == PARTS[number]
        told = json.loads(files.pop("json"))
        assert set(files) == {f"{name}.npy" for name in capture.variables}
        for name, variable in capture.variables.items():
            values = np.load(io.BytesIO(files[f"{name}.npy"]), allow_pickle=False)
            assert values.dtype == variable.dtype and values.tobytes() == np.asarray(variable.values).tobytes()
            assert told["variables"][name]["units"] == variable.attrs["units"]
            assert told["variables"][name]["dims"] == list(variable.dims)
        assert told["drawn"]["albedo"] == number / 8 and told["part"] == part
        assert told["attributes"]["rig"] == json.loads(capture.attrs["rig"])
        seen += 1
    assert seen == len(MODALITIES) * len(PARTS)
    manifest = json.loads((out / EXPORT).read_text())
    assert manifest["captures"] == seen and len(list(out.rglob("gated-*.tar"))) == 4


def test_an_export_has_the_same_bytes_each_time(mixed: Path, tmp_path: Path) -> None:
    for to in ("webdataset", "exr", "tiff", "netcdf"):
        if to == "netcdf":
            pytest.importorskip("h5netcdf", reason="needs the extra `netcdf`")
        lists = []
        for attempt in "ab":
            out = beambench.export(mixed / "amcw", to=to, out=tmp_path / f"{to}-{attempt}", part="train")  # type: ignore[arg-type]
            lists.append(json.loads((out / EXPORT).read_text())["files"])
        assert lists[0] == lists[1] and lists[0]


def test_webdataset_reads_what_was_written(mixed: Path, tmp_path: Path) -> None:
    wds = pytest.importorskip("webdataset", reason=PEER)
    out = beambench.export(mixed / "gated", to="webdataset", out=tmp_path / "out", per_file=2, part="train")
    files = sorted(map(str, (out / "train").glob("*.tar")))
    found = list(wds.WebDataset(files, shardshuffle=False, empty_check=False).decode())
    assert [one["__key__"] for one in found] == ["000000", "000002", "000004"]
    for one, number in zip(found, (0, 2, 4), strict=True):
        assert np.array_equal(one["counts.npy"], capture_of("gated", number)["counts"].values)
        assert one["json"]["capture"] == number


@pytest.mark.parametrize("modality", MODALITIES)
def test_xarray_opens_netcdf(mixed: Path, tmp_path: Path, modality: str) -> None:
    pytest.importorskip("h5netcdf", reason="needs the extra `netcdf`")
    out = beambench.export(mixed / modality, to="netcdf", out=tmp_path / "out", part="train", per_file=2)
    with xr.open_dataset(sorted((out / "train").glob("*.nc"))[0], engine="h5netcdf") as found:
        first = capture_of(modality, 0)
        assert list(np.asarray(found["capture"]) % len(PARTS)) == [0, 2]
        for name, variable in first.variables.items():
            values = np.asarray(variable.values)
            if values.dtype.kind == "c":
                read = found[f"{name}_real"].values[0] + 1j * found[f"{name}_imag"].values[0]
                same = found[f"{name}_real"]
            else:
                same = found[str(name)]
                read = same.values[0]
                assert same.dtype == values.dtype, name
            assert np.array_equal(read, values, equal_nan=values.dtype.kind in "fc"), name
            assert same.attrs["units"] == variable.attrs["units"] and same.dims == ("capture", *variable.dims)
            assert (name in found.coords) == (name in first.coords)
        assert json.loads(str(found["rig"].values[0])) == json.loads(first.attrs["rig"])
        assert list(found["drawn_albedo"].values) == [0.0, 0.25] and list(found["part"].values) == ["train", "train"]
        assert list(found["drawn_kind"].values) == ["sand", ""]  # what the second did not draw


@pytest.mark.parametrize("modality", MODALITIES)
def test_openexr_reads_the_parts(mixed: Path, tmp_path: Path, modality: str) -> None:
    """By the library of the Academy Software Foundation; float64 is rounded to float32, all else is exact."""
    exr = pytest.importorskip("OpenEXR", reason=PEER)
    out = beambench.export(mixed / modality, to="exr", out=tmp_path / "out", part="test")
    capture = capture_of(modality, 1)
    (path,) = (out / "test").glob("*.exr")
    with exr.File(str(path), separate_channels=True) as file:
        header = dict(file.parts[0].header)
        channels = {name: one.pixels.copy() for part in file.parts for name, one in part.channels.items()}
        parts = {part.name() for part in file.parts}
    variables = json.loads(header["beambench:variables"])
    assert {str(pixels.dtype) for pixels in channels.values()} == {"float32"}
    for name, variable in capture.data_vars.items():
        assert variables[name]["units"] == variable.attrs["units"]
        for label, values in expected_planes(str(name), variable):
            assert np.array_equal(channels.pop(label), values, equal_nan=True), label
    assert not channels
    assert json.loads(header["beambench:attributes"])["rig"] == json.loads(capture.attrs["rig"])
    coordinates = json.loads(header["beambench:coordinates"])
    for name, variable in capture.coords.items():
        assert coordinates[name]["values"] == variable.values.tolist()
    rounded = {str(n) for n, v in capture.data_vars.items() if v.dtype in (np.float64, np.complex128)}
    assert set(header["beambench:rounded"].split()) == rounded
    assert ("row-col" in parts) == ("counts" in capture.variables)


def expected_planes(name: str, variable: Any) -> Iterator[tuple[str, Any]]:
    """Channels of a variable, by the rule as docs/data-sets.md has it, written anew."""
    values = np.asarray(variable.values)
    if values.dtype.kind == "c":
        yield from expected_planes(f"{name}_real", variable.copy(data=values.real))
        yield from expected_planes(f"{name}_imag", variable.copy(data=values.imag))
        return
    dims = list(variable.dims)
    pairs = [("row", "col"), ("pupil_row", "pupil_col"), ("image_row", "image_col")]
    inner = next((list(pair) for pair in pairs if set(pair) <= set(dims)), dims[:2])
    stacked = xr.DataArray(values.astype(np.float32), dims=dims).transpose(..., *inner)
    rest = stacked.dims[: len(dims) - len(inner)]
    if not rest:
        yield f"{name}.Z", stacked.values.reshape(stacked.shape[0], -1)
    for index in np.ndindex(*(stacked.sizes[dim] for dim in rest)) if rest else ():
        plane = stacked.values[index]
        yield ".".join([name, *(f"{i:04d}" for i in index)]), plane.reshape(plane.shape[0], -1)


@pytest.mark.parametrize("modality", MODALITIES)
def test_tifffile_reads_the_pages_exactly(mixed: Path, tmp_path: Path, modality: str) -> None:
    tifffile = pytest.importorskip("tifffile", reason=PEER)
    out = beambench.export(mixed / modality, to="tiff", out=tmp_path / "out", part="test")
    capture = capture_of(modality, 1)
    (rest,) = (out / "test").glob("*.json")
    told = json.loads(rest.read_text())
    paged = {path.name.split(".")[1]: path for path in (out / "test").glob("*.tif")}
    assert set(paged) | set(told["values"]) == set(capture.variables) and not set(paged) & set(told["values"])
    layout = beambench.captures.layouts.layout_of(modality)
    assert layout.data in paged
    for name, path in paged.items():
        values = np.asarray(capture[name].values)
        with tifffile.TiffFile(path) as file:
            about = json.loads(file.pages[0].description)["beambench"]
            pages = np.stack([page.asarray() for page in file.pages])
        assert about["units"] == capture[name].attrs["units"] and about["sizes"] == list(values.shape)
        order = [dim for dim in about["pages_over"] if not dim.startswith("part")] + about["page_dims"]
        moved = capture[name].transpose(*order).values
        if values.dtype.kind == "c":
            moved = np.stack([moved.real, moved.imag])
        moved = moved.reshape(pages.shape)
        assert np.array_equal(pages, moved, equal_nan=moved.dtype.kind == "f"), name
        if values.dtype == np.uint16:
            assert pages.dtype == np.uint16
    for name, one in told["values"].items():
        values = np.asarray(capture[name].values)
        assert one["values"] == (values.tolist() if values.dtype.kind != "c" else one["values"]), name
    assert told["attributes"]["rig"] == json.loads(capture.attrs["rig"])


def test_single_stores_and_choices(tmp_path: Path) -> None:
    store = write(tmp_path / "store", [capture_of("gated", number) for number in range(3)])
    out = beambench.export(store, to="webdataset", out=tmp_path / "out", variables=["counts", "truth_range"])
    found = list(samples(out))
    assert [key for _, _, key, _ in found] == ["000000", "000001", "000002"]
    assert all(set(files) == {"json", "counts.npy", "truth_range.npy"} for *_, files in found)
    assert json.loads(found[0][3]["json"])["attributes"]["truth_kind"] == "rendered"


@pytest.mark.parametrize("to", ["webdataset", "exr", "tiff", "netcdf", "croissant"])
def test_without_truth_nothing_tells_it(mixed: Path, tmp_path: Path, to: Any) -> None:
    if to == "netcdf":
        pytest.importorskip("h5netcdf", reason="needs the extra `netcdf`")
    out = beambench.export(mixed / "amcw", to=to, out=tmp_path / "out", truth=False)
    for path in out.rglob("*"):
        if path.is_file() and path.name != EXPORT:
            content = path.read_bytes()
            for word in (b"truth", b"albedo", b"scene", b"seed", b"provenance", b"fidelity"):
                assert word not in content, (path, word)
    captures = open_captures(mixed / "amcw")
    ids = {captures.index(i)["content"] for i in range(len(captures))}  # type: ignore[attr-defined]
    assert not any(one in (out / EXPORT).read_text() for one in ids)


def test_croissant_is_valid_and_read(mixed: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """mlcroissant reads samples, splits and arrays; the files have the sha256 that is stated."""
    import hashlib

    monkeypatch.setenv("CROISSANT_CACHE", str(tmp_path / "cache"))
    mlc = pytest.importorskip("mlcroissant", reason=PEER)
    out = beambench.export(mixed, to="croissant", out=tmp_path / "out", variables=VARIABLES)
    dataset = mlc.Dataset(str(out / "croissant.json"))
    issues = dataset.metadata.ctx.issues
    assert not issues.errors and {"datePublished" in one for one in map(str, issues.warnings)} == {True}
    assert dataset.metadata.cite_as == "Nobody, 2026" and dataset.metadata.license == ["CC0-1.0"]
    assert [one["splits/name"] for one in dataset.records("splits")] == ["test", "train", "validation"]
    rows = {one["samples/key"].decode(): one for one in dataset.records("samples")}
    assert len(rows) == len(MODALITIES) * len(PARTS)
    for modality in MODALITIES:
        name = beambench.captures.layouts.layout_of(modality).data
        record = f"{modality}-{name}"
        found = list(dataset.records(record))
        assert len(found) == len(PARTS)
        for one in found:
            key = one[f"{record}/key"].decode()
            capture = capture_of(modality, int(key) % len(PARTS))
            assert np.array_equal(np.load(io.BytesIO(one[f"{record}/npy"])), capture[name].values)
            assert rows[key]["samples/split"] == one[f"{record}/split"] == PARTS[int(key) % len(PARTS)].encode()
            assert rows[key][f"samples/{name}_mean"] == pytest.approx(float(np.mean(capture[name].values, dtype=float)))
            assert rows[key]["samples/drawn_albedo"] == int(key) % len(PARTS) / 8
    for one in json.loads((out / "croissant.json").read_text())["distribution"]:
        if one["@type"] == "cr:FileObject":
            assert hashlib.sha256((out / one["contentUrl"]).read_bytes()).hexdigest() == one["sha256"]


#: The measured variable of every modality.
VARIABLES = ["counts", "signal", "samples", "truth_range"]
