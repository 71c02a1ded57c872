"""The command `compare`."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

from ..console import print_lines, print_table
from .build import Arguments, View, command

if TYPE_CHECKING:
    import pandas as pd

__all__ = ["COMPARE"]


def _json(table: pd.DataFrame, given: Arguments) -> dict[str, Any]:
    only_a, only_b = table.attrs["unpaired"]
    return {
        "over_scenes": table.attrs["over_scenes"],
        "rows": table.to_dict(orient="records"),
        "only_in_a": only_a,
        "only_in_b": only_b,
        "machines_differ": table.attrs["machines_differ"],
    }


def _text(table: pd.DataFrame, given: Arguments) -> None:
    over = table.attrs["over_scenes"]
    print_table(
        ("estimator", "quantity", "condition", "scenes", "error B/A over scenes", "p (Holm)"),
        [_over_scenes(row) for row in over],
        right=("scenes", "error B/A over scenes", "p (Holm)"),
    )
    if any(row["scenes"] < 6 for row in over):
        print_lines("An interval over scenes needs at least six scenes.")
    print_lines("")
    print_table(
        (
            "estimator", "scene", "condition", "stress", "pairs", "error B/A", "cpu B/A", "coverage", "failed", "status",
        ),
        [_by_scene(row) for row in table.to_dict(orient="records")],
        right=("pairs", "error B/A", "cpu B/A", "coverage", "failed"),
    )  # fmt: skip
    if table.attrs["machines_differ"]:
        print_lines("Times are not compared: the runs differ in " + "; ".join(table.attrs["machines_differ"]) + ".")
    only_a, only_b = table.attrs["unpaired"]
    if only_a or only_b:
        print_lines(f"Rows without a partner: {only_a} of A, {only_b} of B.")


def _ratio(row: Mapping[Any, Any], name: str) -> str:
    value, low, high = (row[f"{name}_{part}"] for part in ("ratio", "lo", "hi"))
    text = "–" if value != value else f"{value:.3f}"
    return text if low != low else f"{text} [{low:.3f}, {high:.3f}]"


def _change(value: float) -> str:
    return "–" if value != value else f"{100 * value:+.1f} %"


def _over_scenes(row: Mapping[Any, Any]) -> list[str]:
    p = "–" if row["p_holm"] != row["p_holm"] else f"{row['p_holm']:.2g}"
    return [row["estimator"], row["quantity"], row["condition"], str(row["scenes"]), _ratio(row, "error"), p]


def _by_scene(row: Mapping[Any, Any]) -> list[str]:
    return [
        row["estimator"],
        row["scene"] + (" (mixed)" if str(row["quantity"]).endswith("-mixed") else ""),
        row["condition"],
        row["stress"] or "none",
        str(row["pairs"]),
        _ratio(row, "error"),
        _ratio(row, "cpu"),
        _change(row["coverage_change"]),
        _change(row["failure_change"]),
        row["status"],
    ]


COMPARE = command(
    "compare",
    "compare:compare",
    View(_text, _json),
    examples="""Examples:
  beambench compare runs/before runs/after
  beambench compare before.csv after.csv --json""",
)
