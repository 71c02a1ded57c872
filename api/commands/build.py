"""Commands built from verbs: what a verb's signature and docstring say is not written again.

A command adds what only the command line has: short options, --set, --json, progress, and how the result is printed.
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Collection, Iterator, Mapping
from contextlib import AbstractContextManager, contextmanager
from dataclasses import dataclass
from functools import cached_property
from importlib import import_module
from inspect import Signature
from typing import Any

from cyclopts import App

from ..console import Common, print_json
from .docstring import for_command_line, text_of
from .signature import options_of, signature_for

__all__ = ["Arguments", "View", "bar", "command", "lines"]

#: What was typed and the defaults of the rest, by the names of the verb's parameters; None is left out.
Arguments = Mapping[str, Any]


def _done(result: Any) -> int:
    return 0


@dataclass(frozen=True)
class View:
    """How a command shows what its verb returned.

    Main arguments:
        text: Prints (result, arguments) for people.
        json: Gives the document that --json prints.
    Other arguments:
        code: Gives the exit code of a result.
    """

    text: Callable[[Any, Arguments], None]
    json: Callable[[Any, Arguments], Any]
    code: Callable[[Any], int] = _done


def bar(quiet: bool) -> AbstractContextManager[Any]:
    """Progress as one line that is written over and over, where standard error is a terminal."""
    from ..benchmarks.folders.progress import terminal_progress

    return terminal_progress()


@contextmanager
def lines(quiet: bool) -> Iterator[Any]:
    """Progress as lines on standard error; none with --json."""
    yield None if quiet else lambda line: print(line, file=sys.stderr, flush=True)


def command(
    words: str,
    verb: str,
    view: View,
    *,
    examples: str,
    options: Collection[str] = (),
    progress: Callable[[bool], AbstractContextManager[Any]] = bar,
) -> App:
    """The command of a verb.

    Main arguments:
        words: What is typed behind `beambench`, e.g. "data status".
        verb: The function, as "module:name" in `beambench.verbs`.
        view: How the result is shown.
        examples: What stands below the help.
    Other arguments:
        options: Names of positional parameters of the verb that are options on the command line.
        progress: How progress is shown, if the verb reports any.
    """
    typed = _Typed(verb, view, options, progress)
    return App(name=words.rpartition(" ")[2], default_command=typed, help_epilogue=examples)


class _Typed:
    """The function that runs when a command is typed; its signature is read when it is needed, not for a list of commands."""

    def __init__(
        self,
        verb: str,
        view: View,
        options: Collection[str],
        progress: Callable[[bool], AbstractContextManager[Any]],
    ) -> None:
        module, _, self.__name__ = verb.partition(":")
        self._home = import_module(f"..verbs.{module}", __package__)
        self._view, self._options, self._progress = view, options, progress
        self._verb: Callable[..., Any] = getattr(self._home, self.__name__)
        self.__doc__ = for_command_line(text_of(self._verb.__doc__ or ""), options_of(self._verb, options))

    @cached_property
    def __signature__(self) -> Signature:
        return signature_for(self._verb, self._options)

    @property
    def __annotations__(self) -> dict[str, Any]:  # type: ignore[override]
        return {one.name: one.annotation for one in self.__signature__.parameters.values()}

    def __call__(self, *args: Any, **kwargs: Any) -> int:
        bound = self.__signature__.bind(*args, **kwargs)
        bound.apply_defaults()
        common = bound.arguments.pop("common") or Common()
        arguments = {key: value for key, value in bound.arguments.items() if value is not None}
        result = self._run(dict(arguments), common.json)
        if common.json:
            print_json(self._view.json(result, arguments))
        else:
            self._view.text(result, arguments)
        return self._view.code(result)

    def _run(self, arguments: dict[str, Any], quiet: bool) -> Any:
        verb = getattr(self._home, self.__name__)
        if "overrides" in arguments:
            from ..scenes.overrides import parse_assignments

            arguments["overrides"] = parse_assignments(arguments["overrides"])
        if "command" in self._verb.__annotations__:
            arguments["command"] = ["beambench", *sys.argv[1:]]
        if "progress" not in self._verb.__annotations__:
            return verb(**arguments)
        with self._progress(quiet) as tell:
            return verb(**arguments, progress=tell)
