"""The command `gate`."""

from __future__ import annotations

import math
import os
from collections import Counter
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

from ..console import print_lines, print_table
from .build import Arguments, View, command, lines

if TYPE_CHECKING:
    from ..benchmarks.gate.check import Check
    from ..benchmarks.gate.gate import GateResult

__all__ = ["GATE"]

_CODES = {"pass": 0, "regression": 1, "abstains": 3}
#: Checks that pass without a test and have a row each; more are told by their number.
_PLAIN = 12


def _json(result: GateResult, given: Arguments) -> dict[str, Any]:
    from ..benchmarks.gate.outputs import check_record

    return {
        "verdict": result.verdict,
        "checks": [check_record(check) for check in result.checks],
        "same_code": {name: {"log": same, "half_99": half} for name, (same, half) in result.same.items()},
        "notes": result.notes,
        "baseline": str(result.baseline),
    }


def _text(result: GateResult, given: Arguments) -> None:
    from ..benchmarks.gate.outputs import annotation_lines

    for name, (same, half) in result.same.items():
        print_lines(f"A/A      {name}: {100 * math.expm1(same):+.2f} % ± {100 * half:.2f} % (99 %)")
    if result.checks:
        print_table(
            ("verdict", "figure", "of", "change", "must stay below", "p (Holm)", "note"),
            _rows(result.checks),
            right=("change", "must stay below", "p (Holm)"),
        )
    if os.environ.get("GITHUB_ACTIONS") == "true":
        print_lines(*annotation_lines(result.checks))
    print_lines(*result.notes)
    if given.get("update"):
        print_lines(f"baseline {result.baseline}")
        return
    counts = {state: sum(check.state == state for check in result.checks) for state in _CODES}
    told = ", ".join(f"{count} {state}" for state, count in counts.items() if count)
    print_lines(f"gate     {result.verdict}: {told}")


def _rows(checks: Sequence[Check]) -> list[tuple[str, ...]]:
    """A row per check; of many that pass without a test (equal numbers, too few bytes) a row per figure, with their number."""
    from ..benchmarks.gate.outputs import change_text

    plain = [check for check in checks if check.state == "pass" and math.isnan(check.p_holm)]
    counts = Counter(check.figure for check in plain) if len(plain) > _PLAIN else Counter[str]()
    rows: list[tuple[str, ...]] = [
        (
            check.state, check.figure, check.subject, change_text(check), _effect(check.figure, check.effect),
            "–" if math.isnan(check.p_holm) else f"{check.p_holm:.2g}", check.note,
        )
        for check in checks
        if not (counts and check in plain)
    ]  # fmt: skip
    return rows + [
        ("pass", figure, f"{count} checks", "–", "–", "–", "equal numbers, or a change too small to test")
        for figure, count in counts.items()
    ]


def _effect(figure: str, effect: float) -> str:
    from ..benchmarks.gate.outputs import in_percent

    if math.isnan(effect):
        return "–"
    return f"{in_percent(figure, effect):.2g} {'points' if figure in ('failures', 'coverage') else '%'}"


def _code(result: GateResult) -> int:
    return _CODES[result.verdict]


GATE = command(
    "gate",
    "gate:gate",
    View(_text, _json, _code),
    progress=lines,
    examples="""Examples:
  beambench gate run/ --baseline baseline.json --update --why 'first baseline'
  beambench gate run/ --baseline baseline.json
  beambench gate run/ --baseline baseline.json --against main --junit gate.xml
  beambench gate run/ --baseline run/ --new poisson-ml --old weighted-average

Exit codes: 0 pass, 1 regression, 2 bad input, 3 abstains.""",
)
