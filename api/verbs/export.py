"""`beambench export`: captures as files that other programs read."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

from ..output import check_free, default_out

if TYPE_CHECKING:
    from ..benchmarks.folders.progress import Progress

__all__ = ["export"]


def export(
    data: str | Path,
    *,
    to: Literal["hdf5", "netcdf", "exr", "tiff", "webdataset", "croissant"] = "hdf5",
    part: str | None = None,
    variables: Sequence[str] | None = None,
    truth: bool = True,
    per_file: int | None = None,
    out: str | Path | None = None,
    resume: bool = False,
    overwrite: bool = False,
    progress: Progress | None = None,
) -> Path:
    """Write captures as files that other programs read; one capture is in memory at a time.

    hdf5 is one file without truth, for an estimator in any language (docs/external-estimators.md). All others are a folder, with a
    folder for each part of a split (docs/data-sets.md).

    Main arguments:
        data: A store of captures, a data set, or DIR/GROUP of one.
        to: The format.
    Other arguments:
        part: Part of a data set's split, e.g. train; all by default.
        variables: Name of a variable to export; all by default.
        truth: Export the truth, the seeds and what was drawn; hdf5 never has them.
        per_file: Captures of a file of netcdf, webdataset or croissant; by default so many that it has some hundred MB.
        out: The folder, of hdf5 the file; ./beambench-runs/<name>-<time> by default.
        resume: Continue an unfinished export of the same captures and options, or keep a complete one.
        overwrite: Replace an existing export.
        progress: Receives every step.

    Returns:
        The path of the folder or file.

    Raises:
        InputError: No store, part or variable; another format; an output that exists; a damaged capture, or one that the format
            cannot hold; a package that is missing; a full disk (complete files are kept to be resumed, of hdf5 nothing).
    """
    from ..benchmarks.folders.workplace import output_folder, refuse_inputs
    from ..captures.exports.run import export_captures
    from ..captures.store.faces import sharded_place

    if to == "hdf5":
        given = {"--part": part, "--variables": variables, "--per-file": per_file, "--resume": resume or None}
        return _one_file(data, given, out, overwrite)
    path = output_folder(out, f"export-{Path(data).stem}", resume=resume, overwrite=overwrite)
    source = Path(data).expanduser()
    place = sharded_place(source)
    refuse_inputs(path, [source] if place is None else [source, place[0]])
    export_captures(
        source, path, to, part=part, variables=variables, truth=truth, per_file=per_file, resume=resume,
        overwrite=overwrite, tell=progress,
    )  # fmt: skip
    return path


def _one_file(data: str | Path, given: dict[str, Any], out: str | Path | None, overwrite: bool) -> Path:
    """The file for estimators: all captures, so that their answers can be scored."""
    import h5py

    from ..captures import open_captures
    from ..captures.export import export_hdf5
    from ..scenes.errors import InputError
    from ..scenes.places import local_path

    for option, value in given.items():
        if value is not None:
            raise InputError(
                "The HDF5 file for estimators holds all captures and all that they may read.", where=option, value=value,
                allowed="--to netcdf, exr, tiff, webdataset or croissant", next_step="leave the option out, or change --to",
            )  # fmt: skip
    check_free(out, overwrite=overwrite)
    captures = open_captures(data)
    path = local_path(out) if out is not None else default_out(f"export-{Path(data).stem}").with_suffix(".h5")
    if path.exists() and (path.is_dir() or not h5py.is_hdf5(path)):
        raise InputError("The existing output is not an HDF5 file, so it is not replaced.", where=str(path))
    path.parent.mkdir(parents=True, exist_ok=True)
    export_hdf5(captures, path)
    return path
