"""SRS DG645 delay generator on TCP (port 5025): the laser on one output, the gate on another, single shots.

Source: Stanford Research Systems, DG645 user manual, rev. 1.2, chapter 3.
"""

from __future__ import annotations

import math
import time
from collections.abc import Mapping
from typing import Any

import numpy as np

from ...scenes.errors import InputError
from .device import DeviceLost, Reading, Settings
from .scpi import ScpiLink

__all__ = ["Dg645"]

_CHANNELS = {name: number for number, name in enumerate(("T0", "T1", "A", "B", "C", "D", "E", "F", "G", "H"))}
_OUTPUTS = {"T0": 0, "AB": 1, "CD": 2, "EF": 3, "GH": 4}
#: Half the resolution of 5 ps, and rounding.
_CLOSE_S = 3e-12


class Dg645:
    """The delay generator at `address` (HOST or HOST:PORT).

    Main arguments:
        laser, gate: channels whose edges trigger the laser and open the gate; a delay is that of `gate` after `laser`.
        laser_output: output of the laser; it fires at `laser_on_v`, and not at `laser_off_v`, which its input takes for low.
    Other arguments:
        serial: what the serial number must be; "" takes any.
        pulse_period_s: distance of the pulses of a burst, where a shot has several.

    Settings: `delay_s`, `laser_on`, `pulses`. Delays are sent with twelve decimals: fewer digits would lose picoseconds.
    """

    def __init__(
        self, address: str, *, laser: str = "A", gate: str = "C", laser_output: str = "AB", laser_on_v: float = 4.0,
        laser_off_v: float = 0.5, serial: str = "", pulse_period_s: float = 1e-4,
    ) -> None:  # fmt: skip
        for name, known in ((laser, _CHANNELS), (gate, _CHANNELS), (laser_output, _OUTPUTS)):
            if name not in known:
                raise InputError(
                    "The delay generator has no such channel.", where="delay", value=name, allowed=", ".join(known)
                )
        self._link = ScpiLink(address)
        self._laser, self._gate, self._output = _CHANNELS[laser], _CHANNELS[gate], _OUTPUTS[laser_output]
        self._on_v, self._off_v, self._serial, self._period_s = laser_on_v, laser_off_v, serial, pulse_period_s
        self._shots = 0

    def open(self) -> Mapping[str, Any]:
        """As `Device.open`. Raises DeviceLost, InputError for another instrument."""
        self._link.open()
        (identity,) = self._link.ask("*CLS", "TSRC 5", "*IDN?")
        parts = [part.strip() for part in identity.split(",")] + [""] * 4
        serial = parts[2].removeprefix("s/n")
        if "DG645" not in parts[1] or (self._serial and serial != self._serial):
            self.close()
            raise InputError(
                "Another instrument is at this address.", where=f"delay at {self._link}", value=identity,
                allowed=f"a DG645 {self._serial}".strip(), next_step="correct `address` or `serial` in the rig file",
            )  # fmt: skip
        return {"vendor": parts[0], "model": parts[1], "serial": serial, "firmware": parts[3]}

    def configure(self, settings: Settings) -> Mapping[str, Any]:
        """As `Device.configure`: all in one write, read back, and the instrument's errors asked for."""
        commands: list[str] = []
        for name, value in settings.items():
            if name not in _SETTERS:
                raise InputError(
                    "The delay generator has no such setting.", where="delay", value=name, allowed=", ".join(_SETTERS)
                )
            commands += _SETTERS[name](self, value)
        *answers, error = self._link.ask(*commands, "LERR?")
        if error != "0":
            raise InputError(
                "The delay generator refuses a setting.", where=f"delay at {self._link}", value=dict(settings),
                allowed=f"what its manual allows; it tells error {error}", next_step="change the plan",
            )  # fmt: skip
        told = {name: self._told(name, answer) for name, answer in zip(settings, answers, strict=True)}
        wanted = settings.get("delay_s")
        if wanted is not None and abs(told["delay_s"] - wanted) > _CLOSE_S:
            raise DeviceLost(f"{self._link}: a delay of {wanted:.12f} s was set, and {told['delay_s']:.12f} s is read")
        return told

    def arm(self) -> None:
        """As `Device.arm`: nothing to do, a delay generator waits."""

    def fire(self) -> None:
        """One trigger."""
        self._link.tell("*TRG")
        self._shots += 1

    def read(self, timeout_s: float) -> Reading:
        """As `Device.read`: it measures nothing."""
        return Reading(np.empty(0), self._shots, 0, time.time_ns())

    def close(self) -> None:
        """As `Device.close`."""
        self._link.close()

    def _set_delay(self, value: Any) -> list[str]:
        return [f"DLAY {self._gate},{self._laser},{float(value):.12f}", f"DLAY?{self._gate}"]

    def _set_laser(self, value: Any) -> list[str]:
        return [f"LAMP {self._output},{self._on_v if value else self._off_v:.2f}", f"LAMP?{self._output}"]

    def _set_pulses(self, value: Any) -> list[str]:
        if int(value) == 1:
            return ["BURM 0", "BURC 1", "BURC?"]
        return ["BURM 1", f"BURP {self._period_s:.12f}", f"BURC {int(value)}", "BURC?"]

    def _told(self, name: str, answer: str) -> Any:
        """What an answer says. Raises DeviceLost for one that cannot be read: it may be that of another question."""
        try:
            if name == "delay_s":
                reference, _, delay = answer.partition(",")
                if int(reference) != self._laser or not math.isfinite(value := float(delay)):
                    raise ValueError
                return value
            if name == "laser_on":
                return abs(float(answer) - self._on_v) < abs(float(answer) - self._off_v)
            return int(answer)
        except ValueError as error:
            self._link.close()
            raise DeviceLost(f"{self._link}: {answer[:40]!r} is no answer to the question for {name}") from error


_SETTERS = {"delay_s": Dg645._set_delay, "laser_on": Dg645._set_laser, "pulses": Dg645._set_pulses}
