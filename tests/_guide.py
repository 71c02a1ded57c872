"""The recipes of CONTRIBUTING.md, as tests read them."""

from __future__ import annotations

import re
from pathlib import Path


def recipe(project: Path, title: str) -> str:
    """The text of one recipe under "To add…": from its title, in bold, to the next one."""
    text = (project / "CONTRIBUTING.md").read_text(encoding="utf-8")
    parts = re.split(r"^(?=\*\*an? [^*]+\*\*: |## )", text, flags=re.MULTILINE)
    (found,) = [part for part in parts if part.startswith(f"**{title}**: ")]
    return found


def block(project: Path, title: str, language: str) -> str:
    """The one block of code in that language in a recipe."""
    (code,) = re.findall(rf"```{language}\n(.*?)```", recipe(project, title), re.DOTALL)
    return str(code)
