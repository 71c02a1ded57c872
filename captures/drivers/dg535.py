"""SRS DG535 delay generator behind a Prologix GPIB-Ethernet adapter. Untried on the instrument; tried against its protocol only.

Source: Stanford Research Systems, DG535 user manual, rev. 2.6; Prologix, GPIB-Ethernet controller manual, 1.6.
"""

from __future__ import annotations

import time
from collections.abc import Mapping
from typing import Any

import numpy as np

from ...scenes.errors import InputError
from .device import DeviceLost, Reading, Settings
from .scpi import ScpiLink

__all__ = ["Dg535"]

_CHANNELS = {"T0": 1, "A": 2, "B": 3, "C": 5, "D": 6}
_OUTPUTS = {"T0": 1, "A": 2, "B": 3, "AB": 4, "C": 5, "D": 6, "CD": 7}
_CLOSE_S = 3e-12


class Dg535:
    """The delay generator of GPIB address `gpib` behind the adapter at `address` (HOST or HOST:PORT); else as `Dg645`.

    Settings: `delay_s`, `laser_on`. The instrument has no bursts of its own in single-shot mode: one pulse a shot.
    """

    def __init__(
        self, address: str, *, gpib: int = 15, laser: str = "A", gate: str = "C", laser_output: str = "AB",
        laser_on_v: float = 4.0, laser_off_v: float = 0.1,
    ) -> None:  # fmt: skip
        for name, known in ((laser, _CHANNELS), (gate, _CHANNELS), (laser_output, _OUTPUTS)):
            if name not in known:
                raise InputError(
                    "The delay generator has no such channel.", where="delay", value=name, allowed=", ".join(known)
                )
        self._link, self._gpib = ScpiLink(address, port=1234), gpib
        self._laser, self._gate, self._output = _CHANNELS[laser], _CHANNELS[gate], _OUTPUTS[laser_output]
        self._on_v, self._off_v, self._shots = laser_on_v, laser_off_v, 0

    def open(self) -> Mapping[str, Any]:
        """As `Device.open`. The instrument does not say who it is."""
        self._link.open()
        for line in ("++mode 1", f"++addr {self._gpib}", "++auto 0", "++eoi 1", "++eos 0", "CL", "TM 2"):
            self._link.tell(line)
        self._number("ES")
        return {"vendor": "Stanford Research Systems", "model": "DG535", "serial": "", "firmware": ""}

    def configure(self, settings: Settings) -> Mapping[str, Any]:
        """As `Device.configure`."""
        told: dict[str, Any] = {}
        for name, value in settings.items():
            if name == "delay_s":
                self._link.tell(f"DT {self._gate},{self._laser},{float(value):.12f}")
                told[name] = self._number(f"DT {self._gate}", last=True)
                if abs(told[name] - value) > _CLOSE_S:
                    raise DeviceLost(
                        f"{self._link}: a delay of {value:.12f} s was set, and {told[name]:.12f} s is read"
                    )
            elif name == "laser_on":
                self._link.tell(f"OM {self._output},3")
                self._link.tell(f"OA {self._output},{self._on_v if value else self._off_v:.2f}")
                level = self._number(f"OA {self._output}")
                told[name] = abs(level - self._on_v) < abs(level - self._off_v)
            elif name != "pulses" or int(value) != 1:
                raise InputError(
                    "The delay generator has no such setting.", where="delay", value={name: value},
                    allowed="delay_s, laser_on; one pulse a shot",
                )  # fmt: skip
            else:
                told[name] = 1
        if error := int(self._number("ES")):
            raise InputError(
                "The delay generator refuses a setting.", where=f"delay at {self._link}", value=f"error {error}"
            )
        return told

    def arm(self) -> None:
        """As `Device.arm`."""

    def fire(self) -> None:
        """One trigger."""
        self._link.tell("SS")
        self._shots += 1

    def read(self, timeout_s: float) -> Reading:
        """As `Device.read`: it measures nothing."""
        return Reading(np.empty(0), self._shots, 0, time.time_ns())

    def close(self) -> None:
        """As `Device.close`."""
        self._link.close()

    def _number(self, query: str, *, last: bool = False) -> float:
        """The number that answers a query; `last`: the last of several. Raises DeviceTimeout, DeviceLost."""
        self._link.tell(query)
        self._link.tell("++read eoi")
        answer = self._link.line()
        try:
            return float(answer.split(",")[-1] if last else answer)
        except ValueError as error:
            self._link.close()
            raise DeviceLost(f"{self._link}: {answer[:40]!r} is no answer to {query}") from error
