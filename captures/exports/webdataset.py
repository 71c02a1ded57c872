"""WebDataset: tar files of samples, `000012.counts.npy`, `000012.truth_range.npy`, `000012.json`, the same bytes each time.

Source: A. Aizman, G. Maltby and T. Breuel, High performance I/O for large scale deep learning, IEEE Big Data 2019.
"""

from __future__ import annotations

import io
import json
import tarfile
from collections.abc import Callable, Mapping
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from ...scenes.json_keys import read_json
from ..layouts.schema import JSON_ATTRIBUTES
from .form import Format
from .selection import Piece, Selection

if TYPE_CHECKING:
    import xarray as xr

__all__ = ["BYTES_PER_FILE", "WEBDATASET", "plain_attributes", "write_samples"]

#: Bytes of a tar file that are aimed at: some seconds of a network, and enough files for many readers.
BYTES_PER_FILE = 2**27


def _nothing(key: str, capture: xr.Dataset, facts: dict[str, Any]) -> None:
    """Do nothing."""


def write_samples(
    piece: Piece, paths: list[Path], each: Callable[[str, xr.Dataset, dict[str, Any]], None] = _nothing
) -> None:
    """Write one tar file; `each` is called with the key, the capture and its facts. Raises OSError, InputError."""
    with open(paths[0], "xb") as raw, tarfile.open(fileobj=raw, mode="w", format=tarfile.USTAR_FORMAT) as tar:
        for place in piece.places:
            capture = piece.source.load(place)
            key = f"{piece.source.number(place):06d}"
            variables = {
                str(name): {"dims": list(map(str, one.dims)), **{str(k): v for k, v in one.attrs.items()}}
                for name, one in capture.variables.items()
            }
            facts = piece.source.facts(place)
            told = facts | {"variables": variables, "attributes": plain_attributes(capture.attrs)}
            _add(tar, f"{key}.json", json.dumps(told, sort_keys=True).encode())
            for name, variable in capture.variables.items():
                content = io.BytesIO()
                np.lib.format.write_array(content, np.ascontiguousarray(variable.values), allow_pickle=False)
                _add(tar, f"{key}.{name}.npy", content.getvalue())
            each(key, capture, facts)


def _add(tar: tarfile.TarFile, name: str, content: bytes) -> None:
    entry = tarfile.TarInfo(name)  # its time, owner and rights do not depend on the machine
    entry.size, entry.mode = len(content), 0o644
    tar.addfile(entry, io.BytesIO(content))


def plain_attributes(attrs: Mapping[Any, Any]) -> dict[str, Any]:
    """Attributes of a capture as JSON: those that are JSON texts as what they hold."""
    found = {}
    for name, value in attrs.items():
        plain = value.item() if isinstance(value, np.generic) else value
        if name in JSON_ATTRIBUTES and isinstance(plain, str):
            with suppress(ValueError):
                plain = read_json(plain)
        found[str(name)] = plain
    return found


def _pieces(selection: Selection, per_file: int | None, key: str) -> list[Piece]:
    return selection.packed(".tar", per_file, BYTES_PER_FILE)


WEBDATASET = Format(_pieces, lambda piece, paths: write_samples(piece, paths))
