"""`beambench export`: captures without their truth as one HDF5 file, for programs in any language."""

from __future__ import annotations

from pathlib import Path
from typing import Literal

from ..output import check_free, default_out

__all__ = ["export"]


def export(
    data: str | Path, *, to: Literal["hdf5"] = "hdf5", out: str | Path | None = None, overwrite: bool = False
) -> Path:
    """Write captures without their truth as one HDF5 file, for an estimator in any language.

    docs/external-estimators.md describes the file.

    Main arguments:
        data: A store of captures.
        to: The format.
    Other arguments:
        out: The file; ./beambench-runs/<name>-<time>.h5 by default.
        overwrite: Replace an existing HDF5 file.

    Returns:
        The path of the file.

    Raises:
        InputError: No store, another format, an output that exists, or a full disk (nothing is left then).
    """
    import h5py

    from ..captures import open_captures
    from ..captures.export import export_hdf5
    from ..scenes.errors import InputError
    from ..scenes.places import local_path

    if to != "hdf5":
        raise InputError("There is no export to this format.", where="--to", value=to, allowed="hdf5")
    check_free(out, overwrite=overwrite)
    captures = open_captures(data)
    path = local_path(out) if out is not None else default_out(f"export-{Path(data).stem}").with_suffix(".h5")
    if path.exists() and (path.is_dir() or not h5py.is_hdf5(path)):
        raise InputError("The existing output is not an HDF5 file, so it is not replaced.", where=str(path))
    path.parent.mkdir(parents=True, exist_ok=True)
    export_hdf5(captures, path)
    return path
