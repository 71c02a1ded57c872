"""What a verb's docstring says for the command line: its text, and one line of help per argument."""

from __future__ import annotations

import inspect
import re
from collections.abc import Mapping

__all__ = ["arguments_of", "for_command_line", "text_of"]

_ARGUMENTS = ("Main arguments:", "Other arguments:")
_SECTION = re.compile(r"^(Main arguments|Other arguments|Returns|Raises|Writes|Warns)\b.*$", re.MULTILINE)
_ENTRY = re.compile(r"^    (\w+(?:, \w+)*): (.*)$")


def text_of(doc: str) -> str:
    """The paragraphs of a docstring before its first section ("Main arguments", "Returns", …), each as one line."""
    text = _SECTION.split(inspect.cleandoc(doc), maxsplit=1)[0].strip()
    return "\n\n".join(" ".join(paragraph.split()) for paragraph in text.split("\n\n"))


def arguments_of(doc: str) -> dict[str, str]:
    """Help of each argument, by its name, from the sections "Main arguments" and "Other arguments".

    An entry begins with a line `    name: text`, or `    name, other: text` for several; deeper lines continue it.
    """
    found: dict[str, list[str]] = {}
    entry: list[str] | None = None
    inside = False
    for line in inspect.cleandoc(doc).splitlines():
        if not line.startswith(" "):
            inside, entry = line in _ARGUMENTS, None
        elif inside and (begun := _ENTRY.match(line)):
            entry = [begun[2]]
            found |= dict.fromkeys(begun[1].split(", "), entry)
        elif entry is not None:
            entry.append(line.strip())
    return {name: " ".join(lines) for name, lines in found.items()}


def for_command_line(text: str, options: Mapping[str, str]) -> str:
    """A text in which the parameters that are options stand as such: `` `rtol` `` as --rtol.

    Main arguments:
        options: {parameter: option}.
    """
    for name, option in options.items():
        text = text.replace(f"`{name}`", option)
    return text
