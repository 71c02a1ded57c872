"""Intensified cameras of vendors, by pylablib (Andor) or pymmcore (Micro-Manager). **Untried**: no such camera was at hand.

What is tried is pymmcore's own demonstration camera at most. The vendor's software must be installed as well.
"""

from __future__ import annotations

import contextlib
import time
from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np

from ...scenes.errors import InputError
from .device import DeviceLost, DeviceTimeout, Reading, Settings

__all__ = ["AndorCamera", "MicroManagerCamera"]


class AndorCamera:
    """An Andor camera of SDK 2 (`address`: its number) by pylablib, on its external trigger. Untried."""

    def __init__(self, address: str = "0") -> None:
        self._address, self._index = address, 0
        self._camera: Any = None

    def open(self) -> Mapping[str, Any]:
        """As `Device.open`."""
        try:
            from pylablib.devices import Andor
        except ImportError as error:
            raise _missing("andor", "pip install pylablib, and Andor's SDK 2") from error
        try:
            self._camera = Andor.AndorSDK2Camera(idx=int(self._address))
            info = self._camera.get_device_info()
        except Exception as error:
            raise DeviceLost(f"camera {self._address}: {error}") from error
        return {"vendor": "Andor", "model": str(info.head_model), "serial": str(info.serial_number), "firmware": ""}

    def configure(self, settings: Settings) -> Mapping[str, Any]:
        """As `Device.configure`: `exposure_s`, or attributes of the camera by pylablib's names."""
        camera, told = self._ready(), {}
        with _told_as_lost(self._address):
            camera.stop_acquisition()
            camera.set_trigger_mode("ext")
            for name, value in settings.items():
                if name == "exposure_s":
                    camera.set_exposure(float(value))
                    told[name] = camera.get_exposure()
                else:
                    camera.set_device_variable(name, value)
                    told[name] = camera.get_device_variable(name)
            camera.start_acquisition()
        return told

    def arm(self) -> None:
        """As `Device.arm`."""
        with _told_as_lost(self._address):
            self._ready().read_multiple_images()

    def read(self, timeout_s: float) -> Reading:
        """As `Device.read`."""
        camera = self._ready()
        try:
            camera.wait_for_frame(timeout=timeout_s)
            frame = camera.read_oldest_image()
        except Exception as error:
            raise DeviceTimeout(f"camera {self._address}: {error}") from error
        if frame is None:
            raise DeviceTimeout(f"camera {self._address}: no image in {timeout_s:g} s")
        self._index += 1
        return Reading(np.array(frame, np.uint16), self._index, 0, time.time_ns())

    def close(self) -> None:
        """As `Device.close`."""
        with contextlib.suppress(Exception):
            if self._camera is not None:
                self._camera.close()
        self._camera = None

    def _ready(self) -> Any:
        if self._camera is None:
            raise DeviceLost(f"camera {self._address}: not open")
        return self._camera


class MicroManagerCamera:
    """A camera of Micro-Manager by pymmcore: `address` is MODULE/DEVICE, e.g. "DemoCamera/DCam"; `adapters` their folder."""

    def __init__(self, address: str, *, adapters: str = "") -> None:
        self._address, self._adapters, self._index = address, adapters, 0
        self._core: Any = None

    def open(self) -> Mapping[str, Any]:
        """As `Device.open`."""
        try:
            import pymmcore
        except ImportError as error:
            raise _missing("micro-manager", "pip install pymmcore, and Micro-Manager's device adapters") from error
        module, _, device = self._address.partition("/")
        with _told_as_lost(self._address):
            self._core = core = pymmcore.CMMCore()
            if self._adapters:
                core.setDeviceAdapterSearchPaths([self._adapters])
            core.loadDevice("Camera", module, device)
            core.initializeAllDevices()
            core.setCameraDevice("Camera")
        return {"vendor": module, "model": device, "serial": "", "firmware": core.getVersionInfo()}

    def configure(self, settings: Settings) -> Mapping[str, Any]:
        """As `Device.configure`: `exposure_s`, or properties by Micro-Manager's names."""
        core, told = self._ready(), {}
        with _told_as_lost(self._address):
            for name, value in settings.items():
                if name == "exposure_s":
                    core.setExposure(float(value) * 1e3)
                    told[name] = core.getExposure() * 1e-3
                else:
                    core.setProperty("Camera", name, value)
                    told[name] = core.getProperty("Camera", name)
        return told

    def arm(self) -> None:
        """As `Device.arm`: frames are taken one at a time, so none is stale."""

    def fire(self) -> None:
        """Expose."""
        with _told_as_lost(self._address):
            self._ready().snapImage()

    def read(self, timeout_s: float) -> Reading:
        """As `Device.read`."""
        with _told_as_lost(self._address):
            frame = self._ready().getImage()
        self._index += 1
        return Reading(np.array(frame), self._index, 0, time.time_ns())

    def close(self) -> None:
        """As `Device.close`."""
        with contextlib.suppress(Exception):
            if self._core is not None:
                self._core.reset()
        self._core = None

    def _ready(self) -> Any:
        if self._core is None:
            raise DeviceLost(f"camera {self._address}: not open")
        return self._core


@contextlib.contextmanager
def _told_as_lost(address: str) -> Iterator[None]:
    try:
        yield
    except (DeviceLost, DeviceTimeout):
        raise
    except Exception as error:  # the vendors' packages raise what they like
        raise DeviceLost(f"camera {address}: {error}") from error


def _missing(driver: str, next_step: str) -> InputError:
    return InputError("The package of this driver is not installed.", where=f"driver {driver}", next_step=next_step)
