"""GigE and USB3 Vision cameras by Aravis (LGPL; system packages, and PyGObject in the environment)."""

from __future__ import annotations

import contextlib
import time
from collections.abc import Mapping
from typing import Any

import numpy as np

from ...scenes.errors import InputError
from .device import DeviceLost, DeviceTimeout, FrameDamaged, Reading, Settings

__all__ = ["AravisCamera", "aravis_library"]

_BUFFERS = 4


def aravis_library() -> Any:
    """The bindings of Aravis 0.8. Raises InputError where they are missing, with how to get them."""
    try:
        import gi

        gi.require_version("Aravis", "0.8")
        from gi.repository import Aravis
    except (ImportError, ValueError) as error:
        raise InputError(
            "Aravis is not installed, or its bindings are not.", where="driver aravis", value=str(error),
            next_step="apt install gir1.2-aravis-0.8 libgirepository1.0-dev libcairo2-dev pkg-config, then "
            "pip install 'PyGObject<3.51'; a GigE camera needs none of it with the driver \"gige\"",
        ) from error  # fmt: skip
    return Aravis


class AravisCamera:
    """The camera that Aravis knows by `address`: a name, an IP address, or "" for the first one. Settings as `GigeCamera`."""

    def __init__(self, address: str = "", *, serial: str = "") -> None:
        self._address, self._serial = address, serial
        self._camera: Any = None
        self._stream: Any = None
        self._format = ""

    def open(self) -> Mapping[str, Any]:
        """As `Device.open`."""
        library = aravis_library()
        self.close()
        try:
            self._camera = camera = library.Camera.new(self._address or None)
            told = {
                "vendor": camera.get_vendor_name(), "model": camera.get_model_name(),
                "serial": camera.get_device_serial_number() or "", "firmware": "",
            }  # fmt: skip
        except Exception as error:  # GLib.Error, which exists only where gi does
            raise DeviceLost(f"camera {self._address}: {error}") from error
        if self._serial and told["serial"] != self._serial:
            self.close()
            raise InputError(
                "Another camera is at this address.", where=f"camera {self._address}", value=told["serial"],
                allowed=self._serial, next_step="correct `serial` or `address` in the rig file",
            )  # fmt: skip
        return told

    def configure(self, settings: Settings) -> Mapping[str, Any]:
        """As `Device.configure`."""
        camera = self._ready()
        told: dict[str, Any] = {}
        try:
            self._halt()
            for name, value in settings.items():
                told[name] = self._set(camera, name, value)
            self._format = camera.get_pixel_format_as_string()
            if self._format not in ("Mono8", "Mono16"):
                raise InputError(
                    "The pixel format is not read.", where="camera", value=self._format, allowed="Mono8, Mono16"
                )
            self._stream = camera.create_stream(None, None)
            size = camera.get_payload()
            for _ in range(_BUFFERS):
                self._stream.push_buffer(aravis_library().Buffer.new_allocate(size))
            _, _, cols, rows = camera.get_region()
            camera.start_acquisition()
        except InputError:
            raise
        except Exception as error:
            raise DeviceLost(f"camera {self._address}: {error}") from error
        return told | {"rows": rows, "cols": cols}

    def arm(self) -> None:
        """As `Device.arm`."""
        self._ready()
        while (stale := self._stream.try_pop_buffer()) is not None:
            self._stream.push_buffer(stale)

    def fire(self) -> None:
        """A software trigger."""
        try:
            self._ready().software_trigger()
        except Exception as error:
            raise DeviceLost(f"camera {self._address}: {error}") from error

    def read(self, timeout_s: float) -> Reading:
        """As `Device.read`: only a buffer whose status is SUCCESS counts, whatever its length."""
        self._ready()
        buffer = self._stream.timeout_pop_buffer(round(timeout_s * 1e6))
        if buffer is None:
            raise DeviceTimeout(f"camera {self._address}: no image in {timeout_s:g} s")
        try:
            if buffer.get_status() != aravis_library().BufferStatus.SUCCESS:
                raise FrameDamaged(f"image {buffer.get_frame_id()}: {buffer.get_status().value_nick}")
            dtype = np.uint8 if self._format == "Mono8" else np.dtype("<u2")
            shape = (buffer.get_image_height(), buffer.get_image_width())
            pixels = np.frombuffer(bytes(buffer.get_data()), dtype)  # copied: the buffer is filled again
            if pixels.size < shape[0] * shape[1]:
                raise FrameDamaged(f"image {buffer.get_frame_id()}: too short")
            image = pixels[: shape[0] * shape[1]].reshape(shape).astype(np.dtype(dtype).newbyteorder("="))
            return Reading(image, int(buffer.get_frame_id()), int(buffer.get_timestamp()), time.time_ns())
        finally:
            self._stream.push_buffer(buffer)

    def close(self) -> None:
        """As `Device.close`."""
        with contextlib.suppress(Exception):
            self._halt()
        self._camera = self._stream = None

    def _halt(self) -> None:
        if self._camera is not None:
            with contextlib.suppress(Exception):
                self._camera.stop_acquisition()
        self._stream = None

    def _ready(self) -> Any:
        if self._camera is None:
            raise DeviceLost(f"camera {self._address}: not open")
        return self._camera

    def _set(self, camera: Any, name: str, value: Any) -> Any:
        if name == "exposure_s":
            camera.set_exposure_time(float(value) * 1e6)
            return camera.get_exposure_time() * 1e-6
        kinds = {bool: "boolean", int: "integer", float: "float", str: "string"}
        kind = kinds[type(value)]
        getattr(camera, f"set_{kind}")(name, value)
        return getattr(camera, f"get_{kind}")(name)
