"""Records of all estimators for people to choose from.

Plug-ins are not imported here: the caller gives a function that imports one in a process of its own.
"""

from __future__ import annotations

import inspect
from collections.abc import Callable
from typing import TYPE_CHECKING, Any

from ..captures.layouts import stage_of
from ..scenes.errors import InputError
from .builtin import BUILTIN
from .labels import links_of
from .registry import Estimator, get_estimator, list_estimators

if TYPE_CHECKING:
    import xarray as xr

__all__ = ["described", "failed", "listed", "modalities_read", "modality_read", "row"]


def listed(plugin_row: Callable[[str], dict[str, Any]]) -> list[dict[str, Any]]:
    """One record per estimator: name, modality, stage, needs, parameters with defaults, source, origin, summary, error.

    Main arguments:
        plugin_row: gives the record of a plug-in by its name.

    An estimator that cannot be imported has the reason in `error`.
    """
    return [row(name) if name in BUILTIN else plugin_row(name) for name in list_estimators()]


def modalities_read() -> set[str]:
    """The modalities that built-in estimators read, which imports them."""
    return {get_estimator(name).modality for name in BUILTIN}


def modality_read(name: str, plugin_row: Callable[[str], dict[str, Any]]) -> str:
    """The modality of the captures that an estimator, or the first link of a chain, reads; `plugin_row` as in
    `listed`. Raises InputError where that fails."""
    first = links_of(name)[0]
    if first in BUILTIN:
        return get_estimator(first).modality
    record = plugin_row(first)
    if record["error"]:
        raise InputError(
            f"The plug-in cannot be imported: {record['error']}.", where=first, next_step="beambench estimators list"
        )
    return str(record["modality"])


def described(name: str, plugin_row: Callable[[str], dict[str, Any]]) -> Estimator:
    """An estimator with its stage and needs; a plug-in, which is not imported here, has no function. `plugin_row` as in `listed`.
    Raises InputError for one that cannot be imported."""
    if name in BUILTIN:
        return get_estimator(name)
    record = plugin_row(name)
    if record["error"]:
        raise InputError(
            f"The plug-in cannot be imported: {record['error']}.", where=name, next_step="beambench estimators list"
        )
    needs = tuple((str(path), str(value)) for path, value in record["needs"].items())
    return Estimator(name, stage_of(record["stage"]), str(record["cites"]), _not_here, needs)


def _not_here(capture: xr.Dataset) -> xr.Dataset:
    raise InputError("A plug-in is not called in this process.", where="described", allowed="a child process")


def row(name: str, origin: str = "built-in") -> dict[str, Any]:
    """The record of an estimator, which is imported here; see `listed` for its entries."""
    try:
        found = get_estimator(name)
    except InputError as error:
        return failed(name, origin, error.what)
    parameters = {
        key: None if parameter.default is inspect.Parameter.empty else parameter.default
        for key, parameter in inspect.signature(found.function).parameters.items()
        if parameter.kind is inspect.Parameter.KEYWORD_ONLY
    }
    return {
        "name": name,
        "modality": found.modality,
        "stage": found.stage.word,
        "needs": dict(found.needs),
        "parameters": parameters,
        "cites": found.cites,
        "origin": origin,
        "summary": (inspect.getdoc(found.function) or "").partition("\n")[0],
        "error": "",
    }


def failed(name: str, origin: str, why: str) -> dict[str, Any]:
    """The record of an estimator that cannot be imported."""
    return {
        "name": name, "modality": "", "stage": "", "needs": {}, "parameters": {}, "cites": "", "origin": origin,
        "summary": "", "error": why,
    }  # fmt: skip
