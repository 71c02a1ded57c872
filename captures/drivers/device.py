"""The protocol of every device that takes part in a recording, and the three ways in which one fails.

A recording does not know which device it talks to: it configures, arms, fires and reads. What a device was *told* is never
recorded, only what it says when it is asked (`configure` returns that).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, Protocol, runtime_checkable

from numpy.typing import NDArray

__all__ = ["Device", "DeviceError", "DeviceLost", "DeviceTimeout", "Firing", "FrameDamaged", "Reading", "Settings"]

#: Settings by name; units are in the names ("exposure_s"). A name of another form is a feature of the device itself.
Settings = Mapping[str, Any]


class DeviceError(Exception):
    """A device did not do what it was asked to; never raised itself, but as one of the three kinds below."""


class DeviceTimeout(DeviceError):
    """Nothing came in time: try again."""


class FrameDamaged(DeviceError):
    """Data came, and are not sound: take them again."""


class DeviceLost(DeviceError):
    """The device no longer answers: open it again, configure it, and go on."""


@dataclass(frozen=True, eq=False)
class Reading:
    """What one event left in a device.

    Main arguments:
        data: a frame (row, col), a trace (sample), or an empty array of a device that measures nothing.
        index: the device's own number of the event; a GigE camera counts 1 … 65535 and then 1 again.
        device_ns: the device's clock [ns], 0 of a device without one. host_ns: this machine's, since 1970 [ns].
    Other arguments:
        meta: what else is known of the event, as plain numbers and text.
    """

    data: NDArray[Any]
    index: int
    device_ns: int
    host_ns: int
    meta: Mapping[str, Any] = field(default_factory=dict)


@runtime_checkable
class Device(Protocol):
    """Whatever records or is set."""

    def open(self) -> Mapping[str, Any]:
        """Connect; vendor, model, serial and firmware. Raises DeviceLost where nothing answers."""
        ...

    def configure(self, settings: Settings) -> Mapping[str, Any]:
        """Set, then ask: the settings as read back, by the same names. Raises DeviceTimeout, DeviceLost, InputError."""
        ...

    def arm(self) -> None:
        """Throw away what is stale, and be ready for one event."""
        ...

    def read(self, timeout_s: float) -> Reading:
        """The event since `arm`. Raises DeviceTimeout, FrameDamaged, DeviceLost."""
        ...

    def close(self) -> None:
        """Let go; never raises, and may be called at any time."""
        ...


@runtime_checkable
class Firing(Device, Protocol):
    """A device that can trigger a shot."""

    def fire(self) -> None:
        """Trigger one event."""
        ...
