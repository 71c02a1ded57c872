"""Plain data to specs: pydantic's errors become one `InputError` that names every path."""

from __future__ import annotations

import difflib
import json
import math
from collections.abc import Callable, Mapping
from typing import Any, TypeVar

from pydantic import BaseModel, ValidationError

from .base import Spec
from .errors import InputError

__all__ = ["validate_spec"]

SpecT = TypeVar("SpecT", bound=BaseModel)

_DEEPEST = 100
_LARGEST = 10**400


def validate_spec(
    model: type[SpecT], data: Mapping[str, Any], where: str, *, example: Callable[[], str] | None = None
) -> SpecT:
    """Validate plain data against a spec, and raise one `InputError` that names the path of every error.

    Validation is strict: "5" is not a number and true is not 1. `example`: gives the next step of an error; by default the spec's.
    """
    _check_plain(data, where)
    text = json.dumps(data, allow_nan=False)
    try:
        return model.model_validate_json(text, strict=True)
    except ValidationError as error:
        first, *rest = error.errors(include_url=False)
        path = _key_path(first, data)
        what = {"missing": "A value is missing, and has no default.", "extra_forbidden": "Unknown key."}
        more = "".join(
            f"\n           also {_key_path(e, data)}: {_message(e)}" for e in rest[:8]
        )  # all in one message, so that a file is mended in one go
        raise InputError(
            what.get(first["type"], "A value is not allowed."),
            where=f"{where}: {path}",
            value=None if first["type"] == "missing" else first.get("input"),
            allowed=_message(first) + more + _near_keys(model, first),
            next_step=example() if example else model.example if issubclass(model, Spec) else "",
        ) from error


def _check_plain(data: Any, where: str) -> None:
    """Refuse what no spec holds, by its key: dates, infinite numbers, numbers of too many digits, objects."""
    todo: list[tuple[str, Any, int]] = [("", data, 0)]
    while todo:
        path, node, depth = todo.pop()
        what, allowed = "", "a finite number, text, true or false, a list or a table"
        if depth > _DEEPEST:
            what, allowed, node = (
                "A spec is nested too deeply.",
                f"at most {_DEEPEST} levels",
                f"over {_DEEPEST} levels",
            )
        elif isinstance(node, Mapping):
            if all(isinstance(key, str) for key in node):
                todo += [(f"{path}.{key}".lstrip("."), value, depth + 1) for key, value in node.items()]
            else:
                what = "The keys of a spec should be text."
        elif isinstance(node, list | tuple):
            todo += [(f"{path}.{index}".lstrip("."), value, depth + 1) for index, value in enumerate(node)]
        elif isinstance(node, float) and not math.isfinite(node):
            what, allowed = "A number should be finite.", "a finite number within ±1.8e308"
        elif isinstance(node, int) and abs(node) > _LARGEST:
            what, allowed, node = "A whole number has too many digits.", "within ±1e400", "more than 400 digits"
        elif not (node is None or isinstance(node, bool | int | float | str)):
            what = f"A spec cannot hold a value of this kind ({type(node).__name__})."
        if what:
            raise InputError(
                what, where=f"{where}: {path or '(whole)'}", value=node if isinstance(node, float | str) else str(node)[:80],
                allowed=allowed,
            )  # fmt: skip


def _message(error: Any) -> str:
    """Pydantic's message, with its limit in few digits (1e-15 instead of its zeros) and without its own prefix."""
    for key in ("ge", "gt", "le", "lt"):
        limit = error.get("ctx", {}).get(key)
        if isinstance(limit, float):
            return f"{str(error['msg']).rpartition(' ')[0]} {limit:g}"
    return str(error["msg"]).removeprefix("Value error, ")


def _key_path(error: Any, data: Any) -> str:
    """The path of an error as a user would override it: without the tags of unions that pydantic puts in.

    A part that is no key of the data is a tag, unless it is the key that is missing.
    """
    parts: list[str] = []
    node = data
    for place, part in enumerate(error["loc"]):
        missing = error["type"] == "missing" and place == len(error["loc"]) - 1
        if isinstance(part, int) or missing or not isinstance(node, dict | list | tuple) or part in node:
            parts.append(str(part))
            node = _item(node, part)
    return ".".join(parts) or "(whole)"


def _item(node: Any, part: int | str) -> Any:
    if isinstance(node, dict):
        return node.get(part)
    return node[part] if isinstance(node, list | tuple) and isinstance(part, int) and part < len(node) else None


def _near_keys(model: type[BaseModel], error: Any) -> str:
    """For an unknown key: similar keys anywhere in the spec."""
    if error["type"] != "extra_forbidden":
        return ""
    known: set[str] = set()
    todo: list[Any] = [model.model_json_schema()]
    while todo:
        node = todo.pop()
        if isinstance(node, dict):
            known.update(node.get("properties", {}))
            todo.extend(node.values())
        elif isinstance(node, list):
            todo.extend(node)
    key = str(error["loc"][-1])
    if key in known:
        return "; this key exists elsewhere in the spec, not in this place"
    near = difflib.get_close_matches(key, sorted(known), n=3)
    return f"; did you mean {' or '.join(near)}?" if near else ""
