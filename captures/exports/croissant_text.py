"""The text of `croissant.json`: files with their sha256, splits, samples as records, and each variable's arrays as records."""

from __future__ import annotations

import hashlib
import io
import json
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

from ..layouts import layout_of

if TYPE_CHECKING:
    from .selection import Selection, Source

__all__ = ["croissant_text"]

_CONTEXT = {
    "@language": "en", "@vocab": "https://schema.org/", "arrayShape": "cr:arrayShape", "citeAs": "cr:citeAs", "column": "cr:column",
    "conformsTo": "dct:conformsTo", "containedIn": "cr:containedIn", "cr": "http://mlcommons.org/croissant/",
    "rai": "http://mlcommons.org/croissant/RAI/", "data": {"@id": "cr:data", "@type": "@json"},
    "dataType": {"@id": "cr:dataType", "@type": "@vocab"}, "dct": "http://purl.org/dc/terms/",
    "description": {"@container": "@language"}, "equivalentProperty": "cr:equivalentProperty",
    "examples": {"@id": "cr:examples", "@type": "@json"}, "extract": "cr:extract", "field": "cr:field",
    "fileProperty": "cr:fileProperty", "fileObject": "cr:fileObject", "fileSet": "cr:fileSet", "format": "cr:format",
    "includes": "cr:includes", "isArray": "cr:isArray", "isLiveDataset": "cr:isLiveDataset", "jsonPath": "cr:jsonPath",
    "key": "cr:key", "md5": "cr:md5", "name": {"@container": "@language"}, "parentField": "cr:parentField", "path": "cr:path",
    "recordSet": "cr:recordSet", "references": "cr:references", "regex": "cr:regex", "repeated": "cr:repeated",
    "replace": "cr:replace", "samplingRate": "cr:samplingRate", "sc": "https://schema.org/", "separator": "cr:separator",
    "source": "cr:source", "subField": "cr:subField", "transform": "cr:transform",
}  # fmt: skip
_CONFORMS = "http://mlcommons.org/croissant/1.1"
_TYPES = {"int64": "cr:Int64", "double": "cr:Float64", "string": "sc:Text"}
#: What the columns of the samples mean.
_COLUMNS = {
    "key": "number of the capture, as the files are named", "split": "part of the split", "group": "modality",
    "file": "archive that holds the sample", "capture": "number of the capture in the data set", "base": "base scene",
    "draw": "number of the draw", "seed": "seed of the random streams", "scene_sha256": "sha256 of target and medium",
    "content": "sha256 of all values and attributes",
}  # fmt: skip


def croissant_text(
    selection: Selection, key: str, groups: Mapping[str, Mapping[str, Any]], files: Mapping[str, Sequence[Any]], samples: str,
    table: bytes,
) -> bytes:  # fmt: skip
    """The metadata as JSON-LD. What the data set does not say (licence, citation, description) is left out, never invented.

    Main arguments:
        selection: what was exported. key: names the export. groups: {group: {"files": …, "source": Source}}.
        files: {name: [bytes, sha256]}. samples, table: name and content of the table of samples.
    """
    about = selection.about
    name = str(about.get("name") or selection.path.name)
    splits = sorted({part for one in selection.sources for part in one.parts if part})
    body: dict[str, Any] = {
        "@context": _CONTEXT, "@type": "sc:Dataset", "name": name, "conformsTo": _CONFORMS,
        "description": about.get("description") or about.get("title") or _plainly(selection),
        "version": f"{about.get('version', 1)}.0.0", "alternateName": about.get("title"), "license": about.get("licence"),
        "citeAs": about.get("citation"), "keywords": ["synthetic", "active optical sensing", *groups],
        "distribution": _distribution(groups, files, samples, table),
        "recordSet": [
            *([_splits(splits)] if splits else []), _samples(samples, table, bool(splits)),
            *(record for one in groups.values() for record in _arrays(one["source"], samples)),
        ],
    }  # fmt: skip
    return (json.dumps({k: v for k, v in body.items() if v not in (None, "")}, indent=1) + "\n").encode()


def _plainly(selection: Selection) -> str:
    told = ", ".join(f"{one.count} {one.name}" for one in selection.sources)
    return f"Captures with exact truth by Beambench: {told}."


