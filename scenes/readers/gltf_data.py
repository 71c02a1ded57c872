"""The numbers of a glTF 2.0 file: container, buffers and accessors (Khronos, glTF 2.0 specification, sections 3.6 and 4)."""

from __future__ import annotations

import base64
import binascii
from typing import Any
from urllib.parse import unquote, unquote_to_bytes

import numpy as np

from ..json_keys import read_json
from .surface import Fetch

__all__ = ["GltfData", "outside_files"]

_TYPES = {5120: "<i1", 5121: "<u1", 5122: "<i2", 5123: "<u2", 5125: "<u4", 5126: "<f4"}
_WIDTHS = {"SCALAR": 1, "VEC2": 2, "VEC3": 3, "VEC4": 4, "MAT4": 16}
#: Most elements of an accessor, which a file can ask for without holding them.
_MOST = 2**24
_MAGIC, _JSON, _BIN = 0x46546C67, 0x4E4F534A, 0x004E4942


def outside_files(content: bytes) -> list[str]:
    """Names, as they stand there, of the files that hold the file's numbers. Empty for what is no glTF."""
    try:
        document, _ = _container(content)
    except ValueError:
        return []
    buffers = document.get("buffers")
    uris = [item.get("uri") for item in buffers if isinstance(item, dict)] if isinstance(buffers, list) else []
    return [unquote(uri) for uri in uris if isinstance(uri, str) and not uri.startswith("data:")]


class GltfData:
    """The document of a glTF or GLB file, and its arrays.

    Main arguments:
        content: of the file. fetch: gives the content of the files that it names.

    Raises:
        ValueError: no glTF 2, or damaged.
    """

    def __init__(self, content: bytes, fetch: Fetch) -> None:
        self.document, self._chunk = _container(content)
        self._fetch = fetch
        self._buffers: dict[int, bytes] = {}
        version = str(self._table(self.document, "asset").get("version", ""))
        if version.partition(".")[0] != "2":
            raise ValueError(f"it is of glTF version {version or '(none)'}; 2.x is read")

    @staticmethod
    def _table(parent: Any, key: str) -> dict[str, Any]:
        found = parent.get(key) if isinstance(parent, dict) else None
        if not isinstance(found, dict):
            raise ValueError(f"it lacks {key!r}")
        return found

    def item(self, kind: str, index: Any) -> dict[str, Any]:
        """Entry `index` of a list of the document, such as "accessors"."""
        entries = self.document.get(kind)
        if not isinstance(entries, list) or not isinstance(index, int) or not 0 <= index < len(entries):
            raise ValueError(f"it names {kind} {index!r}, which it does not have")
        if not isinstance(entries[index], dict):
            raise ValueError(f"{kind} {index} is no object")
        return dict(entries[index])

    def accessor(self, index: Any) -> np.ndarray:
        """The elements (count, width) of an accessor: floats where it is of floats or normalised, else whole numbers."""
        spec = self.item("accessors", index)
        kind, width, count = spec.get("componentType"), _WIDTHS.get(str(spec.get("type"))), spec.get("count")
        if kind not in _TYPES or width is None or not isinstance(count, int) or not 1 <= count <= _MOST:
            raise ValueError(f"accessor {index} is of an unknown form")
        layout = np.dtype(_TYPES[kind])
        if "bufferView" in spec:
            found = self._view(spec["bufferView"], spec.get("byteOffset", 0), layout, count, width).copy()
        else:
            found = np.zeros((count, width), dtype=layout)
        if isinstance(spec.get("sparse"), dict):
            self._place_sparse(spec["sparse"], found, layout, width, index)
        if not spec.get("normalized", False) or layout.kind == "f":
            return found.astype(np.float64) if layout.kind == "f" else found.astype(np.int64)
        return np.maximum(found / float(np.iinfo(layout).max), -1.0)

    def _place_sparse(
        self, sparse: dict[str, Any], found: np.ndarray, layout: np.dtype[Any], width: int, index: Any
    ) -> None:
        where, what = self._table(sparse, "indices"), self._table(sparse, "values")
        count = sparse.get("count")
        if (
            where.get("componentType") not in (5121, 5123, 5125)
            or not isinstance(count, int)
            or not 1 <= count <= _MOST
        ):
            raise ValueError(f"the sparse part of accessor {index} is of an unknown form")
        kind = np.dtype(_TYPES[where["componentType"]])
        places = self._view(where.get("bufferView"), where.get("byteOffset", 0), kind, count, 1)[:, 0].astype(np.int64)
        if places.max() >= len(found):
            raise ValueError(f"the sparse part of accessor {index} names elements that it does not have")
        found[places] = self._view(what.get("bufferView"), what.get("byteOffset", 0), layout, count, width)

    def _view(self, index: Any, offset: int, layout: np.dtype[Any], count: int, width: int) -> np.ndarray:
        view = self.item("bufferViews", index)
        buffer = self._buffer(view.get("buffer"))
        start, length = int(view.get("byteOffset", 0)), int(view.get("byteLength", 0))
        size = layout.itemsize * width
        stride = int(view.get("byteStride") or size)
        if start < 0 or offset < 0 or stride < size or offset + stride * (count - 1) + size > length:
            raise ValueError(f"buffer view {index} is too short for what it should hold")
        if start + length > len(buffer):
            raise ValueError(f"buffer {view.get('buffer')} ends within buffer view {index}")
        return np.ndarray((count, width), layout, buffer, start + offset, (stride, layout.itemsize))

    def _buffer(self, index: Any) -> bytes:
        if index not in self._buffers:
            spec = self.item("buffers", index)
            uri = spec.get("uri")
            if isinstance(uri, str):
                content = _data_uri(uri) if uri.startswith("data:") else self._fetch(unquote(uri))
            elif index == 0 and self._chunk is not None:
                content = self._chunk
            else:
                raise ValueError(f"buffer {index} has no data")
            if len(content) < int(spec.get("byteLength", 0)):
                raise ValueError(f"buffer {index} has {len(content)} bytes of {spec.get('byteLength')}")
            self._buffers[index] = content
        return self._buffers[index]


