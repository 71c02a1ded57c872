"""UVC and V4L2 cameras, and files of frames, by OpenCV. Untried on a camera; tried on files."""

from __future__ import annotations

import time
from collections.abc import Mapping
from typing import Any

import numpy as np

from ...scenes.errors import InputError
from .device import DeviceLost, DeviceTimeout, FrameDamaged, Reading, Settings

__all__ = ["UvcCamera"]

_STALE = 4


class UvcCamera:
    """The camera `address`: its number ("0"), its device file ("/dev/video0"), or a file of frames.

    Such cameras run free: `arm` throws away what they hold, and `fire` is the moment from which a frame counts. Settings are
    OpenCV's properties by number or name ("CAP_PROP_EXPOSURE"). Frames are grey, 8 or 16 bits.
    """

    def __init__(self, address: str) -> None:
        self._address = address
        self._capture: Any = None
        self._index = 0
        self._live = address.isdigit() or address.startswith("/dev/")

    def open(self) -> Mapping[str, Any]:
        """As `Device.open`."""
        cv2 = self._library()
        self.close()
        self._capture = cv2.VideoCapture(int(self._address) if self._address.isdigit() else self._address)
        if not self._capture.isOpened():
            self.close()
            raise DeviceLost(f"camera {self._address}: it cannot be opened")
        return {"vendor": "", "model": self._capture.getBackendName(), "serial": self._address, "firmware": ""}

    def configure(self, settings: Settings) -> Mapping[str, Any]:
        """As `Device.configure`: OpenCV's properties, asked for after they are set."""
        cv2 = self._library()
        told: dict[str, Any] = {}
        for name, value in settings.items():
            number = getattr(cv2, name, None) if name.startswith("CAP_PROP_") else None
            if number is None:
                raise InputError("OpenCV has no such property.", where="camera", value=name, allowed="CAP_PROP_…")
            self._ready().set(number, float(value))
            told[name] = self._ready().get(number)
        return told

    def arm(self) -> None:
        """As `Device.arm`."""
        for _ in range(_STALE if self._live else 0):
            self._ready().grab()

    def fire(self) -> None:
        """Nothing: the camera runs free."""

    def read(self, timeout_s: float) -> Reading:
        """As `Device.read`."""
        there, frame = self._ready().read()
        if not there:
            raise DeviceTimeout(f"camera {self._address}: no frame")
        grey = frame if frame.ndim == 2 else self._library().cvtColor(frame, self._library().COLOR_BGR2GRAY)
        if grey.dtype not in (np.uint8, np.uint16):
            raise FrameDamaged(f"camera {self._address}: frames of {grey.dtype}")
        self._index += 1
        clock = self._ready().get(self._library().CAP_PROP_POS_MSEC)
        return Reading(np.array(grey), self._index, round(clock * 1e6), time.time_ns())

    def close(self) -> None:
        """As `Device.close`."""
        if self._capture is not None:
            self._capture.release()
        self._capture = None

    def _ready(self) -> Any:
        if self._capture is None:
            raise DeviceLost(f"camera {self._address}: not open")
        return self._capture

    def _library(self) -> Any:
        try:
            import cv2
        except ImportError as error:
            raise InputError(
                "UVC and V4L2 cameras need OpenCV.", where="driver uvc", next_step="pip install opencv-python-headless"
            ) from error
        return cv2
