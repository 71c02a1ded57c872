"""Exports read back by the libraries that every installation has, OpenImageIO and h5py: no test here is skipped for a peer."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import beambench
from beambench.captures.layouts import LAYOUTS, layout_of

from ._exports import PARTS, capture_of, data_set
from .test_captures_exports import expected_planes

MODALITIES = tuple(LAYOUTS)


@pytest.fixture(scope="module")
def mixed(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A data set of all modalities."""
    return data_set(tmp_path_factory.mktemp("mixed") / "mixed", MODALITIES)


@pytest.mark.parametrize("modality", MODALITIES)
def test_openimageio_reads_exr(mixed: Path, tmp_path: Path, modality: str) -> None:
    """Every channel of every part by its name, in float32."""
    import OpenImageIO as oiio

    out = beambench.export(mixed / modality, to="exr", out=tmp_path / "out", part="test")
    (path,) = (out / "test").glob("*.exr")
    channels = {}
    file = oiio.ImageInput.open(str(path))
    part = 0
    while file.seek_subimage(part, 0):
        spec = file.spec()
        pixels = file.read_image(part, 0, 0, spec.nchannels, oiio.FLOAT)
        channels |= {name: pixels[..., number] for number, name in enumerate(spec.channelnames)}
        part += 1
    file.close()
    for name, variable in capture_of(modality, 1).data_vars.items():
        for label, values in expected_planes(str(name), variable):
            assert np.array_equal(channels.pop(label), values, equal_nan=True), label
    assert not channels and part >= 1


@pytest.mark.parametrize("modality", MODALITIES)
def test_openimageio_reads_tiff(mixed: Path, tmp_path: Path, modality: str) -> None:
    """The pages of what was measured, in its own type."""
    import OpenImageIO as oiio

    data = layout_of(modality).data
    out = beambench.export(mixed / modality, to="tiff", out=tmp_path / "out", part="test", variables=[data])
    (path,) = (out / "test").glob("*.tif")
    pages = []
    file = oiio.ImageInput.open(str(path))
    while file.seek_subimage(len(pages), 0):
        pages.append(file.read_image(len(pages), 0, 0, 1, file.spec().format)[..., 0])
    file.close()
    variable = capture_of(modality, 1)[data]
    values = variable.values
    if "row" not in variable.dims:  # the first two dimensions are rows and columns, the others count pages
        values = np.moveaxis(values.reshape(*values.shape[:2], -1), -1, 0)
    assert np.array_equal(np.stack(pages), values) and np.stack(pages).dtype == values.dtype


@pytest.mark.parametrize("modality", MODALITIES)
def test_h5py_reads_hdf5_and_netcdf(mixed: Path, tmp_path: Path, modality: str) -> None:
    """The array that was measured, capture after capture."""
    import h5py

    data = layout_of(modality).data
    wanted = np.stack([capture_of(modality, number)[data].values for number in range(len(PARTS))])
    with h5py.File(beambench.export(mixed / modality, out=tmp_path / "out.h5")) as file:
        assert np.array_equal(file[data][...], wanted) and file[data].dtype == wanted.dtype
    pytest.importorskip("h5netcdf", reason="NetCDF is written by the extra `netcdf`")
    out = beambench.export(mixed / modality, to="netcdf", out=tmp_path / "out", part="train", variables=[data])
    (path,) = (out / "train").glob("*.nc")
    with h5py.File(path) as file:
        assert np.array_equal(file[data][...], wanted[np.array(PARTS) == "train"])