def _distribution(
    groups: Mapping[str, Mapping[str, Any]], files: Mapping[str, Sequence[Any]], samples: str, table: bytes
) -> list[dict[str, Any]]:
    objects = [
        {
            "@type": "cr:FileObject", "@id": samples, "name": samples, "contentUrl": samples,
            "encodingFormat": "application/x-parquet", "contentSize": f"{len(table)} B",
            "sha256": hashlib.sha256(table).hexdigest(),
        }
    ]  # fmt: skip
    objects += [
        {
            "@type": "cr:FileObject", "@id": name, "name": name, "contentUrl": name, "encodingFormat": "application/x-tar",
            "contentSize": f"{size} B", "sha256": digest,
        }
        for name, (size, digest) in sorted(files.items())
    ]  # fmt: skip
    sets = [
        {
            "@type": "cr:FileSet", "@id": _set(group, variable), "name": _set(group, variable),
            "description": "one .npy file a capture: numpy.load(io.BytesIO(content))",
            "containedIn": [{"@id": name} for name in one["files"]], "encodingFormat": "application/octet-stream",
            "includes": f"*.{variable}.npy",
        }
        for group, one in groups.items()
        for variable in one["source"].names
    ]  # fmt: skip
    return [*objects, *sets]


def _set(group: str, variable: str) -> str:
    return f"{group}-{variable}-files"


def _splits(names: Sequence[str]) -> dict[str, Any]:
    return {
        "@type": "cr:RecordSet", "@id": "splits", "name": "splits", "description": "parts of the split",
        "dataType": "cr:Split", "key": {"@id": "splits/name"},
        "field": [{"@type": "cr:Field", "@id": "splits/name", "name": "name", "dataType": "sc:Text"}],
        "data": [{"splits/name": name} for name in names],
    }  # fmt: skip


def _column(record: str, samples: str, name: str, kind: str, about: str) -> dict[str, Any]:
    return {
        "@type": "cr:Field", "@id": f"{record}/{name}", "name": name, "description": about, "dataType": kind,
        "source": {"fileObject": {"@id": samples}, "extract": {"column": name}},
    }  # fmt: skip


def _samples(samples: str, table: bytes, split: bool) -> dict[str, Any]:
    """A record for each capture: its place, what was drawn, and numbers of its values."""
    import pyarrow.parquet as pq

    fields = []
    for column in pq.read_schema(io.BytesIO(table)):
        told = _COLUMNS.get(column.name) or (
            f"drawn: {column.name.removeprefix('drawn_')}" if column.name.startswith("drawn_") else
            f"{column.name.rpartition('_')[2]} of {column.name.rpartition('_')[0]} over the capture"
        )  # fmt: skip
        field = _column("samples", samples, column.name, _TYPES[str(column.type)], told)
        if column.name == "split" and split:
            field["references"] = {"field": {"@id": "splits/name"}}
        fields.append(field)
    return {
        "@type": "cr:RecordSet", "@id": "samples", "name": "samples", "description": "one record for each capture",
        "key": {"@id": "samples/key"}, "field": fields,
    }  # fmt: skip


def _arrays(source: Source, samples: str) -> list[dict[str, Any]]:
    """For each variable a record for each capture: its key, and the array as the bytes of an .npy file."""
    known = layout_of(source.captures.modality).by_name
    return [
        {
            "@type": "cr:RecordSet", "@id": f"{source.name}-{name}", "name": f"{source.name}-{name}",
            "description": known[name].long_name if name in known else name, "key": {"@id": f"{source.name}-{name}/key"},
            "field": [
                {
                    "@type": "cr:Field", "@id": f"{source.name}-{name}/key", "name": "key", "dataType": "sc:Text",
                    "description": "number of the capture: samples/key",
                    "source": {
                        "fileSet": {"@id": _set(source.name, name)}, "extract": {"fileProperty": "filename"},
                        "transform": {"regex": r"^(\d+)"},
                    },
                    "references": {"fileObject": {"@id": samples}, "extract": {"column": "key"}},
                },
                _column(f"{source.name}-{name}", samples, "split", "sc:Text", _COLUMNS["split"]),
                {
                    "@type": "cr:Field", "@id": f"{source.name}-{name}/npy", "name": "npy", "dataType": "sc:Text",
                    "description": "the array, as the bytes of an .npy file",
                    "source": {"fileSet": {"@id": _set(source.name, name)}, "extract": {"fileProperty": "content"}},
                },
            ],
        }
        for name in source.names
    ]  # fmt: skip
