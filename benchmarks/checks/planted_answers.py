"""Hostile plug-ins by what they answer or raise. `plugins` runs each beside an honest estimator."""

from __future__ import annotations

import errno
import os
from pathlib import Path
from typing import Any, NoReturn

import numpy as np
import xarray as xr

from .gated_cheats import answer, planted

__all__: list[str] = []

_DIMS = ("row", "col")


def _with(capture: xr.Dataset, name: str, value: Any) -> xr.Dataset:
    """An honest answer with one variable replaced."""
    found = answer(capture)
    held = np.asarray(value)
    return found.assign({name: (_DIMS, np.broadcast_to(held, found[name].shape) if held.ndim < 2 else held)})


def _odd(capture: xr.Dataset, name: str, value: float) -> xr.Dataset:
    """An honest answer with one odd number."""
    found = answer(capture)
    found[name][0, 0] = value
    return found


# ---------------------------------------------------------------- answers


@planted
def returns_none(capture: xr.Dataset) -> Any:
    """Return None."""
    return None


@planted
def returns_an_array(capture: xr.Dataset) -> Any:
    """Return an array in place of a data set."""
    return answer(capture)["range"].values


@planted
def returns_a_proxy(capture: xr.Dataset) -> Any:
    """Return an object that says it is a data set and has every attribute."""

    def itself(proxy: Any, *given: Any) -> Any:
        return type(proxy)()

    says = property(lambda proxy: xr.Dataset)
    made: Any = type(
        "Proxy",
        (),
        {"__getattr__": itself, "__getitem__": itself, "__contains__": lambda proxy, name: True, "__class__": says},
    )
    return made()


class _Raises(xr.Dataset):  # type: ignore[no-untyped-call]
    __slots__ = ()

    def __getitem__(self, name: Any) -> NoReturn:
        raise SystemExit(0)


class _Changes(xr.Dataset):  # type: ignore[no-untyped-call]
    __slots__ = ()

    def __getitem__(self, name: Any) -> Any:
        held = super().__getitem__(name)
        return held if np.random.default_rng().random() < 0.5 else held.isel(row=slice(0, 1))


@planted
def data_set_that_raises(capture: xr.Dataset) -> Any:
    """Return a kind of data set that ends the process when it is read."""
    return _Raises(dict(answer(capture).data_vars))


@planted
def data_set_that_changes(capture: xr.Dataset) -> Any:
    """Return a kind of data set that is another one each time it is read."""
    return _Changes(dict(answer(capture).data_vars))


class _Lazy:
    """An array that is computed when it is read, and then raises."""

    shape, dtype, ndim = (4, 4), np.dtype(np.float64), 2

    def __array__(self, dtype: Any = None, copy: Any = None) -> NoReturn:
        raise KeyboardInterrupt

    def __array_function__(self, *given: Any) -> NoReturn:
        raise KeyboardInterrupt

    def __array_ufunc__(self, *given: Any) -> NoReturn:
        raise KeyboardInterrupt


@planted
def lazy_array(capture: xr.Dataset) -> Any:
    """Return an array that interrupts the process when it is computed."""
    return answer(capture).assign(range=(_DIMS, _Lazy()))


@planted
def wrong_shape(capture: xr.Dataset) -> Any:
    """Leave out a row."""
    return answer(capture).isel(row=slice(1, None))


@planted
def transposed(capture: xr.Dataset) -> Any:
    """Swap rows and columns."""
    return answer(capture).transpose("col", "row")


@planted
def without_sigma(capture: xr.Dataset) -> Any:
    """Leave out the standard error."""
    return answer(capture).drop_vars("sigma")


@planted
def no_dimensions(capture: xr.Dataset) -> Any:
    """Answer one number for the image."""
    return answer(capture).assign(range=2.0)


@planted
def not_a_number(capture: xr.Dataset) -> Any:
    """Call NaN valid."""
    return _odd(capture, "range", np.nan)


@planted
def infinite(capture: xr.Dataset) -> Any:
    """Call an infinite range valid."""
    return _odd(capture, "range", np.inf)


@planted
def absurd(capture: xr.Dataset) -> Any:
    """Answer 1e155 m in one pixel."""
    return _odd(capture, "range", 1e155)


@planted
def large_and_finite(capture: xr.Dataset) -> Any:
    """Answer 9e29 m, just below what is taken for a number."""
    return _odd(capture, "range", 9e29)


@planted
def negative_sigma(capture: xr.Dataset) -> Any:
    """State a negative standard error."""
    return _odd(capture, "sigma", -1.0)


