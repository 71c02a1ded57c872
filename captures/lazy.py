"""All captures of a store as one `xarray.Dataset` along `capture`: only what is asked for is read, when it is asked for."""

from __future__ import annotations

import os
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
import xarray as xr
from numpy.typing import NDArray
from xarray.backends import BackendArray
from xarray.core import indexing

from .readers import Captures
from .store.shard_set import ShardedSet

if TYPE_CHECKING:
    from .store.reader import CaptureSet

__all__ = ["dataset"]


def dataset(path: str | os.PathLike[str], names: Sequence[str] | None = None, *, part: str | None = None) -> xr.Dataset:
    """The captures of a store, stacked along `capture`, read when they are computed with.

    Main arguments:
        path: a store, or DIR/GROUP of a data set of several modalities. names: variables to read; all if None.
    Other arguments:
        part: "train", "validation" or "test" of a data set's split; all if None.

    The coordinate `capture` is the number in the data set, `part` the part of the split. Each read is checked against its sha256;
    captures that a repair dropped are left out (`xarray.open_zarr` shows fill values in their place). What differs from capture to
    capture beside the arrays, such as rig and scene, is told by `open_captures(path).attributes(i)`.

    Raises InputError: no such store, variable or part; where a damaged capture is read, then.
    """
    captures = Captures(path, names, part=part)
    store = captures.captures
    first = store.load(int(captures.places[0]), names)
    variables = {str(name): _variable(captures, str(name), one) for name, one in first.variables.items()}
    coords = {name: one for name, one in variables.items() if name in first.coords}
    coords |= _numbers(store, captures.places)
    attrs = {"modality": store.modality, "store": str(store.path)}
    return xr.Dataset({name: one for name, one in variables.items() if name not in coords}, coords, attrs)


def _variable(captures: Captures, name: str, like: xr.Variable) -> xr.Variable:
    stack = indexing.LazilyIndexedArray(_Stack(captures, name, like))
    return xr.Variable(("capture", *like.dims), stack, dict(like.attrs))


def _numbers(store: CaptureSet, places: NDArray[np.int64]) -> dict[str, xr.Variable]:
    """Coordinates along `capture`, of a data set as its index tells."""
    if not isinstance(store, ShardedSet):
        return {"capture": xr.Variable(("capture",), places)}
    import pyarrow.compute as pc

    table = store.table(["group", "capture", "part"])
    own = table.filter(pc.equal(table["group"], store.group)).take(places)
    parts = np.asarray(own["part"].to_pylist(), dtype=object)
    return {
        "capture": xr.Variable(("capture",), own["capture"].to_numpy()),
        "part": xr.Variable(("capture",), np.where(parts == None, "", parts).astype(str)),  # noqa: E711 (elementwise)
    }


class _Stack(BackendArray):
    """One variable of all captures; a key picks captures first, and only these are read."""

    def __init__(self, captures: Captures, name: str, like: xr.Variable) -> None:
        self._captures, self._name = captures, name
        self.shape = (len(captures), *like.shape)
        self.dtype = like.dtype

    def __getitem__(self, key: indexing.ExplicitIndexer) -> Any:
        return indexing.explicit_indexing_adapter(key, self.shape, indexing.IndexingSupport.OUTER, self._read)

    def _read(self, key: tuple[Any, ...]) -> Any:
        chosen, *inner = key
        if isinstance(chosen, int | np.integer):
            return self._one(int(chosen), inner)
        numbers = range(self.shape[0])[chosen] if isinstance(chosen, slice) else [int(n) for n in chosen]
        found = [self._one(number, inner) for number in numbers]
        if found:
            return np.stack(found)
        return np.empty((0, *_picked(np.empty(self.shape[1:], self.dtype), inner).shape), self.dtype)

    def _one(self, number: int, inner: Sequence[Any]) -> NDArray[Any]:
        values = self._captures.read(int(self._captures.places[number]), (self._name,))[self._name]
        return _picked(values, inner)


def _picked(values: NDArray[Any], keys: Sequence[Any]) -> NDArray[Any]:
    """Each axis by its own key: a number, a slice, or an array of numbers."""
    for axis in reversed(range(len(keys))):
        values = values[(slice(None),) * axis + (keys[axis],)]
    return values
