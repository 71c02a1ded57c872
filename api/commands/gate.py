"""The command `gate`."""

from __future__ import annotations

import math
import os
from dataclasses import asdict
from typing import TYPE_CHECKING, Any

from ..console import print_lines, print_table
from .build import Arguments, View, command, lines

if TYPE_CHECKING:
    from ..benchmarks.gate.gate import GateResult

__all__ = ["GATE"]

_CODES = {"pass": 0, "regression": 1, "abstains": 3}


def _json(result: GateResult, given: Arguments) -> dict[str, Any]:
    return {
        "verdict": result.verdict,
        "checks": [asdict(check) for check in result.checks],
        "same_code": {name: {"log": same, "half_99": half} for name, (same, half) in result.same.items()},
        "notes": result.notes,
        "baseline": str(result.baseline),
    }


def _text(result: GateResult, given: Arguments) -> None:
    from ..benchmarks.gate.outputs import annotation_lines, change_text

    for name, (same, half) in result.same.items():
        print_lines(f"A/A      {name}: {100 * math.expm1(same):+.2f} % ± {100 * half:.2f} % (99 %)")
    odd = [check for check in result.checks if check.state != "pass" or not math.isnan(check.p_holm)]
    if odd:
        print_table(
            ("verdict", "figure", "of", "change", "must stay below", "p (Holm)", "note"),
            [
                (
                    check.state, check.figure, check.subject, change_text(check), _effect(check.figure, check.effect),
                    "–" if math.isnan(check.p_holm) else f"{check.p_holm:.2g}", check.note,
                )
                for check in odd
            ],
            right=("change", "must stay below", "p (Holm)"),
        )  # fmt: skip
    if os.environ.get("GITHUB_ACTIONS") == "true":
        print_lines(*annotation_lines(result.checks))
    print_lines(*result.notes)
    if given.get("update"):
        print_lines(f"baseline {result.baseline}")
        return
    counts = {state: sum(check.state == state for check in result.checks) for state in _CODES}
    told = ", ".join(f"{count} {state}" for state, count in counts.items() if count)
    print_lines(f"gate     {result.verdict}: {told}")


def _effect(figure: str, effect: float) -> str:
    if math.isnan(effect):
        return "–"
    return f"{100 * effect:.2g} points" if figure in ("failures", "coverage") else f"{100 * math.expm1(effect):.2g} %"


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
