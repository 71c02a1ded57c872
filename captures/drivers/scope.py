"""Oscilloscopes that speak SCPI with Tektronix' names of the waveform's scale, over TCP or VISA: a trace as volts."""

from __future__ import annotations

import contextlib
import math
import time
from collections.abc import Mapping
from typing import Any, Protocol

import numpy as np

from ...scenes.errors import InputError
from .device import DeviceLost, DeviceTimeout, FrameDamaged, Reading, Settings
from .scpi import ScpiLink, block_size

__all__ = ["Scope"]

_SCALES = ("XINCR", "XZERO", "YMULT", "YOFF", "YZERO")


class _Link(Protocol):
    def open(self) -> None: ...
    def close(self) -> None: ...
    def tell(self, *commands: str) -> None: ...
    def ask(self, *commands: str) -> list[str]: ...
    def block(self, command: str, timeout_s: float) -> bytes: ...


class Scope:
    """The oscilloscope at `address`: HOST:PORT of its raw socket, or a VISA resource, e.g. "USB0::0x0699::0x0401::C000001::INSTR".

    Settings are its own commands ("HORIZONTAL:SCALE"); readings are volts (sample), float64, of 16-bit digits.
    """

    def __init__(self, address: str, *, serial: str = "") -> None:
        self._link: _Link = _Visa(address) if "::" in address else ScpiLink(address, port=4000)
        self._address, self._serial, self._shots = address, serial, 0
        self._scale: dict[str, float] = {}

    def open(self) -> Mapping[str, Any]:
        """As `Device.open`. Raises DeviceLost, InputError for another serial number."""
        self._link.open()
        parts = [*self._link.ask("*IDN?")[0].split(","), "", "", ""]
        if self._serial and parts[2] != self._serial:
            raise InputError(
                "Another instrument is at this address.", where=f"scope at {self._address}", value=parts[2],
                allowed=self._serial, next_step="correct `address` or `serial` in the rig file",
            )  # fmt: skip
        return {"vendor": parts[0], "model": parts[1], "serial": parts[2], "firmware": parts[3]}

    def configure(self, settings: Settings) -> Mapping[str, Any]:
        """As `Device.configure`; the scale of the trace is read as well."""
        told: dict[str, Any] = {}
        for name, value in settings.items():
            (told[name],) = self._link.ask(f"{name} {value}", f"{name}?")
        answers = self._link.ask(*(f"WFMOUTPRE:{name}?" for name in _SCALES))
        try:
            self._scale = {name: float(answer) for name, answer in zip(_SCALES, answers, strict=True)}
        except ValueError as error:
            raise DeviceLost(f"scope at {self._address}: its scale is no number: {answers}") from error
        if not all(map(math.isfinite, self._scale.values())) or self._scale["XINCR"] <= 0:
            raise DeviceLost(f"scope at {self._address}: its scale is impossible: {self._scale}")
        return told | {"step_s": self._scale["XINCR"], "start_s": self._scale["XZERO"], "volts": self._scale["YMULT"]}

    def arm(self) -> None:
        """As `Device.arm`: one acquisition."""
        self._link.tell("ACQUIRE:STATE RUN")

    def fire(self) -> None:
        """A trigger by command."""
        self._link.tell("*TRG")

    def read(self, timeout_s: float) -> Reading:
        """As `Device.read`."""
        data = self._link.block("CURVe?", timeout_s)
        if len(data) < 2 or len(data) % 2:
            raise FrameDamaged(f"scope at {self._address}: {len(data)} bytes are no trace of 16-bit digits")
        scale = self._scale
        if not scale:
            raise DeviceLost(f"scope at {self._address}: not configured")
        volts = (np.frombuffer(data, ">i2").astype(np.float64) - scale["YOFF"]) * scale["YMULT"] + scale["YZERO"]
        self._shots += 1
        return Reading(volts, self._shots, 0, time.time_ns())

    def close(self) -> None:
        """As `Device.close`."""
        with contextlib.suppress(Exception):
            self._link.close()


class _Visa:
    """The same link by pyvisa (extra `drivers`)."""

    def __init__(self, resource: str) -> None:
        self._resource = resource
        self._instrument: Any = None

    def open(self) -> None:
        try:
            import pyvisa
        except ImportError as error:
            raise InputError(
                "VISA resources need pyvisa.",
                where="scope",
                value=self._resource,
                next_step="pip install 'beambench[drivers]'",
            ) from error
        try:
            self._instrument = pyvisa.ResourceManager("@py").open_resource(self._resource, read_termination="\n")
        except Exception as error:  # pyvisa's back ends raise what they like
            raise DeviceLost(f"{self._resource}: {error}") from error

    def close(self) -> None:
        if self._instrument is not None:
            self._instrument.close()
        self._instrument = None

    def tell(self, *commands: str) -> None:
        self._visa().write(";".join(commands))

    def ask(self, *commands: str) -> list[str]:
        self.tell(*commands)
        try:
            return [self._visa().read().strip() for command in commands if "?" in command]
        except Exception as error:
            self.close()  # the late answer must not be taken for the next one
            raise DeviceTimeout(f"{self._resource}: {error}") from error

    def block(self, command: str, timeout_s: float) -> bytes:
        self.tell(command)
        try:
            self._visa().timeout = 1e3 * timeout_s
            raw = b""
            while (size := block_size(raw)) is None:
                raw += self._visa().read_bytes(1)
            if size[0] == 0:
                raise FrameDamaged(f"{self._resource}: the answer is no binary block")
            return bytes(self._visa().read_bytes(size[1] + 1)[: size[1]])
        except FrameDamaged:
            raise
        except Exception as error:
            self.close()
            raise DeviceTimeout(f"{self._resource}: {error}") from error

    def _visa(self) -> Any:
        if self._instrument is None:
            self.open()
        return self._instrument
