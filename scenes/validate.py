"""Plain data to specs: pydantic's errors become one `InputError` that names every path."""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Mapping
from typing import Any, TypeVar, get_args

from pydantic import BaseModel, ValidationError

from .base import Spec
from .errors import InputError, other_version
from .plain_messages import lost_table, near_keys, wanted

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
        raise _told(model, error.errors(include_url=False), data, where, example) from error


def _told(
    model: type[BaseModel], errors: list[Any], data: Mapping[str, Any], where: str, example: Callable[[], str] | None
) -> InputError:
    """All errors as one, so that a file is mended in one go; the keys of a table without its header as one of them."""
    next_step = example() if example else model.example if issubclass(model, Spec) else ""
    schema = model.model_json_schema() if any(error["type"] == "extra_forbidden" for error in errors) else {}
    lost = lost_table(schema, errors) if schema else None
    if lost is not None:
        missing, keys = lost
        table = _key_path(missing, data)
        return InputError(
            "A table is missing; its keys stand elsewhere.", where=f"{where}: {table}",
            allowed=f"[{table}] above {', '.join(keys)}", next_step=next_step,
        )  # fmt: skip
    for error in errors:
        if error["loc"] == ("schema_version",) and error["type"] == "literal_error":
            return other_version(
                "The file follows another version of its format.", where=f"{where}: schema_version",
                found=error["input"], known=max(get_args(model.model_fields["schema_version"].annotation)),
                older=f"write it anew in the present form: {next_step}",
            )  # fmt: skip
    first, *rest = errors
    what = {"missing": "A value is missing, and has no default.", "extra_forbidden": "Unknown key."}
    known = _known_keys(schema) if schema else set()
    more = "".join(f"\n           also {_key_path(e, data)}: {wanted(e)}{_near(e, known)}" for e in rest[:8])
    return InputError(
        what.get(first["type"], "A value is not allowed."),
        where=f"{where}: {_key_path(first, data)}",
        # A rule of a whole table says by itself what is wrong in it; all of the table again would hide that.
        value=None if first["type"] == "missing" or not first["loc"] else first.get("input"),
        allowed=wanted(first) + _near(first, known) + more,
        next_step=next_step,
    )


def _near(error: Any, known: set[str]) -> str:
    return near_keys(known, str(error["loc"][-1])) if error["type"] == "extra_forbidden" else ""


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


def _known_keys(schema: Mapping[str, Any]) -> set[str]:
    """Every key that a spec may have somewhere."""
    known: set[str] = set()
    todo: list[Any] = [schema]
    while todo:
        node = todo.pop()
        if isinstance(node, Mapping):
            known.update(node.get("properties", {}))
            todo.extend(node.values())
        elif isinstance(node, list):
            todo.extend(node)
    return known