def _container(content: bytes) -> tuple[dict[str, Any], bytes | None]:
    """(document, binary chunk) of GLB, or of text."""
    chunk: bytes | None = None
    if int.from_bytes(content[:4], "little") == _MAGIC:
        version, length = (int.from_bytes(content[i : i + 4], "little") for i in (4, 8))
        if version != 2:
            raise ValueError(f"it is of GLB version {version}; 2 is read")
        if length > len(content):
            raise ValueError(f"it tells of {length} bytes, and has {len(content)}")
        parts: dict[int, bytes] = {}
        at = 12
        while at + 8 <= length:
            size, kind = (int.from_bytes(content[i : i + 4], "little") for i in (at, at + 4))
            if at + 8 + size > length:
                raise ValueError("a chunk ends behind the file")
            parts.setdefault(kind, content[at + 8 : at + 8 + size])
            at += 8 + size
        text, chunk = parts.get(_JSON, b""), parts.get(_BIN)
    else:
        text = content
    try:
        document = read_json(text.decode("utf-8-sig"))
    except ValueError as error:
        raise ValueError(f"it is no JSON: {error}") from error
    if not isinstance(document, dict):
        raise ValueError("it is no JSON object")
    return document, chunk


def _data_uri(uri: str) -> bytes:
    head, comma, body = uri.partition(",")
    if not comma:
        raise ValueError("a data URI has no data")
    try:
        return base64.b64decode(unquote(body), validate=True) if head.endswith(";base64") else unquote_to_bytes(body)
    except (binascii.Error, ValueError) as error:
        raise ValueError(f"a data URI is damaged: {error}") from error
