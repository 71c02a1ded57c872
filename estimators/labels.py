"""Labels of estimators: ``name[key=value,...]`` with keys sorted, and parameters checked against the signature.

A chain of stages is labelled by the names of its links, ``first+second[key=value,...]``.

A score table holds a label in two columns, the name and the text of the parameters; `label_of` and `split_label` go from
one form to the other. No other code puts a label together or takes one apart.
"""

from __future__ import annotations

import inspect
import json
import math
import re
import types
import typing
from collections.abc import Callable, Iterable, Mapping
from functools import lru_cache
from typing import Any, Literal

from ..scenes.errors import InputError

__all__ = [
    "LINK",
    "check_parameters",
    "each_label",
    "format_label",
    "label_of",
    "links_of",
    "parse_label",
    "split_label",
]

#: What joins the links of a chain.
LINK = "+"
_LABEL = re.compile(r"^[A-Za-z0-9][A-Za-z0-9._-]*(?:\+[A-Za-z0-9][A-Za-z0-9._-]*)*(?:\[[^\[\]]*\])?$")
_KEY = re.compile(r"^[A-Za-z_][A-Za-z0-9_]*$")


def _parse_value(text: str) -> Any:
    try:
        value = json.loads(text)
    except (ValueError, RecursionError):  # no JSON, or a number of more digits than Python reads
        return text
    return text if isinstance(value, (list, dict)) else value


def split_label(label: str) -> tuple[str, str]:
    """(name, text of the parameters, "" where there are none) of a label, whatever its parameters are."""
    name, _, rest = label.strip().partition("[")
    return name, rest.removesuffix("]")


def each_label(texts: Iterable[str]) -> list[str]:
    """The labels of texts that hold one or several, between commas that stand outside brackets: "peak,threshold[level=0.5]"."""
    return [part.strip() for text in texts for part in re.split(r",(?![^\[]*\])", text)]


def label_of(name: str, params: str) -> str:
    """The label of a name and the text of its parameters ("key=value,..." or ""); a name that is a label already stays."""
    return f"{name}[{params}]" if params and "[" not in name else name


def links_of(name: str) -> list[str]:
    """The names of a chain's links; the name itself where it is no chain."""
    return name.split(LINK)


def parse_label(label: str) -> tuple[str, dict[str, Any]]:
    """(name, parameters) of a label; values are JSON scalars or bare words. Raises InputError on bad syntax."""
    if _LABEL.match(label.strip()) is None:
        raise InputError(
            "The label of an estimator is malformed.", where="label", value=label, allowed="name or name[key=value,...]"
        )
    name, text = split_label(label)
    params: dict[str, Any] = {}
    for item in filter(None, (part.strip() for part in text.split(","))):
        key, equals, value = (piece.strip() for piece in item.partition("="))
        if not equals or not _KEY.match(key) or not value or key in params:
            raise InputError(
                "A parameter in a label is malformed.", where=label, value=item, allowed="key=value, each key once"
            )
        params[key] = _parse_value(value)
    return name, params


def format_label(name: str, params: Mapping[str, Any]) -> str:
    """The one spelling of a label: keys sorted, values as JSON except bare words."""

    def show(value: Any) -> str:
        return value if isinstance(value, str) and _parse_value(value) == value else json.dumps(value)

    return label_of(name, ",".join(f"{key}={show(params[key])}" for key in sorted(params)))


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
    """Keyword-only parameters and type hints of `function`; kept, since reading them takes as long as a small estimate."""
    parameters = inspect.signature(function).parameters.items()
    known = {key: parameter for key, parameter in parameters if parameter.kind is inspect.Parameter.KEYWORD_ONLY}
    return known, typing.get_type_hints(function)


def check_parameters(
    function: Callable[..., Any], params: Mapping[str, Any], *, where: str, what: str = "Estimator"
) -> dict[str, Any]:
    """The parameters, checked against the keyword-only arguments of `function`.

    Raises InputError where one is unknown, missing or of another type. where, what: name of the estimator, and what it is, for the
    message.
    """
    known, hints = _signature(function)
    for key, value in params.items():
        if key not in known:
            raise InputError(
                f"{what} {where} was given an unknown parameter.", where=where, value=key,
                allowed=", ".join(sorted(known)) or "no parameters",
            )  # fmt: skip
        hint = hints.get(key, Any)
        if not _fits(value, hint):
            raise InputError(
                f"The value of parameter {key} is not allowed.", where=where, value=value, allowed=_allowed(hint)
            )
    missing = [k for k, p in known.items() if p.default is inspect.Parameter.empty and k not in params]
    if missing:
        raise InputError(
            f"{what} {where} needs a parameter that is not given.", where=where, value=missing,
            next_step=label_of(where, f"{missing[0]}=..."),
        )  # fmt: skip
    return dict(params)
