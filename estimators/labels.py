"""Labels of estimators: ``name[key=value,...]`` with keys sorted, and parameters checked against the signature."""

from __future__ import annotations

import inspect
import json
import math
import re
import types
import typing
from collections.abc import Callable, Mapping
from functools import lru_cache
from typing import Any, Literal

from ..scenes.errors import InputError

__all__ = ["check_parameters", "format_label", "parse_label"]

_LABEL = re.compile(r"^(?P<name>[A-Za-z0-9][A-Za-z0-9._-]*)(?:\[(?P<params>[^\[\]]*)\])?$")
_KEY = re.compile(r"^[A-Za-z_][A-Za-z0-9_]*$")


def _parse_value(text: str) -> Any:
    try:
        value = json.loads(text)
    except json.JSONDecodeError:
        return text
    return text if isinstance(value, (list, dict)) else value


def parse_label(label: str) -> tuple[str, dict[str, Any]]:
    """Split `name[key=value,...]`; values are JSON scalars or bare words. Raises InputError on bad syntax."""
    match = _LABEL.match(label.strip())
    if match is None:
        raise InputError("not an estimator label", where="label", value=label, allowed="name or name[key=value,...]")
    params: dict[str, Any] = {}
    for item in filter(None, (part.strip() for part in (match["params"] or "").split(","))):
        key, equals, value = (piece.strip() for piece in item.partition("="))
        if not equals or not _KEY.match(key) or not value or key in params:
            raise InputError("bad parameter in label", where=label, value=item, allowed="key=value, each key once")
        params[key] = _parse_value(value)
    return match["name"], params


def format_label(name: str, params: Mapping[str, Any]) -> str:
    """The one spelling of a label: keys sorted, values as JSON except bare words."""
    if not params:
        return name

    def show(value: Any) -> str:
        return value if isinstance(value, str) and _parse_value(value) == value else json.dumps(value)

    return f"{name}[{','.join(f'{key}={show(params[key])}' for key in sorted(params))}]"


def _fits(value: Any, hint: Any) -> bool:
    origin = typing.get_origin(hint)
    if hint is Any:
        return True
    if origin is Literal:
        return any(type(value) is type(choice) and value == choice for choice in typing.get_args(hint))
    if origin in (typing.Union, types.UnionType):
        return any(_fits(value, part) for part in typing.get_args(hint))
    if hint is None or hint is type(None):
        return value is None
    if hint is bool:
        return isinstance(value, bool)
    if hint is int:
        return isinstance(value, int) and not isinstance(value, bool)
    if hint is float:
        return isinstance(value, (int, float)) and not isinstance(value, bool) and math.isfinite(value)
    return isinstance(value, hint) if isinstance(hint, type) else True


def _allowed(hint: Any) -> str:
    if typing.get_origin(hint) is Literal:
        return ", ".join(map(str, typing.get_args(hint)))
    return getattr(hint, "__name__", str(hint))


@lru_cache(maxsize=256)
def _signature(function: Callable[..., Any]) -> tuple[dict[str, inspect.Parameter], dict[str, Any]]:
    """Keyword-only parameters and the hints of `function`: read once, they take as long as a small estimate."""
    parameters = inspect.signature(function).parameters.items()
    known = {key: parameter for key, parameter in parameters if parameter.kind is inspect.Parameter.KEYWORD_ONLY}
    return known, typing.get_type_hints(function)


def check_parameters(function: Callable[..., Any], params: Mapping[str, Any], *, where: str) -> dict[str, Any]:
    """The parameters, checked against `function`'s keyword-only arguments. Raises InputError for unknown, bad ones."""
    known, hints = _signature(function)
    for key, value in params.items():
        if key not in known:
            raise InputError(
                "unknown parameter", where=where, value=key, allowed=", ".join(sorted(known)) or "no parameters"
            )
        hint = hints.get(key, Any)
        if not _fits(value, hint):
            raise InputError(f"bad value of parameter {key}", where=where, value=value, allowed=_allowed(hint))
    missing = [k for k, p in known.items() if p.default is inspect.Parameter.empty and k not in params]
    if missing:
        raise InputError("missing parameter", where=where, value=missing, next_step=f"{where}[{missing[0]}=...]")
    return dict(params)
