"""The page docs/declared-rig.md: its tables, as they follow from the tables of the readers, and its examples."""

from __future__ import annotations

import re
from pathlib import Path

from beambench.estimators.amcw.declared import AMCW_KEYS
from beambench.estimators.declared import Key
from beambench.estimators.gated.tools.declared import GATED_KEYS
from beambench.estimators.laser_line.declared import LASER_LINE_KEYS
from beambench.estimators.waveform.declared import WAVEFORM_KEYS
from beambench.estimators.wavefront.declared import WAVEFRONT_KEYS

TABLES: dict[str, tuple[Key, ...]] = {
    "gated": GATED_KEYS, "waveform": WAVEFORM_KEYS, "amcw": AMCW_KEYS, "laser_line": LASER_LINE_KEYS,
    "wavefront": WAVEFRONT_KEYS,
}  # fmt: skip


def row(key: Key) -> str:
    """The line of a value in its table."""
    needed = "may be left out" if key.optional else "required"
    if key.within:
        needed = f"required where `{key.within}` is an object; null or absent: there is none"
    if key.case:
        needed = f'required where `{key.case[0]}` is "{key.case[1]}"'
    if key.unknown:
        needed += f"; null: {key.unknown}"
    return f"| `{key.path}` | {key.limits} | {key.unit} | {key.meaning} | {key.users} | {needed} |"


def table(keys: tuple[Key, ...]) -> str:
    """A whole table."""
    return "\n".join(
        ["| key | type | unit | meaning | read by | needed |", "|---|---|---|---|---|---|", *map(row, keys)]
    )


def page(project: Path) -> str:
    """The text of the page."""
    return (project / "docs" / "declared-rig.md").read_text(encoding="utf-8")


def section(project: Path, modality: str) -> str:
    """The part of the page about one modality."""
    parts = re.split(r"^## ", page(project), flags=re.MULTILINE)
    (found,) = [part for part in parts if part.startswith(f"{modality}\n")]
    return found


def example(project: Path, modality: str) -> str:
    """The one block of Python in that part."""
    (code,) = re.findall(r"```python\n(.*?)```", section(project, modality), re.DOTALL)
    return str(code)
