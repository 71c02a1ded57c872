"""The command `fidelity`."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

from ..console import print_lines, print_table
from .build import Arguments, View, command, lines

__all__ = ["FIDELITY"]


def _record(folder: Path) -> dict[str, Any]:
    record: dict[str, Any] = json.loads((folder / "fidelity.json").read_text(encoding="utf-8"))
    return record


def _json(folder: Path, given: Arguments) -> dict[str, Any]:
    return {"out": str(folder), **_record(folder)}


def _text(folder: Path, given: Arguments) -> None:
    record = _record(folder)
    policies = record.pop("policies")
    record.pop("references")
    flat = {k: v for k, v in record.items() if not isinstance(v, dict)}
    flat |= {f"{k}: {name}": value for k, v in record.items() if isinstance(v, dict) for name, value in v.items()}
    print_table(("quantity", "value"), [(name, _shown(value)) for name, value in flat.items()], right=("value",))
    columns = ("reference", "policy", "rtol", "decisions", "within_rtol", "lo", "hi", "cheapest", "cpu_s", "undecided")
    table = [tuple(_shown(row[name]) for name in columns) for row in policies]
    print_table(columns, table, right=columns[3:])
    print_lines(
        f"tables   {folder / 'fidelity.csv'}, policies.csv, fidelity.json", f"picture  {folder / 'fidelity.svg'}"
    )


def _shown(value: object) -> str:
    return f"{value:.3g}" if isinstance(value, float) else "" if value is None else str(value)


FIDELITY = command(
    "fidelity",
    "fidelity:fidelity",
    View(_text, _json),
    progress=lines,
    examples="""Examples:
  beambench fidelity
  beambench fidelity --modality laser_line --scenes 30
  beambench fidelity --scenes 60 --seed 7 -o ladder
  beambench fidelity --scenes 60 --seed 7 -o ladder --resume""",
)
