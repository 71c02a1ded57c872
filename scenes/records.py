"""Records of modalities, looked up in the tables of the floors."""

from __future__ import annotations

from collections.abc import Mapping
from importlib import import_module
from typing import Any

from .errors import InputError

__all__ = ["object_at", "record_of"]


def object_at(place: str) -> Any:
    """The object that stands at "module:object", imported."""
    module, _, attribute = place.partition(":")
    return getattr(import_module(module), attribute)


def record_of(table: Mapping[str, str], name: object, missing: str, where: str) -> Any:
    """The object that a table lists under `name` as "module:object", imported.

    Main arguments:
        table: name -> "module:object". missing: sentence of the error where the table does not list the name.
        where: place of the name, for the error.

    Raises:
        InputError: a name that the table does not list.
    """
    if not isinstance(name, str) or name not in table:
        raise InputError(missing, where=where, value=name, allowed=", ".join(table))
    return object_at(table[name])
