"""One shot after the other, one in flight: set, read back, arm, fire, read, commit; and what is done where something fails.

Escalation: a shot that is silent or damaged is taken again; after three silent ones all devices are closed and opened; where
nothing has succeeded for `give_up_s`, the recording ends with what it has. Each of these is a line of the journal.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...scenes.errors import InputError
from ..drivers.device import Device, DeviceError, DeviceLost, DeviceTimeout, Firing, FrameDamaged, Reading
from .recipe import Slot
from .slots import SlotStore

__all__ = ["Devices", "GivenUp", "Session", "Watch"]

#: Called after each shot: slots done, slots in all, a few words, the last reading.
Watch = Callable[[int, int, str, "NDArray[Any] | None"], None]

_SILENT = 3
_REST_S = (0.05, 0.2, 0.5, 1.0)


class GivenUp(Exception):
    """Nothing succeeded for too long."""


@dataclass(frozen=True)
class Devices:
    """The devices by name, the roles that each takes, and who gives the data and who fires.

    `settings`: {role: settings} for the whole recording. The device that gives the data need not be the one that fires.
    """

    by_name: Mapping[str, Device]
    roles: Mapping[str, str]
    source: str
    trigger: str
    settings: Mapping[str, Mapping[str, Any]]
    shot_timeout_s: float
    give_up_s: float

    def merged(self, by_role: Mapping[str, Mapping[str, Any]]) -> dict[str, dict[str, tuple[str, Any]]]:
        """{device: {setting: (role, value)}} of settings by role.

        The number of a shot is told to devices that play back only: no instrument has such a setting.
        """
        found: dict[str, dict[str, tuple[str, Any]]] = {}
        for role, settings in by_role.items():
            device = self.roles[role]
            for name, value in settings.items():
                if name != "shot" or getattr(self.by_name[device], "plays_back", False):
                    found.setdefault(device, {})[name] = (role, value)
        return found


class Session:
    """Takes shots with `devices` into `store`; a context manager, which closes the devices."""

    def __init__(self, devices: Devices, store: SlotStore) -> None:
        self._devices, self._store = devices, store
        self._last: int | None = None
        self._silent = self._opened = 0
        self._rest: list[int] = []
        self.fixed: dict[str, dict[str, Any]] = {}

    def __enter__(self) -> Session:
        try:
            self._open()
        except DeviceError as error:
            self.close()
            raise InputError(
                "A device does not answer.", where=str(error).split(": ")[0], value=str(error),
                next_step="check power, cable and address in the rig file; `beambench drivers list` shows the drivers",
            ) from error  # fmt: skip
        except BaseException:
            self.close()
            raise
        return self

    def __exit__(self, *error: object) -> None:
        self.close()

    def close(self) -> None:
        """Let go of all devices."""
        for device in self._devices.by_name.values():
            device.close()

    def take(self, number: int, slot: Slot) -> NDArray[Any]:
        """Take one slot, whatever it needs; its data. Raises GivenUp, InputError."""
        end = time.monotonic() + self._devices.give_up_s
        failures = 0
        while True:
            try:
                reading, told = self._shoot(slot)
                break
            except DeviceError as error:
                failures += 1
                self._store.note("retake", slot=number, why=f"{type(error).__name__}: {error}")
                if time.monotonic() > end:
                    self._store.note("given up", slot=number)
                    raise GivenUp(str(error)) from error
                self._silent += isinstance(error, DeviceTimeout)
                if isinstance(error, DeviceLost) or self._silent >= _SILENT:
                    self._reopen(end, failures)
        self._store.commit(
            number, reading.data,
            {
                "part": slot.part, "told": told, "index": reading.index, "device_ns": reading.device_ns,
                "host_ns": reading.host_ns, "opened": self._opened, "meta": dict(reading.meta),
            },
        )  # fmt: skip
        return reading.data

    def _shoot(self, slot: Slot) -> tuple[Reading, dict[str, dict[str, Any]]]:
        told = self._configured(slot.settings)
        source = self._devices.by_name[self._devices.roles[self._devices.source]]
        trigger = self._devices.by_name[self._devices.roles[self._devices.trigger]]
        assert isinstance(trigger, Firing)
        source.arm()
        trigger.fire()
        reading = source.read(self._devices.shot_timeout_s)
        self._count(reading.index)
        return reading, told

    def _configured(self, by_role: Mapping[str, Mapping[str, Any]]) -> dict[str, dict[str, Any]]:
        """Settings as read back, by role."""
        return self._set(self._devices.merged(by_role))

    def _set(self, wanted: Mapping[str, Mapping[str, tuple[str, Any]]]) -> dict[str, dict[str, Any]]:
        told: dict[str, dict[str, Any]] = {}
        for name, settings in wanted.items():
            answer = self._devices.by_name[name].configure({key: value for key, (_, value) in settings.items()})
            for key, value in answer.items():
                role = (
                    settings[key][0]
                    if key in settings
                    else next(r for r, n in self._devices.roles.items() if n == name)
                )
                told.setdefault(role, {})[key] = _plain(value)
        return told

    def _count(self, index: int) -> None:
        """The camera's own number must be the next one, or one of those that silent shots may have used. Raises FrameDamaged."""
        last, self._last = self._last, index
        if last is not None:
            step = (index - last) % 65535
            if not 1 <= step <= 1 + self._silent:
                raise FrameDamaged(f"the camera counts {index} after {last}: the frame may be of another shot")
            if step > 1:
                self._store.note("lost", after=last, next=index)
        self._silent = 0

    def _open(self) -> None:
        identities = {}
        for name, device in self._devices.by_name.items():
            identities[name] = dict(device.open())
        # A device without settings is configured too: cameras begin to wait for triggers then.
        nothing: dict[str, dict[str, tuple[str, Any]]] = {name: {} for name in self._devices.by_name}
        self.fixed = self._set(nothing | self._devices.merged(self._devices.settings))
        self._last, self._silent = None, 0
        self._opened += 1
        self._store.note("opened", devices=identities, told=self.fixed, host_ns=time.time_ns())

    def _reopen(self, end: float, failures: int) -> None:
        """Close and open all devices; waits longer each time. What fails here counts as a failed shot."""
        self.close()
        pause = _REST_S[min(failures, len(_REST_S) - 1)]
        while True:
            time.sleep(min(pause, max(end - time.monotonic(), 0.0)))
            try:
                self._open()
                return
            except DeviceError as error:
                self.close()
                if time.monotonic() > end:
                    self._store.note("given up", why=str(error))
                    raise GivenUp(str(error)) from error
                pause = _REST_S[-1]


def _plain(value: Any) -> Any:
    return value.item() if isinstance(value, np.generic) else value