@planted
def no_sigma_at_all(capture: xr.Dataset) -> Any:
    """State a standard error of zero."""
    return _odd(capture, "sigma", 0.0)


@planted
def tiny_sigma(capture: xr.Dataset) -> Any:
    """State a standard error of 1e-200."""
    return _odd(capture, "sigma", 1e-200)


@planted
def objects(capture: xr.Dataset) -> Any:
    """Answer Python objects."""
    return _with(capture, "range", np.array(object(), object))


@planted
def texts(capture: xr.Dataset) -> Any:
    """Answer text."""
    return _with(capture, "range", "2.0")


@planted
def complex_numbers(capture: xr.Dataset) -> Any:
    """Answer complex numbers."""
    return _with(capture, "range", 2.0 + 1j)


@planted
def dates(capture: xr.Dataset) -> Any:
    """Answer dates."""
    return _with(capture, "range", np.datetime64("2026-01-01", "ns"))


@planted
def long_doubles(capture: xr.Dataset) -> Any:
    """Answer numbers of 80 bits, the largest there is."""
    return _with(capture, "range", np.finfo(np.longdouble).max)


@planted
def flags_of_numbers(capture: xr.Dataset) -> Any:
    """Say 0.5 for valid."""
    return _with(capture, "valid", 0.5)


@planted
def vast_view(capture: xr.Dataset) -> Any:
    """Answer an image of 10^12 pixels that takes eight bytes until it is copied."""
    view = np.broadcast_to(np.float64(2.0), (10**6, 10**6))
    return xr.Dataset(dict.fromkeys(("range", "sigma", "valid"), (_DIMS, view)))


@planted
def vast_attributes(capture: xr.Dataset) -> Any:
    """Answer with 64 MB of attributes, names with control sequences, and 1,000 variables that nobody asked for."""
    found = answer(capture).assign_attrs({"\x1b[2J\udcff": "x" * 2**26})
    return found.assign({f"\x1b[31m{number}": number for number in range(1000)})


# ---------------------------------------------------------------- exceptions


@planted
def lone_surrogate(capture: xr.Dataset) -> Any:
    """Raise a message with half of a character."""
    raise RuntimeError("\udcff \ud800 half")


@planted
def control_sequences(capture: xr.Dataset) -> Any:
    """Raise a message that clears the terminal and renames its window."""
    raise RuntimeError("\x1b[2J\x1b]0;mine\x07\x9b31m\r\n| a | table |")


@planted
def vast_message(capture: xr.Dataset) -> Any:
    """Raise a message of 64 MB."""
    raise RuntimeError("x" * 2**26)


class _Mute(Exception):
    def __str__(self) -> str:
        raise ValueError("no text")


class _Endless(Exception):
    def __str__(self) -> str:
        while True:
            pass


@planted
def message_that_raises(capture: xr.Dataset) -> Any:
    """Raise an exception whose text raises another."""
    raise _Mute


@planted
def message_that_hangs(capture: xr.Dataset) -> Any:
    """Raise an exception whose text is never ready."""
    raise _Endless


@planted
def interrupts(capture: xr.Dataset) -> Any:
    """Raise KeyboardInterrupt."""
    raise KeyboardInterrupt


@planted
def base_exception(capture: xr.Dataset) -> Any:
    """Raise GeneratorExit, which is no Exception."""
    raise GeneratorExit


@planted
def recursion(capture: xr.Dataset) -> Any:
    """Call itself without an end."""
    return recursion(capture)


@planted
def claims_no_memory(capture: xr.Dataset) -> Any:
    """Say that there is no memory."""
    raise MemoryError


@planted
def claims_a_full_disk(capture: xr.Dataset) -> Any:
    """Say that the disk is full, which ends a run where it is true."""
    raise OSError(errno.ENOSPC, "No space left on device")


@planted
def claims_a_broken_cache(capture: xr.Dataset) -> Any:
    """Let Numba's cache, whose failures end a run, read an index of its own making."""
    from importlib import import_module

    caching: Any = import_module("numba.core.caching")
    place = os.environ["TMPDIR"]
    Path(place, "mine.nbi").write_bytes(b"no index")
    caching.IndexDataCacheFile(place, "mine", 1).load("any")
    return answer(capture)


@planted
def needs_a_package(capture: xr.Dataset) -> Any:
    """Skip a capture by a package that is missing."""
    import no_such_package_of_a_plug_in  # type: ignore[import-not-found]

    return no_such_package_of_a_plug_in
