"""The command `drivers list`."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from ..console import print_lines, print_table
from .build import Arguments, View, command

if TYPE_CHECKING:
    from ..captures.drivers.listing import Driver

__all__ = ["LIST"]


def _json(drivers: list[Driver], given: Arguments) -> list[dict[str, Any]]:
    return [
        {
            "name": one.name, "role": one.role, "what": one.what, "tried": one.tried, "needs": list(one.needs), "how": one.how,
            "there": one.there,
        }
        for one in drivers
    ]  # fmt: skip


def _text(drivers: list[Driver], given: Arguments) -> None:
    rows = [
        (
            one.name,
            one.role,
            "ok" if one.there else "missing",
            one.what,
            f"tried on: {one.tried}",
            "" if one.there else one.how,
        )
        for one in drivers
    ]
    print_table(("driver", "role", "state", "devices", "tried", "how to get it"), rows)
    print_lines("", "A rig file names them: docs/recording.md")


LIST = command(
    "drivers list",
    "drivers:drivers_list",
    View(_text, _json),
    examples="Example:\n  beambench drivers list",
)
