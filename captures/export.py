"""Export captures without their truth as one HDF5 file, for programs in any language (docs/external-estimators.md)."""

from __future__ import annotations

import json
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from .hdf5 import hdf5_output
from .hide import hide_truth

if TYPE_CHECKING:
    import xarray as xr

    from .store.reader import CaptureSet

__all__ = ["export_hdf5"]


def export_hdf5(captures: CaptureSet, path: Path) -> None:
    """Write the part of captures that an estimator may read: no truth, no seed, nothing from which either follows.

    Datasets have the capture as first axis: the measured variable and its coordinates (e.g. `counts` (capture, slice, row,
    col), `delay` (capture, slice)), each with attributes `units` and `dims`; `rig` (capture), the declared instrument as
    JSON text. Attributes of the file: `schema_version`, `modality`, `averaged`, and `captures_sha256`, which estimates
    repeat to state which captures they belong to.

    Raises:
        InputError: a capture is damaged, or the file cannot be written or the disk is full; then no file is left.
    """
    import h5py

    with hdf5_output(path) as output:
        file = output.h5
        file.attrs["captures_sha256"] = captures.sha256
        rigs: list[str] = []
        for index in range(len(captures)):
            seen = hide_truth(captures[index])
            if index == 0:
                _create(file, seen, len(captures))
            for name, variable in seen.variables.items():
                file[str(name)][index] = np.asarray(variable.values)
                output.check()
            rig = seen.attrs["rig"]
            rigs.append(rig if isinstance(rig, str) else json.dumps(rig))
        file.create_dataset("rig", data=rigs, dtype=h5py.string_dtype())


def _create(file: Any, capture: xr.Dataset, count: int) -> None:
    """Write the attributes, and create datasets for `count` captures like this one."""
    for attribute in ("schema_version", "modality"):
        file.attrs[attribute] = capture.attrs[attribute]
    file.attrs["averaged"] = int(bool(capture.attrs.get("averaged", False)))
    for name, variable in capture.variables.items():
        dataset = file.create_dataset(
            str(name),
            shape=(count, *variable.shape),
            dtype="u1" if variable.dtype == bool else variable.dtype,
            chunks=(1, *variable.shape) if variable.size else None,
            compression="gzip" if variable.size else None,
        )
        dataset.attrs["units"] = str(variable.attrs.get("units", ""))
        dataset.attrs["dims"] = " ".join(["capture", *map(str, variable.dims)])
