"""The person at the bench, as a device: what no driver sets (a shutter, a mirror that shows the reference) is set by hand."""

from __future__ import annotations

import sys
import time
from collections.abc import Mapping
from typing import Any

import numpy as np

from ...scenes.errors import InputError
from .device import Reading, Settings

__all__ = ["Operator"]


class Operator:
    """Asks for a setting where it changes, and waits for the Enter key.

    What is told back is what the person was asked for: nothing reads it. Raises InputError where there is no terminal.
    """

    def __init__(self) -> None:
        self._now: dict[str, Any] = {}
        self._shots = 0

    def open(self) -> Mapping[str, Any]:
        """As `Device.open`."""
        return {"vendor": "", "model": "set by hand", "serial": "", "firmware": ""}

    def configure(self, settings: Settings) -> Mapping[str, Any]:
        """As `Device.configure`."""
        changed = {name: value for name, value in settings.items() if self._now.get(name) != value}
        if changed:
            if not sys.stdin.isatty():
                raise InputError(
                    "What is set by hand needs somebody at the terminal.", where="driver operator", value=changed,
                    next_step="record from a terminal, or give the role to another device",
                )  # fmt: skip
            wanted = ", ".join(f"{name} = {value}" for name, value in changed.items())
            print(f"\nset by hand: {wanted}; then press Enter", file=sys.stderr, flush=True)
            sys.stdin.readline()
            self._now |= changed
        return dict(settings)

    def arm(self) -> None:
        """As `Device.arm`."""

    def fire(self) -> None:
        """Nothing: hands are too slow for a shot."""
        self._shots += 1

    def read(self, timeout_s: float) -> Reading:
        """As `Device.read`: it measures nothing."""
        return Reading(np.empty(0), self._shots, 0, time.time_ns())

    def close(self) -> None:
        """As `Device.close`."""
