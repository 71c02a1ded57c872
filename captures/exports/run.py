"""Export captures: the selection is written piece by piece by the writer of a format."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from importlib import import_module
from pathlib import Path
from typing import Any

from ...scenes.errors import InputError
from .form import Format
from .place import Pace, Tell, export_place, finish
from .selection import Piece, select

__all__ = ["FORMATS", "export_captures"]

#: format -> "module:object", a `Format` each.
FORMATS: dict[str, str] = {
    "webdataset": "beambench.captures.exports.webdataset:WEBDATASET",
    "netcdf": "beambench.captures.exports.netcdf:NETCDF",
    "exr": "beambench.captures.exports.exr:EXR",
    "tiff": "beambench.captures.exports.tiff:TIFF",
    "croissant": "beambench.captures.exports.croissant:CROISSANT",
}


def export_captures(
    path: Path,
    out: Path,
    to: str,
    *,
    part: str | None = None,
    variables: Sequence[str] | None = None,
    truth: bool = True,
    per_file: int | None = None,
    resume: bool = False,
    overwrite: bool = False,
    tell: Tell | None = None,
) -> int:
    """Write captures as files of the format `to` into the folder `out`, and return their number.

    Main arguments:
        path: a store, a data set, or DIR/GROUP of one. out: the folder.
    Other arguments:
        part, variables, truth: as of `selection.select`. per_file: captures of a file, where a file holds several.
        resume, overwrite: as of `place.export_place`. tell: receives the progress.

    One capture is in memory at a time. Raises InputError: see `select` and `export_place`; no such format; a missing package; a
    capture that is damaged, or that the format cannot hold.
    """
    form = _format(to)
    if per_file is not None and (per_file < 1 or not form.packed):
        raise InputError(
            "A file of this format holds one capture." if not form.packed else "A file holds at least one capture.",
            where="--per-file", value=per_file, allowed="1 or more, with a format that packs captures",
        )  # fmt: skip
    if form.ready is not None:
        form.ready()
    selection = select(path, part=part, variables=variables, truth=truth)
    request = {
        "to": to, "store": selection.sha256, "part": part, "truth": truth, "per_file": per_file,
        "groups": {one.name: list(one.names) for one in selection.sources},
    }  # fmt: skip
    key = _key(request)
    pieces = form.pieces(selection, per_file, key)
    with export_place(out, request, resume=resume, overwrite=overwrite) as place:
        if place is None:
            return selection.count
        pace = Pace(tell or _silent, selection.count, place.kept)
        for piece in pieces:
            if piece.files[0] in place.done:
                continue
            place.write(piece.files, len(piece.places), _writer(form, piece))
            pace.add(len(piece.places))
        more = form.more(selection, place, key) if form.more is not None else {}
        finish(place, request, more, {"dataset": dict(selection.about)})
    return selection.count


def _writer(form: Format, piece: Piece) -> Callable[[list[Path]], list[dict[str, Any]] | None]:
    return lambda paths: form.write(piece, paths)


def _silent(stage: str, done: int, total: int, text: str) -> None:
    """Say nothing."""


def _key(request: Mapping[str, Any]) -> str:
    """Eight hexadecimal digits that name the export: they follow from the store and the options."""
    import hashlib
    import json

    return hashlib.sha256(json.dumps(request, sort_keys=True).encode()).hexdigest()[:8]


def _format(to: str) -> Format:
    if to not in FORMATS:
        raise InputError("There is no export to this format.", where="--to", value=to, allowed=", ".join(FORMATS))
    module, _, name = FORMATS[to].partition(":")
    form: Format = getattr(import_module(module), name)
    return form
