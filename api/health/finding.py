"""One line of the doctor's table."""

from __future__ import annotations

from dataclasses import dataclass

__all__ = ["Finding"]


@dataclass(frozen=True)
class Finding:
    """The state of one part.

    Main arguments:
        group, name: What was examined.
        state: "ok", "missing" (optional), "warning" or "broken" (required).
        found: What was seen.
        advice: What helps.
    """

    group: str
    name: str
    state: str
    found: str
    advice: str = ""
