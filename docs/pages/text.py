"""Docstrings as Markdown: the house's sections become headings and lists, and signs that Markdown would read are escaped."""

from __future__ import annotations

import inspect
import re

__all__ = ["cell", "escaped", "markdown", "table"]

_SECTION = re.compile(
    r"^(Main arguments|Other arguments|Arguments|Returns|Raises|Source|Shapes|Yields|Example|Examples):\s*(.*)$"
)
_ENTRY = re.compile(r"^(\s*)([A-Za-z_][\w, *]*): (.*)$")


def escaped(text: str) -> str:
    """Text that Markdown shows as it is."""
    return re.sub(r"([\\`*_{}\[\]<>#|$~])", r"\\\1", text)


def _inline(text: str) -> str:
    """Text with its `code` kept as code."""
    parts = re.split(r"(``?[^`]+``?)", text)
    return "".join(part if index % 2 else escaped(part) for index, part in enumerate(parts))


def cell(text: object) -> str:
    """Text of one cell of a table."""
    return _inline(" ".join(str(text).split())) or "–"


def table(heads: tuple[str, ...], rows: list[tuple[object, ...]]) -> str:
    """A table; cells that start with a backtick are taken as Markdown."""
    lines = ["| " + " | ".join(heads) + " |", "|---" * len(heads) + "|"]
    lines += ["| " + " | ".join(cell(value) for value in row) + " |" for row in rows]
    return "\n".join(lines)


def markdown(doc: str | None) -> str:
    """A docstring as Markdown: paragraphs, indented blocks as code, sections as lists."""
    lines = inspect.cleandoc(doc or "").splitlines()
    blocks: list[str] = []
    at = 0
    while at < len(lines):
        line = lines[at]
        if not line.strip():
            at += 1
            continue
        section = _SECTION.match(line)
        end = at + 1
        if section:
            while end < len(lines) and (not lines[end].strip() or lines[end].startswith(" ")):
                end += 1
            blocks.append(_section(section[1], section[2], lines[at + 1 : end]))
        elif line.startswith("    "):
            while end < len(lines) and (not lines[end].strip() or lines[end].startswith("    ")):
                end += 1
            blocks.append("```text\n" + inspect.cleandoc("\n".join(lines[at:end])).rstrip() + "\n```")
        else:
            while (
                end < len(lines)
                and lines[end].strip()
                and not lines[end].startswith("    ")
                and not _SECTION.match(lines[end])
            ):
                end += 1
            blocks.append(_paragraph(lines[at:end]))
        at = end
    return "\n\n".join(blocks)


def _paragraph(lines: list[str]) -> str:
    if lines[0].startswith("| ") or lines[0].startswith("- "):
        return "```text\n" + "\n".join(lines) + "\n```"
    return _inline(" ".join(part.strip() for part in lines))


def _section(name: str, rest: str, lines: list[str]) -> str:
    """A section: its entries `name: text`, each of which may go on in deeper lines."""
    entries: list[str] = []
    for line in inspect.cleandoc("\n".join(["", *lines])).splitlines():
        if not line.strip():
            continue
        found = _ENTRY.match(line) if not line.startswith(" ") else None
        if found:
            entries.append(f"- `{found[2].strip()}`: {_inline(found[3])}")
        elif entries:
            entries[-1] += " " + _inline(line.strip())
        else:
            rest = f"{rest} {line.strip()}".strip()
    head = f"**{name}.** {_inline(rest)}".rstrip()
    return head + ("\n\n" + "\n".join(entries) if entries else "")
