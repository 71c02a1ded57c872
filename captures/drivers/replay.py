"""A capture played back as hardware: the device answers each shot with what was recorded at its settings."""

from __future__ import annotations

import json
import time
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...scenes.errors import InputError
from ..layouts import layout_of
from ..store.faces import open_captures
from .device import DeviceLost, DeviceTimeout, Reading, Settings

__all__ = ["Replay"]


class Replay:
    """The capture number `index` of the store `address`.

    Settings are the capture's own coordinates along the first dimension of its data ("delay", "laser_on", …), with or
    without the unit behind ("delay_s"), and `shot`, the number among the elements that agree. Without it, a shot gives the
    next element that agrees with all settings, in order, and then begins again; settings that the capture does not have are
    taken and told back. `reference` gives the capture's reference, in whole numbers where its frames are.
    """

    #: It takes the number of a shot as a setting.
    plays_back = True

    def __init__(self, address: str, *, index: int = 0) -> None:
        self._path, self._index = Path(address), index
        self._data: NDArray[Any] | None = None
        self._coords: dict[str, NDArray[Any]] = {}
        self._settings: dict[str, Any] = {}
        self._scale: dict[str, float] = {}
        self._reference: NDArray[Any] | None = None
        self._used: dict[tuple[int, ...], int] = {}
        self._shots, self._armed = 0, False

    def open(self) -> Mapping[str, Any]:
        """As `Device.open`. Raises InputError where there is no such capture."""
        capture = open_captures(self._path)[self._index].load()
        layout = layout_of(capture.attrs["modality"])
        data = capture[layout.data]
        first = data.dims[0]
        self._data = np.asarray(data.values)
        self._coords = {
            str(name): np.asarray(one.values) for name, one in capture.coords.items() if one.dims == (first,)
        }
        # A delay is told back as it was set: before the declared time zero was added.
        zero_s = float(json.loads(capture.attrs["rig"]).get("t0_s", 0.0))
        if "delay" in self._coords:
            self._coords["delay"] = self._coords["delay"] - zero_s
        time_s = capture.coords.get("time")
        if time_s is not None and time_s.dims == data.dims[-1:] and time_s.size > 1:  # the axis of a trace
            self._scale = {"start_s": float(time_s[0]), "step_s": float(time_s[-1] - time_s[0]) / (time_s.size - 1)}
        extra = capture.get("reference")
        if extra is not None:
            whole = self._data.dtype.kind in "iu"
            self._reference = (np.rint(extra.values) if whole else np.asarray(extra.values)).astype(self._data.dtype)
        return {"vendor": "Beambench", "model": "replay", "serial": f"{self._path.name}[{self._index}]", "firmware": ""}

    def configure(self, settings: Settings) -> Mapping[str, Any]:
        """As `Device.configure`: delays are told back as they were recorded."""
        self._settings = dict(settings)
        if self._data is None:
            raise DeviceLost("replay: not open")
        if not settings.get("reference"):
            self._matching()
        return dict(settings) | self._scale

    def arm(self) -> None:
        """As `Device.arm`."""
        self._armed = False

    def fire(self) -> None:
        """One shot."""
        self._armed = True

    def read(self, timeout_s: float) -> Reading:
        """As `Device.read`."""
        if self._data is None:
            raise DeviceLost("replay: not open")
        if not self._armed:
            raise DeviceTimeout("replay: nobody fired")
        self._armed = False
        self._shots = self._shots % 65535 + 1
        if self._settings.get("reference"):
            if self._reference is None:
                raise InputError("The capture that is played back has no reference.", where=str(self._path))
            return Reading(self._reference, self._shots, time.monotonic_ns(), time.time_ns())
        fits = self._matching()
        if "shot" in self._settings:
            element = int(fits[int(self._settings["shot"]) % fits.size])
        else:
            key = tuple(fits.tolist())
            element = int(fits[self._used.get(key, 0) % fits.size])
            self._used[key] = self._used.get(key, 0) + 1
        return Reading(
            self._data[element].copy(), self._shots, time.monotonic_ns(), time.time_ns(), {"element": element}
        )

    def close(self) -> None:
        """As `Device.close`."""
        self._data = None

    def _matching(self) -> NDArray[np.intp]:
        assert self._data is not None
        fits = np.ones(len(self._data), dtype=bool)
        for name, value in self._settings.items():
            values = self._coords.get(name, self._coords.get(name.removesuffix("_s")))
            if values is None:
                continue
            fits &= np.abs(values - value) < 5e-13 if values.dtype.kind == "f" else values == value
        found = np.flatnonzero(fits)
        if not found.size:
            raise InputError(
                "Nothing was recorded with these settings.", where=str(self._path), value=self._settings,
                allowed="; ".join(f"{name}: {values.min():.6g} … {values.max():.6g}" for name, values in self._coords.items()
                                  if name != "valid"),
                next_step="change the plan to what the capture holds",
            )  # fmt: skip
        return found
