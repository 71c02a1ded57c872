"""The options of a command, read from the signature and the docstring of its verb."""

from __future__ import annotations

import builtins
import inspect
import types
from collections.abc import Callable, Collection, Iterator, Sequence
from typing import Annotated, Any, Literal, Union, get_args, get_origin, get_type_hints

from cyclopts import Parameter

from ..console import Common, share, whole
from .docstring import arguments_of, for_command_line

__all__ = ["options_of", "signature_for"]

#: Parameters of verbs that the command line fills in itself.
_NOT_TYPED = ("progress", "command")
#: Names on the command line where they are not simply --name.
_NAMES = {"out": ("--out", "-o"), "estimators": ("--estimators", "-e"), "overrides": ("--set",)}
#: Help where the command line takes something else than Python.
_HELP = {
    "overrides": "Change a value of the spec before it is validated: PATH=VALUE. VALUE is JSON; "
    "anything that is not valid JSON is text.",
}


def options_of(verb: Callable[..., Any], options: Collection[str] = ()) -> dict[str, str]:
    """{parameter: long option} of the parameters of a verb that are options on the command line.

    Main arguments:
        options: Names of positional parameters that are options, too.
    """
    given = inspect.signature(verb).parameters.values()
    named = [one.name for one in given if one.kind is one.KEYWORD_ONLY or one.name in options]
    return {name: _NAMES.get(name, ("--" + name.replace("_", "-"),))[0] for name in named if name not in _NOT_TYPED}


def signature_for(verb: Callable[..., Any], options: Collection[str] = ()) -> inspect.Signature:
    """The signature of a verb's command, with types, names and help as cyclopts reads them.

    What the verb takes by position is typed by position, the rest as options. Types that cannot be typed (a mapping, an
    object) are left out, whole numbers are never rounded, and `overrides` becomes --set PATH=VALUE.

    Main arguments:
        verb: The function.
        options: Names of positional parameters that are options, too.

    Raises:
        KeyError: The docstring does not describe a parameter.
    """
    given = [one for one in inspect.signature(verb).parameters.values() if one.name not in _NOT_TYPED]
    named = options_of(verb, options)
    help_of = arguments_of(verb.__doc__ or "") | _HELP
    hints = _hints({one.name: one.annotation for one in given}, verb)
    typed = []
    for one in given:
        hint = list[str] if one.name == "overrides" else _hint(hints[one.name])
        default = None if one.default == () else one.default
        settings: dict[str, Any] = {"help": for_command_line(help_of[one.name], named)}
        if one.name in named and one.name in _NAMES:
            settings["name"] = _NAMES[one.name]
        if hint in (int, list[int]):
            settings["converter"] = whole
        if one.name == "rtol":
            settings["converter"] = share
        if get_origin(hint) is list:
            settings |= {"negative": "", "help": settings["help"] + " Repeatable."}
        if hint is bool:
            settings |= {"show_default": False} | ({} if default else {"negative": ""})
        typed.append(
            one.replace(
                kind=one.KEYWORD_ONLY if one.name in named else one.POSITIONAL_ONLY,
                default=default,
                annotation=Annotated[hint | None if default is None else hint, Parameter(**settings)],
            )
        )
    common = inspect.Parameter("common", inspect.Parameter.KEYWORD_ONLY, default=None, annotation=Common | None)
    return inspect.Signature([*typed, common], return_annotation=int)


class _Elsewhere:
    """Stands for every type that is imported for type checkers only; nobody types one."""

    def __class_getitem__(cls, item: Any) -> type[_Elsewhere]:
        return cls


class _Names(dict[str, Any]):
    def __missing__(self, name: str) -> type[_Elsewhere]:
        return _Elsewhere


def _hints(annotations: dict[str, str], verb: Callable[..., Any]) -> dict[str, Any]:
    """The annotations of a verb as types; `_Elsewhere` for what its module does not import when it runs."""
    names = _Names(vars(builtins) | verb.__globals__)
    return get_type_hints(types.SimpleNamespace(__annotations__=annotations), {}, names)


def _hint(annotation: Any) -> Any:
    """The part of an annotation that can be typed: numbers, text, flags and choices, or a list of such."""
    parts = list(_alternatives(annotation))
    lists = [get_args(part)[0] for part in parts if get_origin(part) is Sequence]
    if lists:
        return list[_hint(lists[0])]  # type: ignore[misc]
    typed = [part for part in parts if part in (str, int, float, bool) or get_origin(part) is Literal]
    return Union[tuple(typed)]  # noqa: UP007 - built from a list


def _alternatives(annotation: Any) -> Iterator[Any]:
    if get_origin(annotation) in (Union, types.UnionType):
        for part in get_args(annotation):
            yield from _alternatives(part)
    else:
        yield annotation
