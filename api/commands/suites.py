"""The commands `suites list`, `show` and `new`."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from ..console import print_json, print_lines, print_table
from .build import Arguments, View, command

__all__ = ["LIST", "NEW", "SHOW"]


def _list_json(rows: list[dict[str, Any]], given: Arguments) -> list[dict[str, Any]]:
    return rows


def _list_text(rows: list[dict[str, Any]], given: Arguments) -> None:
    heads = ("suite", "scenes", "seeds", "estimators", "stress", "title")
    lines = []
    for row in rows:
        scenes = " + ".join(row["parts"]) or str(row["scenes"])
        counts = [str(row[name] or "") for name in ("seeds", "estimators")]
        lines.append((row["name"], scenes, *counts, " × ".join(row["stresses"]), row["title"]))
    print_table(heads, lines, right=("seeds", "estimators"))


LIST = command(
    "suites list", "suites:suites_list", View(_list_text, _list_json), examples="Example:\n  beambench suites list"
)


def _show_json(shown: dict[str, Any], given: Arguments) -> dict[str, Any]:
    return shown


def _show_text(shown: dict[str, Any], given: Arguments) -> None:
    if shown["text"]:
        print(shown["text"].rstrip())
    else:
        print_json(shown["suite"])
    print_lines(f"# {shown['captures']} captures, {shown['estimates']} estimates")


SHOW = command(
    "suites show",
    "suites:suites_show",
    View(_show_text, _show_json),
    examples="""Examples:
  beambench suites show gated
  beambench suites show full --json""",
)


def _new_json(path: Path, given: Arguments) -> dict[str, str]:
    return {"file": str(path)}


def _new_text(path: Path, given: Arguments) -> None:
    print_lines(str(path), f"next: change it, then beambench run {path} --split dev")


NEW = command(
    "suites new",
    "suites:suites_new",
    View(_new_text, _new_json),
    examples="""Examples:
  beambench suites new mine
  beambench suites new my-lines --like laser-line -o suites/my-lines.toml""",
)
