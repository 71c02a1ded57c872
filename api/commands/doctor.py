"""The command `doctor`."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from ..console import print_lines, print_table
from .build import Arguments, View, command

if TYPE_CHECKING:
    from ..health.finding import Finding

__all__ = ["DOCTOR"]


def _broken(findings: list[Finding]) -> bool:
    return any(finding.state == "broken" for finding in findings)


def _json(findings: list[Finding], given: Arguments) -> dict[str, Any]:
    from dataclasses import asdict

    return {"ok": not _broken(findings), "findings": [asdict(finding) for finding in findings]}


def _text(findings: list[Finding], given: Arguments) -> None:
    print_table(
        ("", "what", "state", "found", "remedy"),
        [(one.group, one.name, one.state, one.found, one.advice) for one in findings],
    )
    print_lines("", "A required part is broken." if _broken(findings) else "All required parts work.")


DOCTOR = command(
    "doctor",
    "doctor:doctor",
    View(_text, _json, lambda findings: int(_broken(findings))),
    examples="""Examples:
  beambench doctor
  beambench doctor --json""",
)
