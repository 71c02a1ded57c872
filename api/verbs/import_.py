"""`beambench import`: captures from files of other programs."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path

from ..output import check_free, claim, default_out

__all__ = ["Imported", "import_"]


@dataclass(frozen=True)
class Imported:
    """The stores that were written, with the number of captures of each; or the text of a scaffold, and its file."""

    stores: dict[Path, int] = field(default_factory=dict)
    scaffold: str = ""
    out: Path | None = None


def import_(
    files: Sequence[str | Path],
    *,
    map: str | Path | None = None,
    scaffold: bool = False,
    modality: str = "",
    out: str | Path | None = None,
    overwrite: bool = False,
) -> Imported:
    """Read files of other programs as captures, by a mapping that says what their arrays are.

    PNG, TIFF, EXR, FITS, HDF5, NPY, NPZ, MAT, Andor .sif, .spe, LeCroy .trc and CSV; docs/importing.md describes the mapping. The
    captures are ordinary ones: `data verify`, `estimate` and `score` take them.

    Main arguments:
        files: Files, or the folder that holds those which the mapping names.
        map: The mapping: a .toml file, or the name of one that ships with the project.
    Other arguments:
        scaffold: Write a mapping for these files instead, with a question mark where they do not tell.
        modality: What the files are of, for `scaffold`.
        out: The store; of a mapping that lists several a folder of them; ./beambench-runs/<name>-<time> by default. With
            `scaffold` the mapping's file; the terminal by default.
        overwrite: Replace an existing store or mapping.

    Returns:
        `stores` {path: number of captures}, or `scaffold`, the text.

    Raises:
        InputError: Files, arrays, units or a rig that do not fit, question marks that are left, an output that exists.
    """
    from ..scenes.errors import InputError

    given: list[str | Path] = [files] if isinstance(files, str | Path) else list(files)
    if not given:
        raise InputError("No file is named.", where="FILES", next_step="beambench import --help")
    for one in given:
        if not Path(one).expanduser().exists():
            raise InputError("There is no such file or folder.", where="FILES", value=str(one))
    if scaffold:
        return _scaffold(given, modality, out, overwrite=overwrite)
    if map is None:
        raise InputError(
            "A mapping says what the files are.", where="--map", allowed=", ".join(_library()) + ", or a .toml file",
            next_step=f"beambench import {given[0]} --scaffold -o mapping.toml",
        )  # fmt: skip
    return _import(given, map, out, overwrite=overwrite)


def _library() -> list[str]:
    from ..captures.imports.mapping import LIBRARY

    return sorted(path.stem for path in LIBRARY.glob("*.toml"))


def _import(given: list[str | Path], map: str | Path, out: str | Path | None, *, overwrite: bool) -> Imported:
    from ..benchmarks.datasets.imported import imported_captures, mappings_of
    from ..captures import open_captures, write
    from ..scenes.places import local_path

    mappings = mappings_of(map)
    base = default_out(Path(map).stem) if out is None else local_path(out)
    single = len(mappings) == 1
    stores: dict[Path, int] = {}
    for name in mappings:
        check_free(base if single else base / f"{name}.zarr", overwrite=overwrite)
    for name, mapping in mappings.items():
        path = base if single else base / f"{name}.zarr"
        write(path, imported_captures(mapping, given, name), overwrite=overwrite)
        stores[path] = len(open_captures(path))
    return Imported(stores)


def _scaffold(given: list[str | Path], modality: str, out: str | Path | None, *, overwrite: bool) -> Imported:
    import os

    from ..captures.imports.scaffold import scaffold as written

    text = written(tuple(Path(one).expanduser() for one in given), modality)
    if out is None:
        return Imported(scaffold=text)
    path = claim(out, "mapping.toml", overwrite=overwrite, ours=lambda old: old.suffix == ".toml")
    part = path.with_name(f"{path.name}.partial")
    part.write_text(text, encoding="utf-8")
    os.replace(part, path)
    return Imported(scaffold=text, out=path)
