"""The table of all captures of a store, `index.parquet`: a row for each, written shard by shard."""

from __future__ import annotations

import io
import json
from collections.abc import Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from .shard_receipts import Held, Receipt

if TYPE_CHECKING:
    import pyarrow as pa

__all__ = ["IndexFile", "index_content", "index_rows", "read_index"]

#: Columns that every row has, with their types; what was drawn follows, as `p.<name>`.
_COLUMNS = {
    "capture": "int64", "group": "string", "position": "int64", "shard": "int64", "part": "string", "base": "string",
    "draw": "int64", "seed": "int64", "scene_sha256": "string", "content": "string",
}  # fmt: skip


def index_rows(receipt: Receipt) -> list[dict[str, Any]]:
    """The rows of a shard. `position` is the place along `capture` of the group's arrays."""
    return [_row(receipt, held) for held in receipt.captures]


def _row(receipt: Receipt, held: Held) -> dict[str, Any]:
    facts = dict(held.facts)
    drawn = facts.pop("values", {})
    row = {
        "capture": held.index, "group": receipt.group, "position": receipt.shard * receipt.length + held.row,
        "shard": receipt.shard, "content": held.content,
    }  # fmt: skip
    row |= {name: facts[name] for name in _COLUMNS if name in facts}
    return row | {f"p.{name}": value for name, value in (drawn if isinstance(drawn, Mapping) else {}).items()}


def index_content(receipts: Iterable[Receipt], numbers: Iterable[str], texts: Iterable[str]) -> bytes:
    """The file of these receipts. Arguments as of `IndexFile`."""
    index = IndexFile(numbers, texts)
    for _ in index.passing(receipts):
        pass
    return index.content()


class IndexFile:
    """The file, written while receipts pass, so that they are read once for it and for the manifest.

    Main arguments:
        numbers, texts: names of what was drawn, as numbers, and as JSON texts.
    """

    def __init__(self, numbers: Iterable[str], texts: Iterable[str]) -> None:
        import pyarrow.parquet as pq

        self._schema = _schema([f"p.{name}" for name in numbers], [f"p.{name}" for name in texts])
        self._file = io.BytesIO()
        self._writer = pq.ParquetWriter(self._file, self._schema, compression="zstd")

    def passing(self, receipts: Iterable[Receipt]) -> Iterator[Receipt]:
        """The same receipts in their order, one in memory at a time; their rows are written."""
        import pyarrow as pa

        kinds = {name: str(self._schema.field(name).type) for name in self._schema.names}
        for receipt in receipts:
            rows = [{name: _as(row.get(name), kind) for name, kind in kinds.items()} for row in index_rows(receipt)]
            if rows:
                self._writer.write_table(pa.Table.from_pylist(rows, self._schema))
            yield receipt

    def content(self) -> bytes:
        """The file of what has passed; nothing may pass any more."""
        self._writer.close()
        return self._file.getvalue()


def _schema(numbers: list[str], texts: list[str]) -> pa.Schema:
    import pyarrow as pa

    fields = [(name, getattr(pa, kind)()) for name, kind in _COLUMNS.items()]
    return pa.schema([*fields, *((name, pa.float64()) for name in numbers), *((name, pa.string()) for name in texts)])


def _as(value: Any, kind: str) -> Any:
    if value is None:
        return None
    if kind == "string":
        return value if isinstance(value, str) else json.dumps(value, sort_keys=True)
    number = isinstance(value, int | float) and not isinstance(value, bool)
    if kind == "double":
        return float(value) if number else None
    return int(value) if number else None


def read_index(path: Path, columns: Sequence[str] | None = None) -> pa.Table:
    """The table of a finished store, or some of its columns. Raises OSError, pyarrow.ArrowException."""
    import pyarrow.parquet as pq

    return pq.read_table(path, columns=None if columns is None else list(columns))
