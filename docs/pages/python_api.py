"""Reference of Python: every public name of the package and of its rooms, with signature and docstring."""

from __future__ import annotations

import importlib
import inspect
from collections.abc import Iterator
from typing import Any

from .text import escaped, markdown

__all__ = ["ROOMS", "page", "public_names"]

#: Rooms whose `__all__` is public, in the order of the page, and what they are for.
ROOMS = {
    "beambench": "One function for each command.",
    "beambench.captures": "The one format: make, write, open, verify, repair and compare captures.",
    "beambench.captures.readers": "Reading data sets for training.",
    "beambench.captures.estimates": "Estimates in files.",
    "beambench.estimators": "Estimators: the decorator, the registry, and what an estimator needs to read and to answer.",
    "beambench.scenes.load": "Scenes: find, read, change, validate.",
    "beambench.scenes.datasets.load": "Data sets: read and validate.",
    "beambench.generator.generate": "From a scene to a capture.",
    "beambench.benchmarks.suites.suite": "Suites: read, and what they hold.",
    "beambench.benchmarks.run": "Run a suite.",
}


def public_names(room: str) -> Iterator[tuple[str, Any]]:
    """(name, object) of the public names of a room."""
    module = importlib.import_module(room)
    for name in getattr(module, "__all__", ()):
        yield name, getattr(module, name)


def page() -> str:
    """The page of Python."""
    parts = [
        "# Python",
        "Names are imported when they are first used. Arrays are NumPy's, captures and estimates are `xarray.Dataset`.",
    ]
    for room, text in ROOMS.items():
        parts.append(f"## {room}\n\n{text}")
        parts += [_entry(room, name, value) for name, value in public_names(room)]
    return "\n\n".join(part for part in parts if part) + "\n"


def _entry(room: str, name: str, value: Any) -> str:
    parts = [f"### {escaped(name)}"]
    if inspect.isclass(value) or inspect.isroutine(value):
        parts.append("```python\n" + _signature(name, value) + "\n```")
        parts.append(markdown(value.__doc__))
        if inspect.isclass(value):
            parts += [_member(name, key, member) for key, member in vars(value).items() if not key.startswith("_")]
    else:
        shown = repr(value)
        parts.append(f"```python\n{name} = {shown if len(shown) < 200 else type(value).__name__}\n```")
    return "\n\n".join(part for part in parts if part)


def _member(owner: str, name: str, member: Any) -> str:
    if isinstance(member, property):
        return f"**{escaped(owner)}.{escaped(name)}** (property). {markdown(member.__doc__)}"
    function = member.__func__ if isinstance(member, classmethod | staticmethod) else member
    if not inspect.isfunction(function) or not function.__doc__:
        return ""
    return "```python\n" + _signature(f"{owner}.{name}", function) + "\n```\n\n" + markdown(function.__doc__)


def _signature(name: str, value: Any) -> str:
    """The signature, broken into lines where it is long."""
    try:
        found = inspect.signature(value)
    except (TypeError, ValueError):
        return name
    shown, starred = [], False
    for one in found.parameters.values():
        if one.kind is one.VAR_POSITIONAL:
            starred = True
        elif one.kind is one.KEYWORD_ONLY and not starred:
            shown, starred = [*shown, "*"], True
        shown.append(_parameter(one))
    answer = "" if found.return_annotation is found.empty else f" -> {_kind(found.return_annotation)}"
    text = f"{name}({', '.join(shown)}){answer}"
    return text if len(text) <= 110 else "\n".join([f"{name}(", *(f"    {one}," for one in shown), f"){answer}"])


def _parameter(one: inspect.Parameter) -> str:
    stars = {one.VAR_POSITIONAL: "*", one.VAR_KEYWORD: "**"}.get(one.kind, "")
    kind = "" if one.annotation is one.empty else f": {_kind(one.annotation)}"
    default = "" if one.default is one.empty else f" = {one.default!r}"
    return f"{stars}{one.name}{kind}{default}"


def _kind(annotation: Any) -> str:
    return annotation if isinstance(annotation, str) else inspect.formatannotation(annotation)
