"""`beambench export`: captures without their truth as one HDF5 file, for programs in any language."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any, Literal

from ..output import check_free, default_out

__all__ = ["export"]


def export(
    data: str | Path, *, to: Literal["hdf5"] = "hdf5", out: str | Path | None = None, overwrite: bool = False
) -> Path:
    """Write what an estimator may see of a store's captures into one HDF5 file, and return its path.

    Datasets with a leading capture axis: the measured variable and its coordinates (e.g. `counts` (capture, slice, row,
    col), `delay` (capture, slice)), each with attribute `units`; `rig` (capture), the declared instrument as JSON text.
    Attributes: `schema_version`, `modality`, `averaged`, `captures_sha256` (to be copied into estimates, which ties them to
    these captures). No truth, no seed, nothing that tells of either.

    Main arguments:
        data: a store of captures. to: the format.
    Other arguments:
        out: the file; ./beambench-runs/<name>-<time>.h5 by default. overwrite: replace an HDF5 file there.

    Raises:
        InputError: no store, another format, an output that exists, or a full disk (nothing is left then).
    """
    import h5py
    import numpy as np

    from ..captures import open_captures
    from ..captures.hdf5 import hdf5_output
    from ..captures.hide import hide_truth
    from ..scenes.errors import InputError

    if to != "hdf5":
        raise InputError("There is no export to this format.", where="--to", value=to, allowed="hdf5")
    check_free(out, overwrite=overwrite)
    captures = open_captures(data)
    path = Path(out).expanduser() if out is not None else default_out(f"export-{Path(data).stem}").with_suffix(".h5")
    if path.exists() and (path.is_dir() or not h5py.is_hdf5(path)):
        raise InputError("What is there is no HDF5 file, so it is not replaced.", where=str(path))
    path.parent.mkdir(parents=True, exist_ok=True)
    with hdf5_output(path) as output:
        file = output.h5
        file.attrs["captures_sha256"] = captures.sha256
        rigs: list[str] = []
        for index in range(len(captures)):
            seen = hide_truth(captures[index])
            if index == 0:
                for attribute in ("schema_version", "modality"):
                    file.attrs[attribute] = seen.attrs[attribute]
                file.attrs["averaged"] = int(bool(seen.attrs.get("averaged", False)))
            for key, variable in seen.variables.items():
                name = str(key)
                values: Any = np.asarray(variable.values)
                if index == 0:
                    dataset = file.create_dataset(
                        name,
                        shape=(len(captures), *values.shape),
                        dtype="u1" if values.dtype == bool else values.dtype,
                        chunks=(1, *values.shape) if values.size else None,
                        compression="gzip" if values.size else None,
                    )
                    dataset.attrs["units"] = str(variable.attrs.get("units", ""))
                    dataset.attrs["dims"] = " ".join(["capture", *map(str, variable.dims)])
                file[name][index] = values
                output.check()
            rig = seen.attrs["rig"]
            rigs.append(rig if isinstance(rig, str) else json.dumps(rig))
        file.create_dataset("rig", data=rigs, dtype=h5py.string_dtype())
    return path
