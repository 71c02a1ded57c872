"""Reference of the command line: every command with its own help, as it prints it."""

from __future__ import annotations

import io
from collections.abc import Iterator

from cyclopts import App
from rich.console import Console

__all__ = ["commands", "page"]


def commands(app: App, words: tuple[str, ...] = ()) -> Iterator[tuple[str, App]]:
    """(words, command) of every command that can be typed, in their order."""
    if words and app.default_command is not None:
        yield " ".join(words), app
    for name in app:
        if not name.startswith("-"):
            yield from commands(app[name], (*words, name))


def help_of(app: App, words: str) -> str:
    """What `beambench WORDS --help` prints, 110 columns wide."""
    text = io.StringIO()
    app.help_print(words.split(), console=Console(file=text, width=110, color_system=None, force_terminal=False))
    return "\n".join(line.rstrip() for line in text.getvalue().splitlines()).strip()


def page() -> str:
    """The page of commands."""
    from beambench.cli import app

    parts = [
        "# Commands",
        "Every command is also a function of the package `beambench` with the same name and arguments ([Python](python.md)). "
        "Exit codes: 0 done, 1 a check or every estimator failed, 2 bad usage or input, 3 could not measure, 70 internal error, "
        "130 interrupted.",
        "```text\n" + help_of(app, "") + "\n```",
    ]
    parts += [f"## beambench {words}\n\n```text\n{help_of(app, words)}\n```" for words, _ in commands(app)]
    return "\n\n".join(parts) + "\n"
