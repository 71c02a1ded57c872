"""Overrides: `PATH=VALUE` on the command line and `overrides={path: value}` in Python give the same bits.

A path is keys and list indices joined by dots, e.g. `rig.laser.pulse.fwhm_s` or `target.0.material.albedo`; an object of a
list may also be named: `target.wall.material.albedo`. Overrides are applied to plain data, before validation.
"""

from __future__ import annotations

import copy
import json
import math
import re
from collections.abc import Iterable, Mapping
from functools import partial
from typing import Any

from .errors import InputError
from .json_keys import once
from .nearest import did_you_mean

__all__ = ["apply_overrides", "parse_assignments"]

#: No physical value has more; Python itself stops at 4300.
_MOST_DIGITS = 400


def parse_assignments(assignments: Iterable[str]) -> dict[str, Any]:
    """Turn `["a.b=1", "c=[1,2]"]` into `{"a.b": 1, "c": [1, 2]}`. A value that is not JSON is taken as a string.

    Raises:
        InputError: no "=", an empty path, or the same path twice.
    """
    if isinstance(assignments, str):
        raise InputError(
            "Assignments should be a list.", where="--set", value=assignments, allowed="a list of PATH=VALUE",
            next_step=f"[{assignments!r}]",
        )  # fmt: skip
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
            raise InputError(
                "The same path is overridden twice.", where="--set", value=path, allowed="each path once",
                next_step=f"leave out one of the two --set {path}=...",
            )  # fmt: skip
        try:
            result[path] = json.loads(
                value, parse_constant=partial(_refuse_constant, path), parse_float=partial(_finite, path),
                parse_int=partial(_whole, path), object_pairs_hook=partial(_once, path),
            )  # fmt: skip
        except (json.JSONDecodeError, RecursionError):
            result[path] = value
    return result


def _refuse_constant(path: str, text: str) -> float:
    raise InputError(
        "A number should be finite.",
        where=f"--set {path}",
        value=text,
        allowed="a finite number within ±1.8e308; text is put in quotes",
        next_step=f"--set {path}=1.0, or --set '{path}=\"{text}\"' for text",
    )


def _finite(path: str, text: str) -> float:
    value = float(text)
    return value if math.isfinite(value) else _refuse_constant(path, text)


def _whole(path: str, text: str) -> int:
    if len(text) > _MOST_DIGITS:
        raise InputError(
            "A whole number has too many digits.", where=f"--set {path}", value=f"{text[:20]}… ({len(text)} digits)",
            allowed=f"at most {_MOST_DIGITS} digits",
        )  # fmt: skip
    return int(text)


def _once(path: str, pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    try:
        return once(pairs)
    except ValueError as error:
        raise InputError(
            "A table gives one key twice.", where=f"--set {path}", value=str(error), allowed="each key once"
        ) from error


def apply_overrides(data: Mapping[str, Any], overrides: Mapping[str, Any]) -> dict[str, Any]:
    """Return a deep copy of `data` with each path set. New keys are allowed only in the last place of a path.

    Raises:
        InputError: a path that leads nowhere, with near matches.
    """
    if not isinstance(overrides, Mapping):
        raise InputError(
            "Overrides should be a table of paths.", where="overrides", value=overrides, allowed="{path: value}",
            next_step='for example: {"rig.camera.rows": 128}',
        )  # fmt: skip
    result: dict[str, Any] = copy.deepcopy(dict(data))
    for path, value in overrides.items():
        if not isinstance(path, str):
            raise InputError(
                "The path of an override should be text.", where="overrides", value=path, allowed="keys joined by dots",
                next_step='for example: {"rig.camera.rows": 128}',
            )  # fmt: skip
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
            raise _through(path, node)
    return result


def _through(path: str, node: Any) -> InputError:
    return InputError(
        "An override's path goes through a plain value.",
        where=path,
        value=node,
        allowed="a path that ends where the value is",
        next_step="beambench scenes show SCENE   (all paths)",
    )


def _step(node: Any, key: str, path: str) -> Any:
    if isinstance(node, list):
        return node[_index(node, key, path)]
    if isinstance(node, dict):
        if key not in node:
            raise InputError(
                "An override's path leads nowhere.",
                where=path,
                value=key,
                allowed=", ".join(sorted(map(str, node))),
                next_step=did_you_mean(key, list(node)),
            )
        return node[key]
    raise _through(path, node)


def _index(node: list[Any], key: str, path: str) -> int:
    if re.fullmatch(r"-?[0-9]{1,9}", key) and -len(node) <= int(key) < len(node):
        return int(key)
    for position, item in enumerate(node):
        if isinstance(item, dict) and item.get("name") == key:
            return position
    names = [str(item["name"]) for item in node if isinstance(item, dict) and "name" in item]
    raise InputError(
        "An override names an element that the list does not have.",
        where=path,
        value=key,
        allowed=", ".join([*([f"0..{len(node) - 1}"] if node else []), *names]) or "nothing: the list is empty",
        next_step="beambench scenes show SCENE   (all paths)",
    )
