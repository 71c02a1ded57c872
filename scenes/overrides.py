"""The one override mechanism: `PATH=VALUE` (command line) and `overrides={path: value}` (Python), same bits.

A path is keys and list indices joined by dots, e.g. `rig.laser.pulse.fwhm_s` or `target.0.material.albedo`; an object of a
list may also be named: `target.wall.material.albedo`. Overrides are applied to plain data, before validation.
"""

from __future__ import annotations

import copy
import difflib
import json
from collections.abc import Iterable, Mapping
from typing import Any

from .errors import InputError

__all__ = ["apply_overrides", "parse_assignments"]


def parse_assignments(assignments: Iterable[str]) -> dict[str, Any]:
    """Turn `["a.b=1", "c=[1,2]"]` into `{"a.b": 1, "c": [1, 2]}`. A value that is not JSON is taken as a string.

    Raises:
        InputError: no "=", an empty path, or the same path twice.
    """
    result: dict[str, Any] = {}
    for text in assignments:
        path, equals, value = text.partition("=")
        path = path.strip()
        if not equals or not path:
            raise InputError(
                "An override needs a path and a value.",
                where="--set",
                value=text,
                allowed="PATH=VALUE, the value as JSON",
                next_step="for example: --set rig.camera.rows=128",
            )
        if path in result:
            raise InputError("The same path is overridden twice.", where="--set", value=path)
        try:
            result[path] = json.loads(value, parse_constant=_refuse_constant)
        except json.JSONDecodeError:
            result[path] = value
    return result


def _refuse_constant(name: str) -> float:
    raise InputError("Numbers must be finite.", where="--set", value=name)


def apply_overrides(data: Mapping[str, Any], overrides: Mapping[str, Any]) -> dict[str, Any]:
    """Return a deep copy of `data` with each path set. New keys are allowed only in the last place of a path.

    Raises:
        InputError: a path that leads nowhere, with near matches.
    """
    result: dict[str, Any] = copy.deepcopy(dict(data))
    for path, value in overrides.items():
        keys = path.split(".")
        node: Any = result
        for depth, key in enumerate(keys[:-1]):
            node = _step(node, key, ".".join(keys[: depth + 1]))
        last = keys[-1]
        if isinstance(node, list):
            node[_index(node, last, path)] = copy.deepcopy(value)
        elif isinstance(node, dict):
            node[last] = copy.deepcopy(value)
        else:
            raise InputError("An override's path goes through a plain value.", where=path, value=node)
    return result


def _step(node: Any, key: str, path: str) -> Any:
    if isinstance(node, list):
        return node[_index(node, key, path)]
    if isinstance(node, dict):
        if key not in node:
            near = difflib.get_close_matches(key, list(node), n=3)
            raise InputError(
                "An override's path leads nowhere.",
                where=path,
                value=key,
                allowed=", ".join(sorted(map(str, node))),
                next_step=f"did you mean {' or '.join(near)}?" if near else "",
            )
        return node[key]
    raise InputError("An override's path goes through a plain value.", where=path, value=node)


def _index(node: list[Any], key: str, path: str) -> int:
    if key.lstrip("-").isdigit() and -len(node) <= int(key) < len(node):
        return int(key)
    for position, item in enumerate(node):
        if isinstance(item, dict) and item.get("name") == key:
            return position
    names = [str(item["name"]) for item in node if isinstance(item, dict) and "name" in item]
    raise InputError(
        "An override names no element of the list.",
        where=path,
        value=key,
        allowed=", ".join([f"0..{len(node) - 1}", *names]),
    )
